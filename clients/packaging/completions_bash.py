"""The completion of a program's command line for bash."""

from __future__ import annotations

import shlex

_SCRIPT = r'''# Completes the command lines of @PROGRAM@; made from its --help.

# What the option $2 of the command $1 takes, or what the command itself does: sets kind, names,
# many (several, separated by commas) and may (it may be left out).
_@PROGRAM@_takes() {
  kind='' names='' many='' may=''
  case $1:$2 in
@TAKES@
  esac
}

# The options of the command $1.
_@PROGRAM@_options() {
  case $1 in
@OPTIONS@
  esac
}

# Fills COMPREPLY with what the value $1 of that kind may become.
_@PROGRAM@_values() {
  local value=$1 head=''
  case $kind in
  file)
    compopt -o filenames 2>/dev/null
    mapfile -t COMPREPLY < <(compgen -f -- "$value")
    ;;
  address)
    compopt -o nospace 2>/dev/null
    if [[ $value == unix:* ]]; then
      compopt -o filenames 2>/dev/null
      mapfile -t COMPREPLY < <(compgen -P unix: -f -- "${value#unix:}")
    else
      mapfile -t COMPREPLY < <(compgen -W "$names" -- "$value")
    fi
    ;;
  names)
    if [[ $many ]]; then
      compopt -o nospace 2>/dev/null
      [[ $value == *,* ]] && head=${value%,*},
    fi
    mapfile -t COMPREPLY < <(compgen -P "$head" -W "$names" -- "${value#"$head"}")
    ;;
  esac
}

# The line up to the cursor, as words: sets words, and current to the last of them. Readline cuts at
# = and : as well, which options and addresses hold; here they are whole.
_@PROGRAM@_words() {
  local rest=${COMP_LINE:0:COMP_POINT} i word
  words=()
  for ((i = 0; i < COMP_CWORD; i++)); do
    word=${COMP_WORDS[i]}
    if ((i > 0)) && [[ $rest != [[:space:]]* ]]; then
      words[-1]+=$word
    else
      words+=("$word")
    fi
    rest=${rest#"${rest%%[![:space:]]*}"}
    rest=${rest#"$word"}
  done
  if [[ $rest == [[:space:]]* ]]; then
    current=${rest#"${rest%%[![:space:]]*}"}
  else
    current=${words[-1]}$rest
    unset 'words[-1]'
  fi
}

_@PROGRAM@() {
  local current kind names many may command='' option=''
  local -a words
  COMPREPLY=()
  _@PROGRAM@_words
  @COMMAND@
  if [[ $current == --*=* ]]; then
    option=${current%%=*}
    current=${current#*=}
    _@PROGRAM@_takes "$command" "$option"
    _@PROGRAM@_values "$current"
    [[ $COMP_WORDBREAKS == *=* ]] || COMPREPLY=("${COMPREPLY[@]/#/$option=}")
  else
    _@PROGRAM@_takes "$command" "${words[-1]}"
    if [[ ! $kind || ($may && $current == --*) ]]; then
      _@PROGRAM@_takes "$command" operand
      if [[ ! $kind || $current == -* ]]; then
        kind=names names=$(_@PROGRAM@_options "$command") many=''
      fi
    fi
    _@PROGRAM@_values "$current"
  fi
  if [[ $current == *:* && $COMP_WORDBREAKS == *:* ]]; then
    COMPREPLY=("${COMPREPLY[@]#"${current%"${current##*:}"}"}")
  fi
}

complete -F _@PROGRAM@ @PROGRAM@
'''


def _case(pattern: str, **settings: str) -> str:
    assigned = " ".join(f"{name}={shlex.quote(value)}" for name, value in settings.items() if value)
    return f"  {pattern}) {assigned} ;;"


def _takes(command) -> list[str]:
    cases = [
        _case(
            f"{command.name}:--{option.name}",
            kind=option.kind or "unknown",
            names=" ".join(option.names),
            many="yes" if option.many else "",
            may="yes" if option.value_is_optional else "",
        )
        for option in command.options
        if option.value is not None
    ]
    if command.operand_kind:
        names = " ".join(command.operand_names)
        cases.append(_case(f"{command.name}:operand", kind=command.operand_kind, names=names))
    return cases


def write(program: str, commands: list) -> str:
    """A script that defines and registers the completion."""
    options = []
    for command in commands:
        names = " ".join(f"--{option.name}" for option in command.options)
        options.append(f"  {command.name or repr('')}) echo '{names}' ;;")
    has_commands = len(commands) > 1
    fields = {
        "@PROGRAM@": program,
        "@TAKES@": "\n".join(case for command in commands for case in _takes(command)),
        "@OPTIONS@": "\n".join(options),
        "@COMMAND@": "command=${words[1]-}" if has_commands else "command=''",
    }
    script = _SCRIPT
    for name, value in fields.items():
        script = script.replace(name, value)
    return script
