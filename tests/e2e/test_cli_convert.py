"""`dipole convert`: from convention to convention and back."""

import csv
import io
import math
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import dipole

SOURCE = Path(__file__).parents[2] / "clients" / "cli" / "conventions.def"
UNITS = dict(re.findall(r'^CONVENTION\("([a-z-]+)", \w+, \w+, (\d+)', SOURCE.read_text(), re.MULTILINE))


def convert(*arguments: str) -> list[dict[str, float]]:
    run = dipole("convert", *arguments, "--format", "csv", quiet=False)
    rows = csv.DictReader(io.StringIO(run.stdout))
    return [{name: float(text or "nan") for name, text in row.items()} for row in rows]


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


def test_a_typed_colour_shows_the_wanted_one():
    """Colours to type for an index of 1.5, by van de Hulst's formula (engines with a walk)."""
    wanted = [round(0.1 * i, 1) for i in range(1, 10)]
    rows = convert("--from", "openpbr", "--colour", ",".join(map(str, wanted)), "--length", "1", "--to", "openpbr", "--typed")
    published = [0.270, 0.438, 0.561, 0.657, 0.736, 0.804, 0.862, 0.913, 0.959]
    assert [row["colour"] for row in rows] == pytest.approx(published, abs=6e-4)
    assert [row["shown"] for row in rows] == pytest.approx(wanted, rel=1e-9)
    typed = convert("--from", "materialx", "--eta", "1.5", "--colour", ",".join(repr(row["colour"]) for row in rows), "--length", "1")
    assert [row["shown"] for row in typed] == pytest.approx(wanted, rel=1e-5)


def test_wrenninges_formula():
    """The albedos by wrenninge() of core/tools/colours.py; the furnace of tests/blender confirms them."""
    for g, wanted in [(0, [0.216056636, 0.759090154, 0.952756523, 0.999227443]),
                      (0.5, [0.365080768, 0.864973669, 0.976575569, 0.999999]),
                      (0.9, [0.737237312, 0.968080696, 0.996215679, 0.999999])]:  # fmt: skip
        given = ["--colour", "0.05,0.3,0.6,0.9", "--length", "1", "--g", str(g)]
        rows = convert("--from", "appleseed-glass", *given)
        assert [row["scattered"] for row in rows] == pytest.approx(wanted, abs=2e-9)


def test_a_walk_without_an_interface_shows_the_colour():
    """Blender 4's in a beam: the medium of the typed colours, index 1, has the wanted ones."""
    given = ["--colour", "0.8,0.5,0.3", "--length", "1", "--g", "0.5"]
    rows = convert("--from", "openpbr", *given, "--eta", "1.5", "--to", "cycles")
    typed = ",".join(repr(row["colour"]) for row in rows)
    free = convert("--from", "materialx", "--colour", typed, *given[2:], "--eta", "1")
    assert [row["shown"] for row in free] == pytest.approx([0.8, 0.5, 0.3], abs=1e-6)


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


MTLX = """<?xml version="1.0"?><materialx version="1.39"><open_pbr_surface name="m" type="surfaceshader">
<input name="subsurface_color" type="color3" colorspace="srgb_texture" value="0.735357, 0.5, 0.2"/>
<input name="subsurface_radius" value="2"/> <input name="subsurface_radius_scale" value="1, 0.5, 0.25"/>
</open_pbr_surface><open_pbr_surface name="other"><input name="subsurface_radius" value="9"/></open_pbr_surface>
</materialx>"""
GLTF = """{"asset": {"version": "2.0"}, "materials": [{"extensions": {"KHR_materials_ior": {"ior": 1.4},
"KHR_materials_scatter": {"multiscatterColorFactor": [0.5, 0.5, 0.5], "scatterAnisotropy": 0.2},
"KHR_materials_volume": {"attenuationDistance": 0.001, "attenuationColor": [0.36787944, 0.5, 0.9]}}}]}"""
PBRT = """Material "subsurface" "rgb reflectance" [ .5 .4 .3 ] "rgb mfp" [1 2 3] "float eta" 1.4 "string name" "x" """


