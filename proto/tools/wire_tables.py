"""Makes from what wire-lists prints: the tables of the wire's structures, quantities and statuses, in the
blocks ```table NAMES of PROTOCOL.md, those of the register map and of SCPI between the markers of
REGISTERS.md and SCPI.md, spectra in TISSUE.md, the messages, structures and lists for Python in schema.py,
quantities in values.py and dipole.h. Reads these files in the current folder.

usage: wire-lists | wire_tables.py FOLDER     writes them into FOLDER
"""

import json
import math
import re
import sys
import textwrap
from pathlib import Path

LISTS = json.load(sys.stdin)
STRUCTURES = LISTS["structures"]
STATUSES = LISTS["statuses"][:-1]
QUANTITIES = LISTS["quantities"][:-1]
PART_FIELDS = len(STRUCTURES["part"])


def named(entries: dict) -> dict:
    return {name: entry for name, entry in entries.items() if name}


MESSAGES = named(LISTS["messages"])

# ---- structures ----------------------------------------------------------------------------------


def type_of(field: dict) -> str:
    return field["kind"] + (f"[{field['count']}]" if field["count"] != 1 else "")


def meaning_of(field: dict) -> str:
    """Returns what a field means: its unit, its range, its meaning and, in brackets, its default."""
    least, most = field["least"], field["most"]
    span = f">={least:g}" if math.isinf(most) else f"{least:g} to {most:g}"
    flag = (least, most) == (0, 1)  # its meaning says so
    parts = [field["unit"], span if most > 0 and not flag else "", field["meaning"]]
    number = field["usual_number"]
    usual = field["usual"] or (f"{number:g}" if number > 0 else "")
    return " ".join(filter(None, ["; ".join(filter(None, parts)), usual and f"[{usual}]"]))


def payload_text(name: str) -> str:
    """Returns the structures with which a payload begins, and the names, kinds and counts of its parts."""
    parts = LISTS["payloads"].get(name, "-").split("; ")
    texts: dict[str, list[str]] = {}
    for part in parts:
        kind, _, rest = part.partition(" ")
        array, *condition = rest.split(" ")
        own, bracket, counts = array.partition("[")
        texts.setdefault(f"{':' * bool(rest)}{kind}{bracket}{counts}{'?' * bool(condition)}", []).append(own)
    return " ".join(",".join(names) + text for text, names in texts.items())


def table_of(name: str) -> str:
    if name == "statuses":
        rows = [f"{code:<4} {ident:<14} {http}" for code, ident, _, http, _ in STATUSES]
        return "\n".join(["code status         HTTP", *rows])
    if name == "messages":
        return "\n".join(
            f"{type:<2} {name:<10} {payload_text(request)}\n{'':13} {payload_text(reply)}"
            for name, (type, request, reply) in MESSAGES.items()
        )
    if name == "quantities":
        return "\n".join(f"{bit:<7} {name:<16} {unit:<12} {about}".rstrip() for bit, _, name, unit, _, about in QUANTITIES)
    fields = STRUCTURES[name]
    rows = [f"{name} ({sum(field['bytes'] for field in fields)})"]
    begins_alike = fields[0]["name"] == "part" and len(fields) > PART_FIELDS
    rows += ["part@0"] if begins_alike else []
    at = 0
    for i, field in enumerate(fields):
        if (i >= PART_FIELDS or not begins_alike) and not field["name"].startswith("zero"):
            row = f"{field['name']}:{type_of(field)}@{at}"
            rows.append(f"{row:<34} {meaning_of(field)}".rstrip())
        at += field["bytes"]
    return "\n".join(rows)


def protocol_of(text: str) -> str:
    def fill(match: re.Match) -> str:
        tables = "\n\n".join(table_of(name) for name in match[1].split())
        return f"\n```table {match[1]}\n{tables}\n```"

    return re.sub(r"\n```table ([^\n]*)\n.*?\n```", fill, text, flags=re.S)


# ---- registers -----------------------------------------------------------------------------------

JOB_COLUMNS = "name | eval | sample | invert | mc | fit | fit_tissue | meaning"
BLOCKS = {first: block for block in LISTS["blocks"] for first in [block[1]]}
MIRROR = LISTS["mirror"]
WITHOUT_REGISTERS = ("quantity", "status", "parameter", "light", "value", "coefficient", "unknown")


