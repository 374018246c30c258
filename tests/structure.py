"""structure.py [FOLDER]: fails, and names what is wrong, when modules include each other in a circle,
when a document has too many words, and when a rule of the protocol is too long or there twice. Says,
too, which rules, statuses and limits no line of tests/promises.txt holds.

A module is a .c file with the .h and .def files of the same name in the same folder. Only includes
that the sources of FOLDER (by default this repository) write with quotes count."""

import graphlib
import re
import sys
from pathlib import Path

FOLDERS = ("core", "proto", "server", "clients/c", "clients/cli")
# The words that each document may have, as `wc -w` counts them.
WORDS = {
    "README.md": 900,
    "proto/PROTOCOL.md": 9000,
    "proto/REGISTERS.md": 6000,
    "proto/SCPI.md": 2000,
    "clients/GUIDE.md": 1500,
    "server/DEPLOYING.md": 1500,
    "core/MODELS.md": 1500,
    "core/ACCURACY.md": 1500,
    "core/LIMITS.md": 300,
    "core/COLOURS.md": 900,
    "core/TISSUE.md": 1300,
}
RULE_WORDS = 30  # of a rule of PROTOCOL.md: a line that begins with its number, as **E11a**
RULE = re.compile(r"^\*\*([A-Z]\d+[a-z]?)\*\* (.*)$", re.MULTILINE)
# Verbs that name no static function by themselves: a backtrace and a search have to find one place.
BARE = set(
    "add ask begin do draw end evaluate fill find finish follow get give go keep make merge move of"
    " place put run send set show start step stop take tell tick turn watch work".split()
)
STATIC = re.compile(r"^static (?:inline )?[\w ]+?[ *](\w+)\(", re.MULTILINE)
INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"([^"]+)"', re.MULTILINE)

Graph = dict[str, set[str]]


def modules(root: Path) -> Graph:
    """Returns the modules of the folders above, and for each the modules that it includes."""
    files = [
        path.relative_to(root)
        for folder in FOLDERS
        for path in sorted((root / folder).rglob("*"))
        if path.suffix in (".c", ".h", ".def")
    ]
    known = set(files)
    graph: Graph = {str(path.with_suffix("")): set() for path in files}
    for path in files:
        module = str(path.with_suffix(""))
        for name in INCLUDE.findall((root / path).read_text()):
            # A path is relative to the root, as by the compiler's -I., or else to the file.
            beside = (root / path.parent / name).resolve()
            candidates = [Path(name)]
            if beside.is_relative_to(root):
                candidates.append(beside.relative_to(root))
            found = next((one for one in candidates if one in known), None)
            if found is not None and str(found.with_suffix("")) != module:
                graph[module].add(str(found.with_suffix("")))
    return graph


def circle(graph: Graph) -> list[str]:
    """Returns modules each of which includes the next one, with the first at the end again, if there are such."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        found = error.args[1][:0:-1]
        first = found.index(min(found))
        return [*found[first:], *found[:first], found[first]]
    return []


def wordy(root: Path) -> list[str]:
    """Returns what is wrong with the lengths of the documents and rules that FOLDER has."""
    texts = {name: (root / name).read_text() for name in WORDS if (root / name).exists()}
    found = [
        f"{name} has {words} words, more than {WORDS[name]}"
        for name, text in texts.items()
        if (words := len(text.split())) > WORDS[name]
    ]
    rules = RULE.findall(texts.get("proto/PROTOCOL.md", ""))
    numbers = [number for number, _ in rules]
    found += [f"rule {n} is there twice" for n in sorted(set(numbers)) if numbers.count(n) > 1]
    return found + [
        f"rule {number} has {words} words, more than {RULE_WORDS}"
        for number, text in rules
        if (words := len(text.split())) > RULE_WORDS
    ]


def without_a_test(root: Path) -> list[str]:
    """Returns the rules of the protocol, statuses and limits that no line of tests/promises.txt holds,
    and the tests that it names and nobody has."""
    listed = root / "tests/promises.txt"
    if not listed.exists():
        return []
    lines = [line for line in listed.read_text().splitlines() if line and line[0] != "#"]
    rows = [(held.split(), tests.split()) for held, _, tests in (line.partition(":") for line in lines)]
    promised = [number for number, _ in RULE.findall((root / "proto/PROTOCOL.md").read_text())]
    promised += re.findall(r'^WIRE_STATUS\([1-9]\d*, .*?"(.*?)"', (root / "proto/statuses.def").read_text(), re.M)
    promised += re.findall(r'^SERVER_NUMBER\(\w+, "(.*?)"', (root / "server/options.def").read_text(), re.M)
    files = [path for path in (root / "tests").rglob("*") if path.suffix in (".c", ".py", ".t", ".sh")]
    tests = {name for path in files for name in (path.name, path.stem)}
    for path in files:
        tests.update(re.findall(r"^(?:UNIT_TEST\(|def |test_)(\w+)", path.read_text(), re.M))
    held = {one for row, _ in rows for one in row}
    return [f"no test is named for {one}" for one in promised if one not in held] + [
        f"there is no test {one}" for one in sorted({one for _, row in rows for one in row} - tests)
    ]


def bare(root: Path) -> list[str]:
    """Returns the static functions whose name is a bare verb."""
    return [
        f"{path.relative_to(root)}: static {name}() is a bare verb"
        for folder in FOLDERS
        for path in sorted((root / folder).rglob("*.[ch]"))
        for name in STATIC.findall(path.read_text())
        if name in BARE
    ]


def main() -> int:
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1]).resolve()
    graph = modules(root)
    found = circle(graph)
    if found:
        print("modules include each other:", " -> ".join(found))
    else:
        print(f"structure: {len(graph)} modules, none includes itself through others")
    faults = wordy(root) + bare(root) + [f"tests/promises.txt: {one}" for one in without_a_test(root)]
    print(*faults, sep="\n", end="\n" if faults else "")
    return 1 if found or faults else 0


if __name__ == "__main__":
    sys.exit(main())
