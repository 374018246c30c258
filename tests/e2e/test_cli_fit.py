"""dipole fit: reads readings by column names, and tells of each sample what was found, or why it is
no success."""

import json

import numpy as np
import pytest
from command_line import BAD_ROWS, dipole
from command_line import read_csv as rows
from dipole import Medium
from pictures import svg_texts

AT_MM = np.array([0.5, 1.0, 2.0, 4.0])
MEDIA = {"milk": Medium(0.01, 1.5, 0.0, 1.4), "skin": Medium(0.05, 1.0, 0.0, 1.4)}
OPTIONS = ["--model", "better", "--eta", "1.4"]


@pytest.fixture(scope="module")
def readings(slave) -> dict[str, np.ndarray]:
    with slave.client() as client:
        return {name: client.eval("better", one, AT_MM).R[0] for name, one in MEDIA.items()}


def lines(name: str, R: np.ndarray, at=AT_MM, error: float = 0.01) -> str:
    return "".join(f"{name},{r!r},{v!r},{error * v!r}\n" for r, v in zip(at.tolist(), R.tolist()))


# ---- what is found -------------------------------------------------------------------------------


def test_which_g_are_tried_and_what_no_change_is_told_of(slave):
    """A g is left out that transport's table does not hold. No change is told where readings see g."""
    cases = {  # g and the relative error: the sides, and whether changes are told
        (-0.5, 0.1): ("above", True), (0, 0.1): ("both", True), (0.9, 0.1): ("both", True),
        (0.93, 0.1): ("below", True), (0.9, 0.0003): ("both", False),
    }  # fmt: skip
    at, changes = AT_MM + 0.5, ("sigma_a_by_g", "sigma_s_prime_by_g")
    with slave.client() as client:
        R = client.eval("transport", Medium(0.02, 10, 0.9, 1.4), at).R[0]
    text = ["".join(line + f",{g}\n" for line in lines(f"{g} {error}", R, at, error).splitlines())
            for g, error in cases]
    run = ["fit", "--eta", "1.4", "--format", "csv", "--model"]
    found = rows(dipole(*run, "transport", stdin="sample,r,R,error,g\n" + "".join(text)).stdout)
    assert {row["status"] for row in found} == {"fitted"}
    assert [(row["g_sides"], row[name] != "") for row in found for name in changes] == [
        case for case in cases.values() for _ in changes]
    seen = rows(dipole(*run, "better", stdin="sample,r,R,error,g\n" + "".join(text[:-1])).stdout)
    assert {row["g_sides"] for row in seen} == {"both"}  # no g is seen
    assert all(float(row[name]) < 1e-8 for row in seen for name in changes)


def test_an_aperture_of_the_file_and_of_an_option(readings):
    R = (0.05 * readings["milk"]).tolist()
    places = list(zip(AT_MM.tolist(), R, strict=True))
    plain = "".join(f"{name},{r},{v!r},{0.02 * v!r},\n" for name in "ab" for r, v in places)
    wide = "".join(f"b,{r},{v!r},{0.02 * v!r},0.3\n" for r, v in places)
    head = "sample,r,R,error,detector_na\n"
    arguments = ["--model", "transport", "--eta", "1.4", "--format", "csv", "--detector-na", "0.22"]
    a, b = rows(dipole("fit", *arguments, stdin=head + plain).stdout)
    assert {**a, "sample": ""} == {**b, "sample": ""}
    mixed = head + plain[: len(plain) // 2] + wide
    first, second = rows(dipole("fit", *arguments, stdin=mixed).stdout)
    assert first == a and second["sigma_a"] != b["sigma_a"]
    arguments[arguments.index("csv")] = "json"
    told = json.loads(dipole("fit", *arguments, stdin=mixed).stdout)["rows"]
    assert all(0.005 < sample["model_error"] < 0.04 for sample in told)
    table = dipole("fit", "--model", "transport", "--eta", "1.4", "--detector-na", "0.22", stdin=mixed)
    assert f" {told[0]['model_error']:.1e} " in table.stdout
    run = dipole("fit", "--model", "better", "--eta", "1.4", stdin=head + wide, status=BAD_ROWS)
    assert "sample b: bad-value: detector_na: allowed: nothing but with transport" in run.stderr


# ---- pictures ------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n", "\x85", "\x1b", "\\\n", "'", "''", '"'])
def test_a_name_is_no_command(readings, tmp_path, end):
    """gnuplot runs the next line of a text that is not closed, and what ` and @ hold; four quotes
    end a text in quotes, though two do not."""
    name = f'a{end} . system("touch hit") . {end}; `touch hit` @hit #{end}'
    cell = '"' + name.replace('"', '""') + '"'
    files = ["--plot", "a.svg", "--plot", "a.png", "--plot", "-"]
    text = "sample,r,R,error\n" + lines(cell, readings["milk"])
    shown = dipole("fit", *OPTIONS, *files, stdin=text, cwd=tmp_path).stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "a.svg"]
    clean = "".join(one if one.isprintable() else "?" * len(one.encode()) for one in name)
    assert clean in svg_texts(tmp_path / "a.svg")
    assert clean in shown
