"""The completion of a program's command line for zsh."""

from __future__ import annotations

import re

_ADDRESS = """\
_@PROGRAM@_address() {
  if compset -P unix:; then
    _files
  else
    compadd -S '' "$@"
  fi
}
"""
_WITH_COMMANDS = """\
_@PROGRAM@() {
  local -a commands=(
@COMMANDS@
  )
  if ((CURRENT == 2)); then
    _describe -t commands command commands
    return
  fi
  local command=$words[2]
  shift words
  ((CURRENT--))
  case $command in
@CASES@
  esac
}
"""
_ABOUT_COLUMNS = 75


def _quote(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"


def _plain(text: str, special: str) -> str:
    """Text within a specification, where some characters have a meaning."""
    return re.sub(f"([{re.escape(special)}])", r"\\\1", text)


def _about(text: str) -> str:
    """The first words of an explanation."""
    first = re.split(r"; | \(default|\. ", text)[0]
    cut = first if len(first) <= _ABOUT_COLUMNS else first[:_ABOUT_COLUMNS].rsplit(" ", 1)[0]
    return _plain(cut.rstrip(",.:"), "[]:\\")


def _action(program: str, value: str, kind: str, names: tuple[str, ...], many: bool) -> str:
    if kind == "file":
        return "_files"
    if kind == "address":
        return f"_{program}_address {' '.join(_plain(name, ':') for name in names)}"
    if kind == "names" and many:
        return f"_values -s , {value} {' '.join(names)}"
    return f"({' '.join(names)})" if kind == "names" else " "


def _specification(program: str, option) -> str:
    if option.value is None:
        return _quote(f"--{option.name}[{_about(option.about)}]")
    repeated = "*" if "may be repeated" in option.about else ""
    value = re.sub(r"\W.*", "", option.value.strip("[]"))
    action = _action(program, value, option.kind, option.names, option.many)
    colons = "::" if option.value_is_optional else ":"
    return _quote(
        f"{repeated}--{option.name}=[{_about(option.about)}]{colons}{value}:{action}"
    )


def _arguments(program: str, command, indent: str) -> str:
    lines = [_specification(program, option) for option in command.options]
    if command.operand_kind:
        action = _action(program, "", command.operand_kind, command.operand_names, False)
        lines.append(_quote(f"1::{command.operand_kind}:{action}"))
    return f"{indent}_arguments" + "".join(f" \\\n{indent}  {line}" for line in lines)


def _with_commands(program: str, commands: list) -> str:
    named = [command for command in commands if command.name]
    titles = "\n".join(f"    {_quote(f'{c.name}:{_about(c.about)}')}" for c in named)
    cases = "\n".join(f"  {c.name})\n{_arguments(program, c, '    ')}\n    ;;" for c in named)
    return _WITH_COMMANDS.replace("@COMMANDS@", titles).replace("@CASES@", cases)


def write(program: str, commands: list) -> str:
    """A file for a folder in $fpath."""
    if len(commands) > 1:
        body = _with_commands(program, commands)
    else:
        body = f"_{program}() {{\n{_arguments(program, commands[0], '  ')}\n}}\n"
    head = f"#compdef {program}\n# Made from the --help of {program}.\n\n"
    return f'{head}{_ADDRESS}\n{body}\n_{program} "$@"\n'.replace("@PROGRAM@", program)
