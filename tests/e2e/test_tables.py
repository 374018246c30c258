"""Tables that a client fetches and evaluates itself give the daemon's bits at every radius."""

import functools
import math
import pickle
import re
import zlib

import dipole
import numpy as np
import pytest
from daemons import REPOSITORY
from dipole import Medium, Table, wire
from frames import SKIN
from lists import MODELS, NOTES


# Towards the source, R is constant or grows like -ln r or 1 / r. Far away, it falls like 1 / r^3 or
# is 0.
CASES = {
    "constant": ("better", Medium(*SKIN)),
    "logarithm": ("beam", Medium(0.1, 5.0, 0.7, 1.4)),
    "one over r": ("better+single", Medium(1.0, 1.0, 0.5, 1.5)),
    "burley": ("burley", Medium(0.01, 1.0)),
    "no absorption": ("classical", Medium(0.0, 1.0)),
    "no scattering": ("better", Medium(1.0, 0.0)),
    "transport": ("transport", Medium(*SKIN)),
    "large unit": ("better", Medium(1e9, 1e12)),
    "small unit": ("better", Medium(1e-12, 1e-9)),
    "no medium": ("skin-green", Medium(1.0, 1.0)),
}


@pytest.fixture(params=CASES)
def case(request) -> tuple[str, Medium]:
    return CASES[request.param]


@functools.cache
def radii(first: float, last: float) -> np.ndarray:
    """Returns thousands of radii of all magnitudes, and radii around the ends of the pieces."""
    random = np.random.default_rng(20120101)
    first_mm, last_mm = np.float32(first), np.float32(last)
    edges = [0.0, -0.0, math.inf, 2.0**-149, 3e-42, 2.0**-126, 3.4028235e38]
    edges += [first_mm, np.nextafter(first_mm, np.float32(0)), last_mm]
    edges += [np.nextafter(last_mm, np.float32(0)), np.nextafter(last_mm, np.float32(np.inf))]
    drawn = [10 ** random.uniform(-45, 38.5, 3000), 10 ** random.uniform(-5, 3, 3000)]
    octaves = 2.0 ** np.arange(-149, 128)
    return np.concatenate([edges, *drawn, octaves]).astype(np.float32)


def assert_same_bits(table: Table, client: dipole.Client, model: str, medium: Medium, **how):
    r = radii(table.pieces_from_mm, table.pieces_to_mm)
    wanted = ["R", "cdf", "pdf", "2_pi_r_R"]
    answer = client.eval(model, medium, r, evaluator="lut", wanted=wanted, **how)
    for name, found in [
        ("R", table.R(r)),
        ("cdf", table.cdf(r)),
        ("pdf", table.pdf(r)),
        ("2_pi_r_R", table.ring(r)),
    ]:
        assert found.dtype == np.float32
        different = found.view(np.uint32) != answer.values[name][0].view(np.uint32)
        assert not different.any(), (name, r[different][:5])


# ---- the same bits -------------------------------------------------------------------------------


def test_same_bits_as_the_daemon(client, case):
    model, medium = case
    assert_same_bits(client.table(model, medium), client, model, medium)


@pytest.mark.parametrize("model", ["better", "better+single", "transport"])
def test_the_errors_of_the_daemon(client, model):
    table = client.table(model, SKIN)
    for r in ([0.0, 1e-12, 0.1, 2.5, 1e4, math.inf], [0.1, 1.0, 3.0], [300.0]):
        wanted = ["R", "cdf", "pdf", "2_pi_r_R", "albedo", "S"]
        there = client.eval(model, SKIN, r, evaluator="lut", wanted=wanted).errors
        for name in wanted:
            here, asked = table.errors(r, name), [float(one[0]) for one in there[name]]
            assert [*here][:2] == asked[:2] and here[0] > 0, (name, r)
            assert not here.model_error < 0.999 * asked[2]  # a table has those of bands of radii


def test_the_tolerances_of_the_documents(client):
    """They say which tolerances tables are built to, and which is the default, as dipole.h does."""
    header = " ".join((REPOSITORY / "clients/c/dipole.h").read_text().split())
    number = r"(\S+)"
    said = re.search(
        rf"built to: at least {number}, by default {number}\. "
        rf"A value above {number} counts as {number}\. \*/",
        header,
    )
    least, usual, most, same = map(float, said.groups())
    assert most == same
    for path, range_end, default in (
        ("proto/PROTOCOL.md", "to 1,", "Default: "), ("proto/REGISTERS.md", "to 1 (", "default "),
        ("clients/packaging/man/dipole.1", "to 1 (", "default: "),
    ):  # fmt: skip
        text = (REPOSITORY / path).read_text()
        for part in (f"{said[1]} {range_end}", f"above {said[3]} counts as {said[3]}", default + said[2]):
            assert part in text, (path, part)

    def ask(**tolerance: float) -> bytes:
        radii = [0.1, 0.5, 1, 3, 10]
        return client.eval("transport", SKIN, radii, evaluator="lut", **tolerance).R.tobytes()

    assert ask() == ask(tolerance=usual) != ask(tolerance=least)
    assert ask(tolerance=2 * most) == ask(tolerance=most) != ask(tolerance=usual)
    with pytest.raises(dipole.Refused, match=f"tolerance: allowed is {said[1]} to 1 with lut"):
        ask(tolerance=0.99 * least)


