"""The structures and codes of the Python client are those of proto/ and core/."""

import re
import subprocess
import sys

from daemons import BUILD, REPOSITORY
from dipole import wire
from lists import choices, entries, read_list


def test_everything_made_from_the_lists_is_up_to_date(tmp_path):
    lists = subprocess.run([BUILD / "wire-lists"], check=True, stdout=subprocess.PIPE).stdout
    tables = [sys.executable, REPOSITORY / "proto/tools/wire_tables.py", tmp_path]
    subprocess.run(tables, check=True, input=lists, cwd=REPOSITORY)
    made = [path for path in tmp_path.rglob("*") if path.is_file()]
    for path in made:
        at = path.relative_to(tmp_path)
        assert path.read_bytes() == (REPOSITORY / at).read_bytes(), f"{at}: run make docs"
    assert made


def test_every_structure_has_a_table():
    text = (REPOSITORY / "proto/PROTOCOL.md").read_text()
    tables = re.findall(r"^```table (.+)", text, re.M)
    assert set(" ".join(tables).split()) == {*wire.STRUCTURES, "messages", "quantities", "statuses"}


def test_constants_of_the_header():
    text = read_list("proto/wire.h")
    assert int(re.search(r"WIRE_MAGIC UINT32_C\((\w+)\)", text)[1], 16) == wire.MAGIC
    for name, value in [
        ("WIRE_VERSION", wire.VERSION),
        ("WIRE_REPLY", wire.REPLY),
        ("WIRE_TYPE_ERROR", wire.TYPE_ERROR),
        ("WIRE_ALIGNMENT", wire.ALIGNMENT),
        ("WIRE_PING_MAX_BYTES", wire.PING_MAX_BYTES),
    ]:
        assert int(re.search(rf"{name} (\w+)", text)[1], 0) == value


def test_ids_that_layouts_depend_on():
    per_channel = ("albedo", "r", "model_error", "balance")
    per_radius = [bit for name, bit in choices("QUANTITY").items() if name not in per_channel]
    assert per_radius == list(wire.ELEMENTWISE)
    assert choices("SPACING")["list"] == wire.SPACING_LIST
    types = {"double": "<f8", "float": "<f4"}
    assert wire.EVALUATOR_TYPES == {
        int(id): types[rest.split()[-1]] for id, _, _, rest in entries("EVALUATOR")
    }
