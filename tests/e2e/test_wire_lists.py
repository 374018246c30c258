"""The structures and codes of the Python client are those of proto/ and core/."""

from __future__ import annotations

import re

import pytest
from dipole import wire
from lists import choices, read_list


def structures_of_the_list() -> dict[str, list[tuple[str, str, int]]]:
    """Reads proto/messages.def: name -> [(kind, field, count)]."""
    structures = {}
    for name, body in re.findall(
        r"#define WIRE_FIELDS_(\w+)\(F, A, T\)(.*)", read_list("proto/messages.def")
    ):
        fields = []
        for macro, arguments in re.findall(r'\b([FAT])\(([^"]*),\s*"', body):
            words = [word.strip() for word in arguments.split(",")]
            if macro == "F":
                fields.append((words[0], words[1], 1))
            elif macro == "A":
                fields.append((words[0], words[1], int(words[2])))
            else:
                fields.append(("text", words[0], int(words[1])))
        structures[name] = fields
    return structures


STRUCTURES = structures_of_the_list()


def test_every_structure_is_known_on_both_sides():
    assert set(STRUCTURES) == set(wire.STRUCTURES)
    assert len(STRUCTURES) >= 12


@pytest.mark.parametrize("name", STRUCTURES)
def test_structure_field_by_field(name):
    assert [tuple(field) for field in wire.STRUCTURES[name].fields] == STRUCTURES[name]
    assert wire.STRUCTURES[name].bytes % wire.ALIGNMENT == 0


def test_messages():
    assert choices("WIRE_MESSAGE", "proto/messages.def") == wire.MESSAGES


def test_statuses():
    entries = choices("WIRE_STATUS", "proto/statuses.def")
    assert {code: name for name, code in entries.items()} == wire.STATUSES


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


def test_kinds_of_choices():
    body = re.search(r"enum wire_choice_kind \{(.*?)\}", read_list("proto/wire.h"), re.S)[1]
    names = [name.lower() for name in re.findall(r"WIRE_CHOICE_(\w+)", body)]
    assert dict(enumerate(names, start=1)) == wire.KINDS


def test_ids_that_layouts_depend_on():
    quantities = choices("CORE_QUANTITY")
    assert quantities["R"] == wire.QUANTITY_R
    assert quantities["albedo"] == wire.QUANTITY_ALBEDO
    assert quantities["cdf"] == wire.QUANTITY_CDF
    assert quantities["r"] == wire.QUANTITY_RADIUS
    per_radius = [bit for name, bit in quantities.items() if name not in ("albedo", "r", "model_error")]
    assert quantities["model_error"] == wire.QUANTITY_MODEL_ERROR
    assert per_radius == list(wire.ELEMENTWISE)
    assert choices("CORE_SPACING")["list"] == wire.SPACING_LIST
    numbers = re.findall(
        r'^CORE_EVALUATOR\((\d+), \w+, "\w+", (\w+),', read_list("core/choices.def"), re.M
    )
    types = {"double": "<f8", "float": "<f4"}
    assert wire.EVALUATOR_TYPES == {int(id): types[number] for id, number in numbers}
