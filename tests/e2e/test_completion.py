"""Completion of command lines by bash and zsh, as a user gets it. tests/cli/lists.t has what `dipole
complete` offers."""

import os
import re

import pytest
from command_line import PROGRAM
from daemons import BUILD, REPOSITORY
from daemons import PROGRAM as DAEMON
from installing import needs, run

PACKAGING = REPOSITORY / "clients/packaging"
PATH = {"PATH": f"{BUILD}:{os.environ['PATH']}"}
DRIVER = """source "$1"; COMP_LINE=$2; COMP_POINT=${#2}; COMP_WORDBREAKS=$3; COMP_WORDS=(${2%% *})
_dipole 2>/dev/null; printf '%s\\n' "${COMPREPLY[@]}" """


def complete(line: str, breaks: str = " \t\n\"'><=;|&(:") -> list[str]:
    script = PACKAGING / "completion.bash"
    return run("bash", "-c", DRIVER, "bash", script, line, breaks, env=PATH).split()


def options_of(*command: str) -> list[str]:
    return re.findall(r"^  (--[a-z-]+)", run(*command, "--help"), re.M)


def test_bash_offers_every_command_and_option():
    commands = re.findall(r"^  ([a-z]+) +[A-Z]", run(PROGRAM, "--help"), re.M)
    assert complete("dipole ") == commands and len(commands) > 10
    for command in commands[:-1]:
        assert complete(f"dipole {command} --") == options_of(PROGRAM, command), command
    assert complete("dipoled --") == options_of(DAEMON)


SKINS = "skin-dark skin-light skin-medium skin1 skin2"


@pytest.mark.parametrize(
    "line, cut, whole",
    [
        ("dipole eval --medium skin", SKINS, SKINS),
        ("dipole eval --medium=skin", SKINS, " ".join(f"--medium={name}" for name in SKINS.split())),
        ("dipole eval --wanted R,al", "R,albedo", "R,albedo"),
        ("dipole info --connect t", "tcp: tls:", "tcp: tls:"),
        ("dipole points ", "", ""),
    ],
)
def test_bash_offers_what_readline_puts_in(line, cut, whole):
    """Readline cuts words at = and :, unless a user has changed that."""
    assert complete(line) == cut.split() and complete(line, " \t\n") == whole.split()


def test_bash_registers_both_programs():
    script = PACKAGING / "completion.bash"
    registered = run("bash", "-c", 'source "$0" && complete -p dipole dipoled', script)
    assert all(f"-F _dipole {name}\n" in registered for name in ("dipole", "dipoled"))


# Stand-ins for zsh's own functions print what they get.
ZSH = """_describe() { print -rl -- "${(@P)@[-1]}" }; _files() { print files }
words=("${@[2,-1]}") CURRENT=$(($# - 1)); source $1"""


def test_zsh_offers_the_same_with_explanations():
    needs("zsh")

    def offer(*words: str) -> list[str]:
        script = PACKAGING / "completion.zsh"
        return run("zsh", "-f", "-c", ZSH, "zsh", script, *words, env=PATH).splitlines()

    shown = dict(line.split(":", 1) for line in offer("dipole", "eval", "--"))
    assert list(shown) == options_of(PROGRAM, "eval") and all(shown.values())
    assert offer("dipole", "mc", "--channel", "") == ["red", "green", "blue"]
    assert offer("dipoled", "--") == options_of(DAEMON) and offer("dipole", "points", "") == ["files"]
