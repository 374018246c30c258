"""Completion of command lines by zsh, as a user gets it. tests/cli/completion.t has that by bash."""

import os
import re

from command_line import PROGRAM
from daemons import BUILD, REPOSITORY
from daemons import PROGRAM as DAEMON
from installing import needs, run

PACKAGING = REPOSITORY / "clients/packaging"
PATH = {"PATH": f"{BUILD}:{os.environ['PATH']}"}


def options_of(*command: str) -> list[str]:
    return re.findall(r"^  (--[a-z-]+)", run(*command, "--help"), re.M)


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
