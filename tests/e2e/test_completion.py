"""Completion of command lines by bash, as a user gets it; for zsh, the syntax of its file."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from command_line import PROGRAM, dipole
from daemons import BUILD, REPOSITORY
from daemons import PROGRAM as DAEMON
from installing import needs, run

# Sets COMP_WORDS as readline does: it cuts the line at blanks, and around runs of other break
# characters.
DRIVER = """
source "$1"
COMP_LINE=$2
COMP_POINT=${#2}
COMP_WORDBREAKS=$3
shift 3
COMP_WORDS=("$@")
COMP_CWORD=$(($# - 1))
_dipole
for reply in "${COMPREPLY[@]}"; do
  printf '%s\\n' "$reply"
done
"""
BREAKS = " \t\n\"'><=;|&(:"


PACKAGING = REPOSITORY / "clients/packaging"
PATH = {"PATH": f"{BUILD}:{os.environ['PATH']}"}


def words_of(line: str, breaks: str) -> list[str]:
    cut = "".join(c for c in ":=" if c in breaks)
    words = re.findall(rf"[{cut}]+|[^\s{cut}]+" if cut else r"\S+", line)
    return [*words, ""] if line[-1].isspace() else words


@pytest.fixture(scope="module")
def complete():
    """Returns a function that gives the replies for a line that ends at the cursor: the possible
    last words, as readline cuts words."""

    def replies(line: str, breaks: str = BREAKS, cwd: Path | None = None) -> list[str]:
        words = words_of(line, breaks)
        command = ["bash", "-c", DRIVER, "bash", PACKAGING / "completion.bash", line, breaks]
        return run(*command, *words, env=PATH, cwd=cwd).splitlines()

    return replies


@pytest.fixture(scope="module")
def known() -> dict[str, list[str]]:
    """Returns the names in a daemon's lists, and its media."""
    info = json.loads(dipole("info", "--format", "json").stdout)
    lists = {key: value for key, value in info.items() if isinstance(value, list)}
    names = {
        key: [entry["name"] for entry in value if "name" in entry] for key, value in lists.items()
    }
    media = json.loads(dipole("media", "--format", "json").stdout)["media"]
    return {**names, "media": [entry["medium"] for entry in media]}


def help_of(*command: str) -> str:
    return run(PROGRAM, *command, "--help")


def commands() -> list[str]:
    return re.findall(r"^  ([a-z]+) +[A-Z]", help_of(), re.M)


def options_in(text: str) -> dict[str, str]:
    """Returns the name of the value of each option, or "" for an option without a value."""
    return dict(re.findall(r"^  (--[a-z-]+)(?: (\S+))?(?= |$)", text, re.M))


def test_commands(complete):
    assert complete("dipole ") == commands()
    assert complete("dipole po") == ["points"]
    assert complete("dipole help ta") == ["table"]
    assert complete("dipole nonsense") == []


def test_options_are_those_of_help(complete):
    for command in commands():
        if command != "help":
            expected = options_in(help_of(command))
            assert complete(f"dipole {command} --") == list(expected), command
    assert complete("dipoled --") == list(options_in(run(DAEMON, "--help")))
    assert complete("dipole eval --sigma-") == ["--sigma-a", "--sigma-s"]
    assert complete("dipole eval --log --cos-o") == ["--cos-out"]
    assert complete("dipole eval --medium skin1 --log --cos-o") == ["--cos-out"]


def test_every_option_that_takes_a_name_knows_names(complete):
    tried = 0
    for command in commands():
        for option, value in options_in(help_of(command)).items() if command != "help" else ():
            if re.match(r"NAME|FORMAT|COLOUR", value):
                assert complete(f"dipole {command} {option} ") != [], f"{command} {option}"
                tried += 1
            elif re.match(r"[XNS]\b", value):
                assert complete(f"dipole {command} {option} ") == [], f"{command} {option}"
    assert tried > 10


@pytest.mark.parametrize(
    "option, kind",
    [
        ("--model", "models"),
        ("--fit-model", "models"),
        ("--evaluator", "evaluators"),
        ("--moments", "moments"),
        ("--wanted", "quantities"),
        ("--medium", "media"),
    ],
)
def test_names_are_those_of_the_daemon(complete, known, option, kind):
    names = [name for name in complete(f"dipole eval {option} ") if name != "all"]
    assert names == known[kind] and len(names) >= 3


def test_names_that_help_enumerates(complete):
    assert complete("dipole info --format ") == ["table", "csv", "json"]
    assert complete("dipole mc --channel ") == ["red", "green", "blue"]
    assert complete("dipoled --isa ") == ["portable", "sse2", "avx2", "avx512", "neon"]
    assert complete("dipoled --log-level ") == ["error", "info"]


def test_several_names(complete):
    assert complete("dipole eval --wanted R,al") == ["R,albedo"]
    assert complete("dipole eval --model classical,better,gros") == [
        "classical,better,grosjean",
        "classical,better,grosjean-boundary",
        "classical,better,grosjean-exitance",
    ]
    assert complete("dipole table --model transp") == ["transport"]


@pytest.mark.parametrize("breaks", [BREAKS, " \t\n"])
def test_a_value_behind_an_equals_sign(complete, breaks):
    before = "" if "=" in breaks else "--medium="
    assert complete("dipole eval --medium=skin", breaks) == [f"{before}skin1", f"{before}skin2"]
    before = "" if "=" in breaks else "--wanted="
    assert complete("dipole eval --wanted=R,al", breaks) == [f"{before}R,albedo"]


@pytest.mark.parametrize("breaks", [BREAKS, " \t\n"])
def test_addresses(complete, tmp_path, breaks):
    (tmp_path / "one.sock").touch()
    assert complete("dipole info --connect ", breaks) == ["unix:", "tcp:", "private:"]
    assert complete("dipole info --connect t", breaks) == ["tcp:"]
    before = "" if ":" in breaks else "unix:"
    replies = complete(f"dipole info --connect unix:{tmp_path}/o", breaks)
    assert replies == [f"{before}{tmp_path}/one.sock"]
    assert complete("dipoled --listen u", breaks) == ["unix:"]
    # The text behind an address is not a part of the address.
    assert complete("dipole info --connect private: --form", breaks) == ["--format"]


def test_files(complete, tmp_path):
    for name in ("a.csv", "a.table", "b.csv", "with blank"):
        (tmp_path / name).touch()
    for line in ("points ", "points --evaluator lut ", "eval --table ", "table --output "):
        replies = complete(f"dipole {line}", cwd=tmp_path)
        assert sorted(replies) == ["a.csv", "a.table", "b.csv", "with blank"], line
    assert sorted(complete("dipole points a", cwd=tmp_path)) == ["a.csv", "a.table"]
    assert complete("dipole eval --plot=b", cwd=tmp_path) == ["b.csv"]
    # An option may also follow an option whose value may be left out.
    assert complete("dipole eval --plot --wan", cwd=tmp_path) == ["--wanted"]


def test_the_script_registers_itself_for_both_programs():
    script = PACKAGING / "completion.bash"
    run("bash", "-n", script)
    registered = run("bash", "-c", 'source "$0" && complete -p dipole dipoled', script)
    assert registered == "complete -F _dipole dipole\ncomplete -F _dipole dipoled\n"


# This script completes a command line in zsh. Stand-ins for zsh's own functions print their
# arguments. If $OPTION is set, the action of that option is carried out as _arguments does it.
ZSH = r"""
_describe() { print -rl -- "${(@P)@[-1]}" }
_values() { print -rl -- "${@[4,-1]}" }
_files() { print files }
compset() { return 1 }
compadd() { [[ $1 = -a ]] && print -rl -- "${(@P)2}" || print -rl -- "${@[3,-1]}" }
_arguments() {
  print -rl -- "$@"
  local spec=${(M)@:#--$OPTION=*}
  [[ -z $OPTION ]] || { print ACTION; eval "${spec##*:}" }
}
words=("${@[2,-1]}") CURRENT=$(($# - 1)) service=$2
source $1
"""


@pytest.fixture(scope="module")
def offer():
    """Returns a function that gives zsh's replies for the last of some words, and for the value of
    an option."""
    needs("zsh")

    def offered(*words: str, option: str = "") -> list[str]:
        script = PACKAGING / "completion.zsh"
        env = {**PATH, "OPTION": option}
        lines = run("zsh", "-f", "-c", ZSH, "zsh", script, *words, env=env).splitlines()
        return lines[lines.index("ACTION") + 1 :] if option else lines

    return offered


def test_zsh_offers_commands_with_explanations(offer):
    shown = dict(line.split(":", 1) for line in offer("dipole", ""))
    assert list(shown) == commands() and all(shown.values())
    assert len(offer("dipole", "help", "")) == len(shown)


def test_zsh_offers_every_option_with_its_explanation(offer):
    pattern = re.compile(r"\*?(--[a-z-]+)=?\[(.+?)\]")
    for command in [*commands(), ""]:
        if command != "help":
            words = ["dipole", command] if command else ["dipoled"]
            specs = [pattern.match(line) for line in offer(*words, "")]
            text = help_of(command) if command else run(DAEMON, "--help")
            assert [spec[1] for spec in specs if spec] == list(options_in(text)), command


@pytest.mark.parametrize(
    "option, kind",
    [("model", "models"), ("moments", "moments"), ("wanted", "quantities"), ("medium", "media")],
)
def test_zsh_offers_the_names_of_the_daemon(offer, known, option, kind):
    names = offer("dipole", "eval", "", option=option)
    assert [name for name in names if name != "all"] == known[kind]


def test_zsh_offers_values(offer):
    assert offer("dipole", "info", "", option="format") == ["table", "csv", "json"]
    assert offer("dipole", "mc", "", option="channel") == ["red", "green", "blue"]
    assert offer("dipoled", "", option="isa") == ["portable", "sse2", "avx2", "avx512", "neon"]
    assert offer("dipole", "info", "", option="connect") == ["unix:", "tcp:", "private:"]
    assert offer("dipole", "table", "", option="output") == ["files"]
    assert offer("dipole", "points", "")[-1] == "*:file:_files"