@pytest.mark.skipif("gaussians" not in MODELS, reason="built without the model")
def test_radii_that_a_model_does_not_cover(client):
    range_of = {"fit_from": 0.5, "fit_to": 8.0}
    table = client.table("gaussians", SKIN, parameters=range_of)
    assert table.radius_most_mm < math.inf
    r = np.float32([table.radius_least_mm, 1.0, table.radius_most_mm])
    answer = client.eval("gaussians", SKIN, r, evaluator="lut", parameters=range_of)
    assert table.R(r).tobytes() == answer.R[0].tobytes()
    with pytest.raises(dipole.ArgumentError) as caught:
        table.R(9.0)
    assert "to 8 mm" in str(caught.value)


def test_shapes(client):
    table = client.table("better", SKIN)
    assert "better" in repr(pickle.loads(pickle.dumps(table)))
    assert table.R(1.0).shape == () and table.R([[1.0, 2.0]]).shape == (1, 2)
    assert table.cdf([]).shape == (0,) and table.radius(0.5).shape == ()
    assert table.R(1).dtype == np.float32
    r = np.linspace(0, 5, 7)  # Other types are first rounded to float32.
    assert table.R(r).tobytes() == table.R(r.astype(np.float32)).tobytes()
    strided = np.linspace(0, 5, 14, dtype=np.float32)[::2]
    assert table.pdf(strided).tobytes() == table.pdf(strided.copy()).tobytes()
    assert table.numerical_error([0.0, math.inf]).shape == (2,)
    far = client.eval("better", SKIN, [50.0], evaluator="lut").numerical_error()
    assert table.numerical_error(50.0) == far[0, 0] > table.errors(50.0).numerical_error_constant
    for wrong in (-1.0, math.nan, [1.0, -1e-40]):
        with pytest.raises(dipole.ArgumentError):
            table.R(wrong)
    for wrong in (-1e-40, 1.0000001, math.nan):
        with pytest.raises(dipole.ArgumentError):
            table.radius(wrong)


# ---- facts and files -----------------------------------------------------------------------------


def test_facts(client):
    medium = Medium(0.1, 2.0, 0.5, 1.4)
    table = client.table("better", medium, moments="fit", parameters={"cos_in": 0.5})
    assert (table.layout, table.model, table.moments) == (5, "better", "fit")
    assert (table.model_id, table.moments_id) == (MODELS["better"], 2)
    assert table.medium == medium and table.parameters == {"cos_in": 0.5}
    assert table.notes == ("similarity",) and NOTES["similarity"] == 1
    assert 0 < table.numerical_error_constant <= 1e-4
    assert 0 < table.pieces_from_mm < 1e-6 and 20 < table.pieces_to_mm < 1e4
    assert (table.radius_least_mm, table.radius_most_mm) == (0, math.inf)
    assert len(table.words) % 4 == 0 and table.words.dtype == np.uint32
    assert zlib.crc32(table.words.tobytes()) == wire.TABLE_REPLY.unpack(table.data[24:]).checksum


def test_save_and_load(client, tmp_path):
    first, second = client.table("better", SKIN), client.table("burley", SKIN)
    first.save(tmp_path / "one")
    again = Table.load(tmp_path / "one")
    assert again.data == first.data == (tmp_path / "one").read_bytes()
    assert again.model == MODELS["better"]  # Without the daemon's lists, the table has no names.
    assert Table.load(str(tmp_path / "one"), client.info).model == "better"
    assert Table.load(first.data).R(1.0) == first.R(1.0)
    both = first.data + second.data
    assert [one.model_id for one in Table.load_all(both)] == [first.model_id, second.model_id]
    with pytest.raises(dipole.TableError):
        Table.load(both)
    with pytest.raises(dipole.TableError):
        Table.load_all(b"")
    with pytest.raises(FileNotFoundError):
        Table.load(tmp_path / "none")


def test_damage_is_found(client):
    data = client.table("better", SKIN).data
    random = np.random.default_rng(1)
    for end in random.integers(0, len(data), 50):
        with pytest.raises(dipole.TableError):
            Table.load(data[:end])
    for at in random.integers(wire.HEADER.bytes + wire.TABLE_REPLY.bytes, len(data), 50):
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(random.integers(8))
        with pytest.raises(dipole.TableError, match="checksum"):
            Table.load(bytes(damaged))


# ---- requests ------------------------------------------------------------------------------------


def test_refusals_in_python(client):
    with pytest.raises(dipole.Refused) as caught:
        client.table("better", SKIN, tolerance=1e-9)
    assert caught.value.field == "tolerance"
    for wrong in ((SKIN, SKIN), [1.0]):
        with pytest.raises(dipole.ArgumentError):
            client.table("better", wrong)
    with pytest.raises(dipole.ArgumentError):
        client.table("better", SKIN, parameters={"tolerance": 1e-3}, tolerance=1e-3)
    with pytest.raises(dipole.ArgumentError):
        client.table("best", SKIN)
    assert client.table("better", SKIN).R(1.0) > 0


def test_a_library_that_is_missing_is_named():
    with pytest.raises(dipole.LibraryError, match="need libdipole: run make, or install it"):
        dipole.library.library("/no/such/library")
