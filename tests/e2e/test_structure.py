"""tests/structure.py finds circles of includes, and documents and rules that are too long."""

import sys
from pathlib import Path

import pytest
from daemons import REPOSITORY, finished

sys.path.insert(0, str(REPOSITORY / "tests"))

import structure  # noqa: E402  (needs the path above)


def report(root: Path) -> tuple[int, list[str]]:
    """Runs structure.py. Returns its exit status, and the lines that name circles."""
    command = [sys.executable, str(REPOSITORY / "tests/structure.py"), str(root)]
    done = finished(*command)
    return done.returncode, [line for line in done.stdout.splitlines() if "->" in line]


@pytest.mark.parametrize("folder", structure.FOLDERS)
def test_a_circle_is_named(tmp_path, folder):
    for name, included in {"a.h": f"{folder}/b.h", "b.c": "c.h", "c.def": "a.h", "d.c": "a.h"}.items():
        path = tmp_path / folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f'#include <stdio.h>\n#include "{included}"\n')
    (tmp_path / folder / "b.h").touch()
    (tmp_path / folder / "c.h").touch()
    circle = " -> ".join(f"{folder}/{name}" for name in "abca")
    assert report(tmp_path) == (1, [f"modules include each other: {circle}"])
    (tmp_path / folder / "c.def").unlink()
    assert report(tmp_path) == (0, [])


def test_what_is_too_long_is_named(tmp_path):
    assert all((REPOSITORY / name).exists() for name in structure.WORDS)
    text = (REPOSITORY / "proto/PROTOCOL.md").read_text()
    assert len(structure.RULE.findall(text)) > 100 and not structure.wordy(REPOSITORY)
    (tmp_path / "proto").mkdir()
    rules = "**A1** word\n\n**A1** word\n\n**A2b**" + " word" * 31
    (tmp_path / "proto/PROTOCOL.md").write_text(rules)
    (tmp_path / "README.md").write_text("word " * 901)
    assert structure.wordy(tmp_path) == [
        "README.md has 901 words, more than 900",
        "rule A1 is there twice",
        "rule A2b has 31 words, more than 30",
    ]


def test_a_promise_without_a_test_is_named(tmp_path):
    for path, text in {
        "proto/PROTOCOL.md": "**A1** One.\n\n**A2** Two.\n", "proto/statuses.def": "", "server/options.def": "",
        "tests/promises.txt": "# comment\nA1: test_one test_gone\n", "tests/test_it.py": "def test_one():\n",
    }.items():  # fmt: skip
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(text)
    assert structure.without_a_test(tmp_path) == ["no test is named for A2", "there is no test test_gone"]


def test_a_bare_verb_is_named(tmp_path):
    (tmp_path / "core").mkdir()
    (tmp_path / "core/a.c").write_text("static int put(int x) {\n}\nstatic inline void *put_x(void) {\n}\n")
    (tmp_path / "core/b.h").write_text("static inline struct pair step(void) {\n}\nint run(void);\n")
    assert structure.bare(tmp_path) == [
        "core/a.c: static put() is a bare verb", "core/b.h: static step() is a bare verb",
    ]  # fmt: skip