def section(title: str, columns: str, rows: list[str]) -> str:
    bare = [row.removeprefix("| ").removesuffix(" |").rstrip() for row in rows]
    return "\n".join([f"### {title}", columns, "|".join(["---"] * (columns.count("|") + 1)), *bare, "", ""])


def originals() -> list:
    return [block for block in LISTS["blocks"] if block[1] // MIRROR % 2 == 0]


def blocks_text() -> str:
    rows = []
    for id, first, length, name, about in originals():
        mirror = BLOCKS.get(first + MIRROR)
        swapped = f"{mirror[0]}, {mirror[1]}" if mirror else ""
        rows.append(f"| {id} | {first} to {first + length - 1} | {swapped} | {name} | {about} |")
    return section("Blocks", "id | PDU | CDAB: id, PDU | name | what it is", rows)


def jobs_text() -> str:
    fields = {field["address"]: field for field in LISTS["registers"]}
    rows = []
    for addresses in zip(*LISTS["jobs"]):
        field = fields[next(filter(None, addresses))]
        cells = "".join(f" {address} |" if address else " |" for address in addresses)
        rows.append(f"| {field['name']} |{cells} {field['about']} |")
    return section("Registers of jobs", JOB_COLUMNS, rows)


def range_of(field: dict) -> str:
    least, most, digits = field["least"], field["most"], field["digits"]
    if field["list"]:
        return f"{'0, ' if least == 0 else ''}[{field['list']}](#lists)"
    if field["bits"]:
        return field["bits"]
    if least == most == 0:
        return ""
    if most == LISTS["most"]:
        return f"{least:.8g}, finite"
    return f"{least:.{digits}g} to {most:.{digits}g}"


def initial_of(field: dict) -> str:
    initial = field["initial"]
    if field["access"] == 2:
        return f"{initial:g}, not given"
    return "NaN" if math.isnan(initial) else f"{initial:.10g}"


def field_row(field: dict) -> str:
    count = f"[{field['count']}]" if field["count"] > 1 else ""
    unit = f", {field['unit']}" if field["unit"] not in ("", "1") else ""
    written = f"; {range_of(field)} ({initial_of(field)})" if field["access"] else ""
    cells = [field["address"], field["name"], field["type"] + count + unit + written, field["about"]]
    return "| " + " | ".join(map(str, cells)) + " |"


def fields_text() -> str:
    of_jobs = {address for job in LISTS["jobs"] for address in job if address}
    text = ""
    for id, first, length, name, _ in originals():
        fields = [
            field for field in LISTS["registers"]
            if first <= field["address"] < first + length and field["address"] not in of_jobs
        ]
        rows = [field_row(field) for field in sorted(fields, key=lambda field: field["address"])]
        columns = "PDU | name | type; range (default) | meaning"
        text += section(f"Block {id}: {name}", columns, rows)
    return text


def lists_text() -> str:
    rows = [
        f"| {name} | " + ", ".join(f"{id} {choice}" for id, choice in entries) + " |"
        for _, name, entries in LISTS["lists"] if name not in WITHOUT_REGISTERS
    ]
    errors = ", ".join(f"{code} {name} ({exception:02x})" for code, _, exception, _, name in STATUSES)
    return section("Lists", "list | ids and names", [*rows, f"| errors (exceptions) | {errors} |"])


def scpi_text() -> str:
    code = lambda text: f"`{text}`".replace("|", "\\|") if text else ""
    rows = [f"| {code(name + mark)} | {code(given)} | {about} |" for name, mark, given, about in LISTS["scpi"][:-1]]
    return "\n".join(["| header | parameters | what it does |", "|---|---|---|", *rows, ""])


def between(text: str, lines: str, name: str = "tables") -> str:
    """Replaces the lines between those that say "NAME: begin" and "NAME: end"."""
    found = rf"({name}: begin[^\n]*\n).*?([^\n]*{name}: end)"
    return re.sub(found, lambda match: match[1] + lines + match[2], text, flags=re.S)


PROPERTIES = [name for _, kind, entries in LISTS["lists"] if kind == "property" for _, name in entries]


def spectra_text() -> str:
    rows: dict[str, list[str]] = {}
    for name, first, last, source, table in sorted(LISTS["spectra"], key=lambda one: PROPERTIES.index(one[0])):
        of_table = "" if table == "all" else f": {table}"
        rows.setdefault(f"{first}-{last} | {source}{of_table}", []).append(name)
    return "property | nm | source\n---|---|---\n" + "".join(
        f"{', '.join(names)} | {row}\n" for row, names in rows.items()
    )


# ---- Python --------------------------------------------------------------------------------------


def filled(text: str) -> str:
    """Breaks a text into lines behind commas and semicolons."""
    whole = re.sub("([^,;]) ", "\\1\u00a0", text)
    lines = textwrap.fill(whole, 98, subsequent_indent="    ", break_on_hyphens=False)
    return lines.replace("\u00a0", " ")


def block(name: str, comment: str, entries: dict) -> str:
    """Makes a text of entries "name: ...", whose further lines are indented."""
    rows = "\n".join(filled(f"{key}: {text}") for key, text in entries.items())
    return f'{comment}{name} = """\\\n{rows}\n"""\n'


def schema_text() -> str:
    fields_of = lambda fields: ", ".join(
        f"{field['kind']} {field['name']}" + type_of(field)[len(field["kind"]):]
        + (f" = {field['default']:.16g}" if field["default"] else "")
        for field in fields
    )
    payloads = named(LISTS["payloads"])
    requests = {f"{name}_request": request for name, (_, request, _) in MESSAGES.items()}
    others = {name: payloads[one] for name, one in requests.items() if one in payloads}
    lists = lambda bits: {
        field["name"]: field["list"]
        for fields in STRUCTURES.values() for field in fields if field["list"] and field["bits"] == bits
    }
    numbers = {
        "MESSAGES": {name: type for name, (type, *_) in MESSAGES.items()},
        "KINDS": {kind: name for kind, name, _ in LISTS["lists"]},
        "STATUSES": {code: name for code, *_, name in STATUSES},
        "QUANTITIES": {name: bit for bit, _, name, *_ in QUANTITIES},
        "CHOICES": lists(0),
        "SUMS": lists(1),
    }
    return "\n".join([
        '"""The messages, structures and lists of dipoled\'s protocol. `make docs` makes this file '
        'from proto/."""\n',
        *(filled(f"{name} = {entries}").replace("'", '"') + "\n" for name, entries in numbers.items()),
        "# quantities with a value for each radius and channel, in the order of a reply's arrays\n"
        f"ELEMENTWISE = {tuple(bit for bit, *_, shape, _ in QUANTITIES if shape not in ('CHANNEL', 'RADII'))}\n",
        block("STRUCTURES", "# name: kind and name of each field, and its default unless 0\n",
              {name: fields_of(fields) for name, fields in STRUCTURES.items()}),
        block("PAYLOADS", "# The structures that a payload begins with, and its parts: element, "
              "name, number of arrays, and\n# of elements in each; wanted&12 is how many of these "
              "bits `wanted` has; [] is all that is left.\n", {**payloads, **others}),
    ])


def properties_text() -> str:
    """Returns the properties of results. model_error and r are not alike for all of them."""
    return "".join(
        f'    {name.replace("2_", "two_")} = _Quantity("{name}", "[C{", N" * (shape != "CHANNEL")}] {unit}'
        f'{": " * bool(about)}{about.replace("*", "")}.")\n'
        for _, _, name, unit, shape, about in QUANTITIES if name not in ("model_error", "r")
    )


def enumeration_text() -> str:
    """Returns the quantities for C, where DIPOLE_PHASE is a list."""
    return "".join(
        f"  /* {name}, {unit}{': ' * bool(about)}{about.replace('*', '')} */\n"
        f"  DIPOLE_{ident.replace('PHASE', 'LAG')} = {bit},\n"
        for bit, ident, name, unit, _, about in QUANTITIES
    )


MADE = {
    "proto/PROTOCOL.md": protocol_of,
    "proto/REGISTERS.md": lambda text: between(
        text, blocks_text() + jobs_text() + fields_text() + lists_text()
    ),
    "proto/SCPI.md": lambda text: between(text, scpi_text()),
    "core/TISSUE.md": lambda text: between(text, spectra_text(), "spectra"),
    "clients/c/dipole.h": lambda text: between(text, enumeration_text(), "quantities"),
    "clients/python/dipole/schema.py": lambda text: schema_text(),
    "clients/python/dipole/values.py": lambda text: between(text, properties_text(), "quantities"),
}

if __name__ == "__main__":
    for name, made in MADE.items():
        to = Path(sys.argv[1], name)
        to.parent.mkdir(parents=True, exist_ok=True)
        to.write_text(made(Path(name).read_text()))