def test_files_of_others(tmp_path):
    def read(name: str, text: str) -> list[dict[str, float]]:
        (tmp_path / name).write_text(text)
        return convert("--from", name, str(tmp_path / name))

    rows = read("openpbr", MTLX)
    assert [1 / (row["sigma_a"] + row["sigma_s"]) for row in rows] == pytest.approx([2, 1, 0.5])
    assert rows[0]["shown"] == pytest.approx(0.5, abs=1e-6) and rows[0]["eta"] == 1.5
    rows = read("gltf", GLTF)
    lengths = [1, 1 / math.log(2), 1 / -math.log(0.9)]
    assert [1 / (row["sigma_a"] + row["sigma_s"]) for row in rows] == pytest.approx(lengths)
    assert rows[0]["g"] == 0.2 and rows[0]["eta"] == 1.4
    rows = read("pbrt", PBRT)
    assert [row["shown"] for row in rows] == pytest.approx([0.5, 0.4, 0.3])
    rows = read("pbrt", PBRT.replace("[1 2 3]", "[2]"))
    assert [1 / (row["sigma_a"] + row["sigma_s"]) for row in rows] == pytest.approx([2, 2, 2])
    rows = read("pbrt", 'Material "diffuse" "rgb mfp" [9 9 9] Material "subsurface" "rgb reflectance" [.5 .4 .3]')
    assert [1 / (row["sigma_a"] + row["sigma_s"]) for row in rows] == pytest.approx([1, 1, 1]) and rows[0]["eta"] == 1.33
    rows = read("gltf", GLTF.replace('"scatterAnisotropy"', '"scatterStrengthFactor": 0.5, "scatterAnisotropy"')
                .replace('[{"extensions"', '[{}, {"extensions"'))  # fmt: skip
    given = ["--colour", "0.25,0.25,0.25", "--length", "1", "--g", "0.2", "--eta", "1.4"]
    assert [row["scattered"] for row in rows] == pytest.approx(
        [row["scattered"] for row in convert("--from", "gltf", *given)])
    rows = read("openpbr", '<m><open_pbr_surface><input name="subsurface_color" value=".4,.4,.4"/></open_pbr_surface></m>')
    assert [1 / (row["sigma_a"] + row["sigma_s"]) for row in rows] == pytest.approx([1, 0.5, 0.25])
    (row,) = read("gltf", GLTF.replace("[0.5, 0.5, 0.5]", "[0.5]").replace("[0.36787944, 0.5, 0.9]", "[0.36787944]"))
    assert 1 / (row["sigma_a"] + row["sigma_s"]) == pytest.approx(1)


def test_native_forms_need_three_channels():
    for more, says in (["--colour", ".5,.4"], "three channels"), (["--colour", ".5,.4,.3", "--g", "0,.1,.2"], "one g and eta"):
        given = ["--from", "openpbr", *more, "--length", "1", "--to", "gltf", "--format", "native"]
        assert says in dipole("convert", *given, status=2).stderr


@pytest.mark.parametrize("name", ["openpbr", "gltf", "pbrt"])
def test_broken_files_are_refused(tmp_path, name):
    """Files that end early, and one that is not there."""
    text = {"openpbr": MTLX, "gltf": GLTF, "pbrt": PBRT[:45]}[name]
    for length in range(0, len(text) - 1, 23):
        (tmp_path / "part").write_text(text[:length])
        dipole("convert", "--from", name, str(tmp_path / "part"), status=1)
    wrong = {"openpbr": (MTLX.replace('value="0.735357, 0.5, 0.2"', 'nodegraph="NG"'), "connected to a node"),
             "gltf": (GLTF.replace("_scatter", "_sheen"), "no material has the extension"),
             "pbrt": (PBRT.replace("[ .5 .4 .3 ]", "[]"), "reflectance is")}[name]  # fmt: skip
    for text, says in wrong, ("", "is empty"):
        (tmp_path / "wrong").write_text(text)
        assert says in dipole("convert", "--from", name, str(tmp_path / "wrong"), status=1).stderr
    assert "cannot read" in dipole("convert", "--from", name, str(tmp_path / "none"), status=1).stderr
