"""`dipole convert`: from convention to convention and back; tests/cli/convert.t has files of others."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import dipole, read_csv

SOURCE = Path(__file__).parents[2] / "clients" / "cli" / "conventions.def"
UNITS = dict(re.findall(r'^CONVENTION\("([a-z-]+)", \w+, \w+, (\d+)', SOURCE.read_text(), re.MULTILINE))


def convert(*arguments: str) -> list[dict[str, float]]:
    run = dipole("convert", *arguments, "--format", "csv", quiet=False)
    return [{name: float(text or "nan") for name, text in row.items()} for row in read_csv(run.stdout)]


@pytest.mark.parametrize("g", [0, 0.7])
def test_a_medium_goes_through_all_conventions(g):
    """Each step starts from what the last one wrote, so that every convention is left and entered."""
    shared = ["--g", str(g), "--eta", "1.4"]
    source = ["--from", "coefficients", "--sigma-a", "0.01,0.2,2", "--sigma-s", "5"]
    first = convert(*source, *shared)
    for name in [*UNITS, "coefficients"]:
        unit = ["--unit", "2.5"] if "0" in (UNITS.get(name), UNITS.get(source[1])) else []
        rows = convert(*source, "--to", name, *shared, *unit)
        for row, wanted in zip(rows, first, strict=True):
            for coefficient in ("sigma_a", "sigma_s"):
                assert row[coefficient] == pytest.approx(wanted[coefficient], rel=1e-4), (source, name)
        if name != "coefficients":
            colours, lengths = (",".join(repr(row[key]) for row in rows) for key in ("colour", "length"))
            source = ["--from", name, "--colour", colours, "--length", lengths]


@pytest.mark.parametrize("name", ["openpbr", "materialx", "standard-surface", "gltf", "gltf-volume-scatter", "pbrt"])
def test_a_file_that_is_written_is_read(tmp_path, name):
    media = ["--sigma-a", "0.01,0.2,2", "--sigma-s", "5", "--g", "0.3", "--eta", "1.45"]
    made = dipole("convert", "--from", "coefficients", *media, "--to", name, "--format", "native", quiet=False)
    (tmp_path / "material").write_text(made.stdout)
    more = ["--eta", "1.45"] if name == "materialx" else []  # it cannot say the index
    rows = convert("--from", name, str(tmp_path / "material"), *more)
    assert [row["sigma_a"] for row in rows] == pytest.approx([0.01, 0.2, 2], rel=1e-4)
    for row in rows:
        assert (row["sigma_s"], row["g"], row["eta"]) == pytest.approx((5, 0.3, 1.45), rel=1e-4)


# Inputs of MaterialX 1.39's definitions of these nodes (libraries/bxdf, libraries/pbrlib), and the
# type of their output.
INPUTS = {
    "openpbr": ("open_pbr_surface", "surfaceshader", {
        "subsurface_weight": "float", "subsurface_color": "color3", "subsurface_radius": "float",
        "subsurface_radius_scale": "color3", "subsurface_scatter_anisotropy": "float", "specular_ior": "float",
    }),
    "standard-surface": ("standard_surface", "surfaceshader", {
        "subsurface": "float", "subsurface_color": "color3", "subsurface_radius": "color3",
        "subsurface_scale": "float", "subsurface_anisotropy": "float", "specular_IOR": "float",
    }),
    "materialx": ("subsurface_bsdf", "BSDF", {"color": "color3", "radius": "color3", "anisotropy": "float"}),
}  # fmt: skip


@pytest.mark.parametrize("name", INPUTS)
def test_materialx_has_what_is_written(name):
    """Rules of the specification: the root has a version; names are unique and identifiers; an input has
    the type of the definition, and a value of as many numbers."""
    given = ["--sigma-a", "0.01,0.2,2", "--sigma-s", "5", "--g", "0.3", "--eta", "1.45"]
    text = dipole("convert", "--from", "coefficients", *given, "--to", name, "--format", "native", quiet=False).stdout
    root = ElementTree.fromstring(text)
    node, kind, inputs = INPUTS[name]
    assert root.tag == "materialx" and root.attrib == {"version": "1.39"}
    (element,) = root
    assert element.tag == node and element.attrib["type"] == kind and element.attrib["name"].isidentifier()
    assert {one.attrib["name"]: one.attrib["type"] for one in element} == inputs and len(element) == len(inputs)
    for one in element:
        numbers = [float(number) for number in one.attrib["value"].split(",")]
        assert one.tag == "input" and len(numbers) == {"float": 1, "color3": 3}[one.attrib["type"]]
        assert set(one.attrib) == {"name", "type", "value"} and all(0 <= number < 1e3 for number in numbers)
