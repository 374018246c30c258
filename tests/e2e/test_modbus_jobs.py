"""Sample, invert and mc over Modbus, and how jobs of all kinds wait, end and are cancelled."""

import socket
import struct
import time
from typing import NamedTuple

import numpy as np
import pytest
from daemons import eventually
from dipole import Draw, Grid, Medium, Refused, Stack
from lists import EVALUATORS, MODELS, choices
from modbus_master import (
    AT, BAD_ADDRESS, BAD_VALUE, BAD_VALUE_STATUS, BLOCKS, BUSY, BUSY_STATUS, DEADLINE_STATUS, DONE, ERROR, IS_BUSY,
    MIRROR, SKIN, SLOW, TCP, Exception_, Tcp, as_floats, as_words, exception, floats, input_block,
    run_job, single, slow_medium, swapped, words, write_read_pdu,
)
from test_modbus_eval import client  # noqa: F401  (a fixture)

CANCELLED = 4
KINDS = ["SAMPLE", "INVERT", "MC"]
DRAWS, LENGTHS = choices("DRAW"), choices("LENGTH")


class Head(NamedTuple):
    """The first registers of a job's output."""

    status: int
    done: int
    error: int
    error_address: int
    sequence: int
    count: int


def head(master: Tcp, kind: str, unit: int = 1) -> Head:
    return Head(*as_words(master.read(AT[f"{kind}_STATUS".lstrip("_")], 6, unit)))


def ended(master: Tcp, kind: str, unit: int = 1) -> Head:
    """Waits until the job is not busy. Returns the head of its output block."""
    assert eventually(lambda: head(master, kind, unit).status != IS_BUSY)
    return head(master, kind, unit)


def numbers(master: Tcp, field: str, count: int, unit: int = 1) -> np.ndarray:
    return as_floats(master.read(AT[field], 2 * count, unit))


def setting(master: Tcp, unit: int = 1, **registers: int | bytes) -> None:
    """Writes registers by the names of their fields. A value is a number for a single register, or
    the bytes of several."""
    for field, value in registers.items():
        data = value if isinstance(value, bytes) else words(value)
        master.write(AT[field], data, unit)


def set_medium(master: Tcp, unit: int, medium, model: str = "better", evaluator: str = "f32"):
    master.write_one(AT["DEFAULTS"], 1, unit)
    setting(master, unit, MODEL=words(MODELS[model], EVALUATORS[evaluator]))
    setting(master, unit, SIGMA_A=floats(*medium))


# Commits a slow job of a kind. `number` selects a medium that no request has had.
def commit_slow(master: Tcp, kind: str, unit: int = 1, number: int = 1) -> None:
    if kind == "SAMPLE":
        set_medium(master, unit, slow_medium(100 + number), "beam", "lut")
    elif kind == "INVERT":
        set_medium(master, unit, slow_medium(number), "beam", "f64")
        setting(master, unit, INVERT_MEDIUM_COUNT=50)
        setting(master, unit, INVERT_ALBEDO=floats(*np.linspace(0.1, 0.6 + number / 1e4, 50)))
    else:
        set_medium(master, unit, (1e-4, 10.0, 0.9, 1.4))
        setting(master, unit, MC_PHOTONS=floats(1e10))
    master.write_one(AT[f"{kind}_COMMIT"], 7, unit)


@pytest.mark.parametrize("evaluator", EVALUATORS)
@pytest.mark.parametrize("draw", DRAWS)
def test_a_sample_has_the_wires_bits(master, client, draw, evaluator):
    unit = 110 + DRAWS[draw]
    u = single([0.0, 0.25, 0.5, 0.999, 1.0])
    medium = (*SKIN[:2], 0.5, SKIN[3])
    set_medium(master, unit, medium, "classical", evaluator)
    setting(master, unit, SAMPLE_DRAW=words(DRAWS[draw], 5, 0, 3, 0x1234, 0x5678))
    setting(master, unit, SAMPLE_U=floats(*u))
    master.write_one(AT["SAMPLE_COMMIT"], 9, unit)
    assert ended(master, "SAMPLE", unit)[:3] == (DONE, 9, 0)
    rule = None if draw == "list" else Draw(
        5, draw, 0 if draw == "regular" else 0x12345678, 3 if draw == "random" else 0
    )
    how = {"evaluator": evaluator, "draw": rule}
    expected = client.sample("classical", single(medium), u if draw == "list" else None, **how)
    for field, values in [("SAMPLE_R", expected.r), ("SAMPLE_PDF", expected.pdf)]:
        found = numbers(master, field, 50, unit)
        assert found[:5].tobytes() == values[0].astype("f4").tobytes()
        assert np.isnan(found[5:]).all()
    stated = numbers(master, "SAMPLE_NUMERICAL_ERROR", 2, unit)
    largest = expected.r[0][np.isfinite(expected.r[0])].max()
    wire = max(one.numerical_error[0] + one.numerical_error_per_mm[0] * largest
               for one in expected.errors.values())
    assert wire <= stated[0] <= 1.001 * wire + 2.0**-23
    assert stated[1] == pytest.approx(expected.model_error[0], rel=1e-6)
    assert numbers(master, "SAMPLE_PROGRESS", 1, unit).tolist() == [1.0]
    notes = sum(client.info.choices["note"][one].id for one in expected.notes)
    assert notes > 0 and as_words(master.read(AT["SAMPLE_NOTES"], 1, unit)) == [notes]


@pytest.mark.parametrize("given", LENGTHS)
def test_an_invert_has_the_wires_values(master, client, given):
    """One albedo is out of reach, and fewer media than before leave NaN behind."""
    unit, albedos, lengths = 120 + LENGTHS[given], [0.02, 0.9, 0.013], [1.3, 1.0, 0.67]
    set_medium(master, unit, (0, 0, 0.25, 1.4), "single")
    setting(master, unit, INVERT_GIVEN=words(LENGTHS[given], 50), INVERT_COMMIT=1)
    assert ended(master, "INVERT", unit)[:2] == (DONE, 1)
    setting(master, unit, INVERT_MEDIUM_COUNT=3, INVERT_ALBEDO=floats(*albedos))
    setting(master, unit, INVERT_LENGTH=floats(*lengths), INVERT_COMMIT=2)
    assert ended(master, "INVERT", unit) == (DONE, 2, 0, 0, 2, 3)
    how = {"given": given, "g": 0.25, "eta": single([1.4])[0]}
    expected = client.invert("single", single(albedos), single(lengths), **how)
    for field, values in [
        ("INVERT_SIGMA_A", expected.sigma_a), ("INVERT_SIGMA_S", expected.sigma_s),
        ("INVERT_ALBEDO_FOUND", expected.albedo),
    ]:
        found = numbers(master, field, 50, unit)
        assert found[:3].tobytes() == values.astype("f4").tobytes()
        assert np.isnan(found[3:]).all()
    assert as_words(master.read(AT["INVERT_MISSING_COUNT"], 1, unit)) == [expected.missing] == [1]
    reach = numbers(master, "INVERT_ALBEDO_LEAST", 2, unit)
    assert reach.tolist() == [np.float32(expected.albedo_least), np.float32(expected.albedo_most)]
    errors = [expected.sigma_a_error / expected.sigma_a, expected.sigma_s_error / expected.sigma_s]
    stated = numbers(master, "INVERT_NUMERICAL_ERROR", 2, unit)  # and that of the model
    most = np.nanmax(errors) + 2.0**-24, np.nanmax(expected.model_error)
    assert stated == pytest.approx(most, rel=1e-6) and (stated >= most).all()


@pytest.mark.parametrize("thickness, aperture", [(None, 0), (2.0, 0), (None, 0.375)])
@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
def test_an_mc_has_the_wires_values(master, client, spacing, thickness, aperture):
    unit, medium = 130, single([0.1, 0.9, 0.3, 1.3])
    start, stop = single([0.2, 5.0])
    set_medium(master, unit, medium)
    setting(master, unit, MC_SPACING=2 if spacing == "linear" else 3)
    setting(master, unit, RADIUS_START=floats(start, stop), MC_RING_COUNT=7)
    setting(master, unit, MC_PHOTONS=floats(20000), MC_SEED=words(1, 2), MC_ERROR_TOTAL=floats(-1))
    setting(master, unit, PARAMETER_DETECTOR_NA=floats(aperture))
    if thickness is not None:
        setting(master, unit, THICKNESS=floats(thickness))
    setting(master, unit, MC_COMMIT=3)
    assert ended(master, "MC", unit)[:3] == (DONE, 3, 0)
    expected = client.mc(
        (*medium, thickness or 0.0), Grid(start, stop, 8, spacing), photons=20000, seed=0x10002,
        parameters={"detector_na": aperture} if aperture else {},
    )  # fmt: skip
    sides = [("MC_R", "MC_R_ERROR"), ("MC_T", "MC_T_ERROR")]
    for side, fields in enumerate(sides):
        for field, array in zip(fields, (expected.values, expected.errors)):
            found = numbers(master, field, 50, unit)
            assert np.isnan(found[7:]).all()
            if side == 0 or thickness is not None:
                assert found[:7].tobytes() == array[0, side].astype("f4").tobytes()
            else:
                assert np.isnan(found[:7]).all()
    edges = numbers(master, "MC_EDGES", 51, unit)
    assert edges[:8].tobytes() == expected.edges.astype("f4").tobytes()
    assert np.isnan(edges[8:]).all()
    energy = expected.energies[0]
    found = numbers(master, "MC_REFLECTED", 14, unit)
    want = [energy.R.value, energy.R.error, energy.T.value, energy.T.error, energy.absorbed.value]
    want += [energy.absorbed.error, *energy.unscattered, *(part.value for part in energy.under)]
    want += [*(part.value for part in energy.over), energy.unfinished.value, energy.imbalance]
    np.testing.assert_allclose(found, want, rtol=2**-23)
    assert as_words(master.read(AT["MC_STATE"], 1, unit)) == [1]
    progress = numbers(master, "MC_PROGRESS", 5, unit)
    assert progress[:3].tolist() == [1.0, expected.photons, expected.photons]
    np.testing.assert_allclose(
        progress[3:], [expected.error_total, expected.error_rings], rtol=2**-23
    )


def test_two_layers_have_the_wires_values(master, client):
    unit, above, below = 131, single([0.5, 1.0, 0.0, 1.3, 0.5]), single([0.25, 1.5, 0.25, 1.3, 0.75])
    stack, radii = Stack(Medium(*above), Medium(*below)), single([0.5, 1.0, 2.0])
    set_medium(master, unit, above[:4], "transport", "f64")
    setting(master, unit, RADIUS_COUNT=3, RADII=floats(*radii), PARAMETER_TOLERANCE=floats(0.125))
    setting(master, unit, THICKNESS=floats(above[4]), PARAMETER_ETA_BELOW=floats(1.25), WANTED=1 + 2 + 16384)
    setting(master, unit, LAYER_COUNT=2, BELOW_SIGMA_A=floats(*below))
    setting(master, unit, COMMIT=5)
    assert ended(master, "", unit)[:3] == (DONE, 5, 0)
    options = {"evaluator": "f64", "tolerance": 0.125, "parameters": {"eta_below": 1.25}}
    expected = client.eval("transport", stack, radii, wanted=["R", "albedo", "T"], **options)
    assert numbers(master, "R", 3, unit).tobytes() == expected.R.astype("f4").tobytes()
    assert numbers(master, "T", 3, unit).tobytes() == expected.T.astype("f4").tobytes()
    setting(master, unit, RADIUS_START=floats(0.25, 4.0), MC_SPACING=2, MC_RING_COUNT=4, MC_SEED=words(0, 1))
    setting(master, unit, MC_ERROR_TOTAL=floats(-1), MC_PHOTONS=floats(20000), MC_COMMIT=6)
    assert ended(master, "MC", unit)[:3] == (DONE, 6, 0)
    walked = client.mc(stack, Grid(0.25, 4.0, 5), photons=20000, parameters={"eta_below": 1.25})
    assert numbers(master, "MC_T", 4, unit).tobytes() == walked.values[0, 1].astype("f4").tobytes()

    setting(master, unit, WANTED=1, PARAMETER_ETA_BELOW=floats(0.0), PRESET=3 * list(client.media()).index("skin-dark") + 2)
    setting(master, unit, COMMIT=7)
    assert ended(master, "", unit)[:3] == (DONE, 7, 0)
    green = client.media()["skin-dark"][1]
    expected = client.eval("transport", green, radii, wanted="R", evaluator="f64", tolerance=0.125)
    assert numbers(master, "R", 3, unit).tobytes() == expected.R.astype("f4").tobytes()
    for register, value in ((AT["PRESET"], 3 * len(client.media()) + 1), (AT["BELOW_ETA"], None)):
        setting(master, unit, PRESET=value or 0, BELOW_ETA=floats(5.0))
        with pytest.raises(Exception_):
            setting(master, unit, COMMIT=8)
        assert ended(master, "", unit)[:4] == (ERROR, 7, BAD_VALUE_STATUS, register)


@pytest.mark.parametrize("kind", KINDS)
def test_a_job_through_both_sides_of_the_mirror(master, kind):
    """CDAB for floats and uint32."""
    unit = 140 + KINDS.index(kind)
    set_medium(master, unit, (0.1, 0.9, 0.0, 1.3))
    setting(master, unit, MC_PHOTONS=floats(4096))
    side = {"SAMPLE": "SAMPLE_SEED", "INVERT": "INVERT_LENGTH", "MC": "MC_SEED"}[kind]
    master.write(MIRROR + AT[side], swapped(words(0x3F80, 0x1234)), unit)
    assert as_words(master.read(AT[side], 2, unit)) == [0x3F80, 0x1234]
    with exception(BAD_ADDRESS):
        master.write(AT[side], words(1), unit)
    master.write_one(MIRROR + AT[f"{kind}_COMMIT"], 5, unit)
    assert ended(master, kind, unit)[:2] == (DONE, 5)
    first, length = BLOCKS[13 + KINDS.index(kind)]
    plain, mirrored = master.read(first, length, unit), master.read(MIRROR + first, length, unit)
    field = {"SAMPLE": "SAMPLE_R", "INVERT": "INVERT_SIGMA_A", "MC": "MC_R"}[kind]
    at = 2 * (AT[field] - first)
    assert swapped(plain[at : at + 200]) == mirrored[at : at + 200]
    assert plain[:8] == mirrored[:8]


@pytest.mark.parametrize("kind", KINDS)
def test_a_slow_job_says_how_far_it_is_and_can_be_cancelled(daemon, kind):
    one = daemon(*TCP)
    with Tcp(one) as master:
        commit_slow(master, kind)
        assert head(master, kind)[:3] == (IS_BUSY, 0, 0)
        with exception(BUSY):
            master.write_one(AT[f"{kind}_COMMIT"], 8)
        if kind != "SAMPLE":  # A sample prepares one profile, and is then done.
            assert eventually(lambda: 0 < numbers(master, f"{kind}_PROGRESS", 1)[0] < 1)
        # The running job does not delay this one.
        assert run_job(master, 1, input_block(3, SKIN, [1.0]))[:2] == (DONE, 3)
        assert head(master, kind)[:2] == (IS_BUSY, 0)
        master.write_one(AT[f"{kind}_CANCEL"], 1)
        assert as_words(master.read(AT[f"{kind}_CANCEL"], 1)) == [0]
        last = ended(master, kind)
        assert (last.status, last.error) == (CANCELLED, 0)
        if kind == "MC":  # A cancelled Monte Carlo job has results.
            assert last.done == 7 and last.count == 10
            assert as_words(master.read(AT["MC_STATE"], 1)) == [3]
            assert (numbers(master, "MC_R", 10) >= 0).all()
        else:
            assert (last.done, last.sequence) == (0, 0)
        with one.client() as client:
            assert eventually(lambda: client.statistics()["mc_jobs_open"] == 0)
        master.write_one(AT[f"{kind}_CANCEL"], 1)  # there is nothing to end
        assert head(master, kind) == last
        set_medium(master, 1, (0.1, 0.9, 0.0, 1.3))
        setting(master, 1, MC_PHOTONS=floats(4096))
        master.write_one(AT[f"{kind}_COMMIT"], 9)
        assert ended(master, kind)[:3] == (DONE, 9, 0)


def test_an_eval_can_be_cancelled(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master:
        for unit in range(1, 30):
            master.write(100, input_block(1, slow_medium(unit), [1.0], **SLOW), unit)
        master.write_one(AT["CANCEL"], 1, 29)
        assert master.job(29)[:3] == (CANCELLED, 0, 0)
        assert run_job(master, 29, input_block(2, SKIN, [1.0]))[:3] == (DONE, 2, 0)


@pytest.mark.parametrize("kind", ["SAMPLE", "INVERT", "EVAL"])
def test_a_deadline_counts_while_a_job_waits(daemon, kind):
    one = daemon(*TCP)
    prefix = "" if kind == "EVAL" else f"{kind}_"
    with Tcp(one) as master:
        for unit in range(2, 60):
            master.write(100, input_block(1, slow_medium(unit), [1.0], **SLOW), unit)
        master.write_one(AT["DEFAULTS"], 1)
        if kind == "EVAL":
            master.write(AT["DEADLINE_MS"], floats(30.0))
            master.write(100, input_block(7, slow_medium(99), [1.0], **SLOW))
        else:
            model = "beam"
            set_medium(master, 1, slow_medium(99), model, "f64")
            master.write(AT[f"{kind}_DEADLINE_MS"], floats(30.0))
            master.write_one(AT[f"{kind}_COMMIT"], 7)
        status = AT[f"{prefix}STATUS"]
        assert eventually(lambda: as_words(master.read(status, 1)) != [IS_BUSY])
        expected = [ERROR, 0, DEADLINE_STATUS, AT[f"{prefix}DEADLINE_MS"]]
        assert as_words(master.read(status, 4)) == expected
        assert b"more" in master.read(AT[f"{prefix}ERROR_TEXT"], 40)
        assert master.job(59).status == IS_BUSY  # the others go on
        if kind != "EVAL":
            assert master.job()[:3] == (0, 0, 0)


FAULTS = {
    "a model that is fitted": ("SAMPLE", {"MODEL": MODELS["gaussians"]}, "MODEL"),
    "no model": ("SAMPLE", {"MODEL": 0}, "MODEL"),
    "a slab without thickness": ("SAMPLE", {"MODEL": 25}, "THICKNESS"),
    "a profile for every medium": ("INVERT", {"MODEL": MODELS["skin-red"]}, "MODEL"),
    "a list in place of rings": ("MC", {"MC_SPACING": 1}, "MC_SPACING"),
    "rings that run backwards": ("MC", {"RADIUS_START": floats(5.0, 1.0)}, "RADIUS_STOP"),
    "too many photons": ("MC", {"MC_PHOTONS": floats(1e14)}, "MC_PHOTONS"),
    "no medium": ("MC", {"SIGMA_A": floats(0, 0)}, "SIGMA_S"),
    "a phase function without its share": ("MC", {"PARAMETER_PHASE": floats(2)},
                                           "PARAMETER_PHASE_SHARE"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_job_that_cannot_be(master, name):
    """If a commit is refused, the registers of its kind and of the unit say why, and nothing else
    changes."""
    kind, registers, at = FAULTS[name]
    unit = 150 + KINDS.index(kind)
    set_medium(master, unit, (0.1, 0.9, 0.0, 1.3))
    setting(master, unit, **registers)
    before = master.read(300, 2, unit), head(master, kind, unit).sequence
    with exception(BAD_VALUE):
        master.write_one(AT[f"{kind}_COMMIT"], 4, unit)
    job = head(master, kind, unit)
    assert job[0] == ERROR and job.error in (6, 7) and job.error_address == AT[at]
    assert master.job(unit)[2:4] == job[2:4]
    text = master.read(AT[f"{kind}_ERROR_TEXT"], 40, unit)
    assert text.rstrip(b"\0") and text == master.read(AT["ERROR_TEXT"], 40, unit)
    assert as_words(master.read(AT[f"{kind}_COMMIT"], 1, unit)) == [0]
    assert (master.read(300, 2, unit), job.sequence) == before


def test_one_monte_carlo_job_too_many(daemon):
    """The limit of the binary protocol holds for the jobs of both."""
    one = daemon(*TCP, "--max-mc-jobs", "2")
    with Tcp(one) as master:
        for unit in (1, 2):
            commit_slow(master, "MC", unit)
        with exception(BUSY):
            commit_slow(master, "MC", 3)
        assert head(master, "MC", 3)[:3] == (ERROR, 0, BUSY_STATUS)
        assert b"Monte Carlo jobs" in master.read(AT["MC_ERROR_TEXT"], 40, 3)
        with one.client(retry_s=0) as client, pytest.raises(Refused, match="Monte Carlo jobs"):
            client.mc((0.1, 0.9, 0.0, 1.3), Grid(0.0, 1.0, 3), photons=1)
        master.write_one(AT["MC_CANCEL"], 1, 1)
        assert ended(master, "MC", 1).status == CANCELLED
        commit_slow(master, "MC", 3)
        assert head(master, "MC", 3)[:3] == (IS_BUSY, 0, 0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_job_goes_on_when_its_master_leaves(daemon, kind):
    """Even one that needs another profile afterwards, and so another place in the queue."""
    one = daemon(*TCP)
    with Tcp(one) as master:
        commit_slow(master, kind)
        if kind == "INVERT":
            assert numbers(master, "INVERT_PROGRESS", 1)[0] < 0.5
    with Tcp(one) as master:
        if kind == "SAMPLE":
            assert ended(master, kind)[:2] == (DONE, 7)
        else:
            progress = numbers(master, f"{kind}_PROGRESS", 1)[0]
            assert eventually(lambda: numbers(master, f"{kind}_PROGRESS", 1)[0] > progress)


def test_an_mc_ends_when_no_request_names_its_unit(daemon):
    """It keeps its place while a master asks for its progress, and ends with its results so far when
    none has for the idle timeout."""
    one = daemon(*TCP, "--max-mc-jobs", "1", "--modbus-idle-timeout-ms", "2000")
    with Tcp(one) as master:
        commit_slow(master, "MC")
        for _ in range(8):
            one.stand(0.3)
            assert head(master, "MC").status == IS_BUSY
        assert eventually(lambda: numbers(master, "MC_PROGRESS", 1)[0] > 0)
        commit_slow(master, "INVERT")  # jobs that keep no place from others go on
    one.stand(2.0)
    with one.client() as client:
        medium = (0.1, 0.9, 0.0, 1.3)
        assert eventually(lambda: client.statistics()["mc_jobs_open"] == 0)
        client.mc(medium, Grid(0.0, 1.0, 3), photons=1)
    with Tcp(one) as master:
        assert ended(master, "MC").status == CANCELLED
        assert numbers(master, "MC_PHOTONS_WALKED", 1)[0] > 0
        assert head(master, "INVERT").status in (IS_BUSY, DONE)


def test_a_job_is_not_refused_halfway(daemon):
    """An invert that needs its next profile gets it, though its master's waiting places are taken by
    then, as the turn is another master's. A job that begins is refused."""
    one = daemon(*TCP, "--max-waiting-profiles", "1")
    refusals = 0
    with Tcp(one) as master, Tcp(one) as other:
        commit_slow(master, "INVERT")
        for number in range(2, 400):
            for who, first in ((other, 100), (master, 2)):
                unit = first + number % 8
                try:
                    who.write(100, input_block(1, slow_medium(number + first), [1.0], **SLOW), unit)
                except Exception_ as refused:
                    assert refused.code == BUSY
                    refusals += 1
            assert head(master, "INVERT")[:3] == (IS_BUSY, 0, 0)
            if refusals > 20 and numbers(master, "INVERT_PROGRESS", 1)[0] > 0:
                break
        assert refusals > 20
        progress = numbers(master, "INVERT_PROGRESS", 1)[0]
        assert eventually(lambda: numbers(master, "INVERT_PROGRESS", 1)[0] > progress)


def test_stopping_while_jobs_of_all_kinds_run(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master:
        for unit, kind in enumerate(KINDS, 1):
            commit_slow(master, kind, unit)
        assert eventually(lambda: numbers(master, "MC_PROGRESS", 1, 3)[0] > 0)
        one.terminate()
        assert master.is_closed()


# ---- fits ----------------------------------------------------------------------------------------

FIT_AT_MM = (0.5, 1.0, 2.0, 4.0)
FIT_ERROR = 5  # value of the register `status`: the fit is no success


def pairs(values, errors) -> bytes:
    """Values and standard errors in turn."""
    return floats(*np.stack([values, errors], 1).ravel().tolist())


def commit_fit(master: Tcp, unit: int, token: int, values, errors) -> list[int]:
    """Writes readings, commits, and waits. Returns status to fit_status."""
    readings = words(token, 0) + floats(0.0) + pairs(values, errors)
    master.write_read(AT["FIT_COMMIT"], readings, AT["FIT_STATUS"], 8, unit)
    assert eventually(lambda: as_words(master.read(AT["FIT_STATUS"], 1, unit)) != [IS_BUSY])
    return as_words(master.read(AT["FIT_STATUS"], 8, unit))


def fit_results(master: Tcp, unit: int) -> np.ndarray:
    """Returns all registers from sigma_a to the second medium."""
    return as_floats(master.read(AT["FIT_SIGMA_A"], 26, unit))


def expected_results(found) -> np.ndarray:
    own = [found.sigma_a, found.sigma_s_prime, found.sigma_a_error, found.sigma_s_prime_error, found.correlation]
    names = ["chi_squared", "reduced_chi_squared", "factor", "variance_factor", "condition"]
    names += ["second_sigma_a", "second_sigma_s_prime", "second_chi_squared"]
    return np.array(own + [found.sets[n] ** (0.5 if n == "variance_factor" else 1) for n in names])


def test_a_fit_has_the_values_of_the_wire(master, client):
    """Absolute readings, and raw ones with the calibration that the unit keeps."""
    unit, known = 90, (0.01, 1.0, 0.0, 1.3)
    single_known = single(known)
    R = client.eval("better", single((0.03, 1.2, 0.0, 1.3)), FIT_AT_MM).R[0]
    values = np.float32(R * [1.01, 0.99, 1.02, 0.98])
    errors = np.float32(0.02 * R)
    master.write(AT["FIT_READING_COUNT"], words(4) + floats(*FIT_AT_MM), unit)

    def refused(register: str) -> None:
        with exception(BAD_VALUE):
            commit_fit(master, unit, 7, values, errors)
        assert as_words(master.read(AT["FIT_ERROR"], 2, unit)) == [BAD_VALUE_STATUS, AT[register]]

    refused("ETA")  # a fit has no default for it
    master.write(AT["ETA"], floats(1.3), unit)
    assert commit_fit(master, unit, 7, values, errors)[:4] == [DONE, 7, 0, 0]
    assert tuple(as_floats(master.read(AT["FIT_G"], 4, unit))) == single([0, 1.3])
    master.write(AT["DEFAULTS"], words(1), unit)
    master.write(AT["FIT_READING_COUNT"], words(4) + floats(*FIT_AT_MM), unit)
    refused("ETA")
    master.write(AT["ETA"] + MIRROR, floats(1.3)[2:] + floats(1.3)[:2], unit)
    assert commit_fit(master, unit, 7, values, errors) == [DONE, 7, 0, 0, 2, 4, 0, 1]
    eta = single([1.3])[0]
    found = client.fit("better", FIT_AT_MM, values, errors, eta=eta, residuals=True)
    np.testing.assert_allclose(fit_results(master, unit), expected_results(found), rtol=3e-7)
    residuals = as_floats(master.read(AT["FIT_RESIDUAL"], 50, unit))
    np.testing.assert_allclose(residuals[:4], found.residuals, rtol=1e-6)
    (model_error,) = as_floats(master.read(AT["FIT_MODEL_ERROR"], 2, unit))
    assert np.isnan(found.model_error) and np.isnan(model_error)
    assert master.read(AT["FIT_FIT_STATUS_NAME"], 8, unit).rstrip(b"\0") == b"fitted"
    assert np.isnan(residuals[4:]).all()

    reference = np.float32(3 * client.eval("better", single_known, FIT_AT_MM).R[0])
    reference_errors = np.float32(0.01 * reference)
    master.write(AT["FIT_SCALE"], words(3), unit)
    master.write(AT["FIT_REFERENCE_SIGMA_A"], floats(*known[:3]), unit)
    refused("FIT_REFERENCE_ETA")
    master.write(AT["FIT_REFERENCE_ETA"], floats(known[3]), unit)
    master.write(AT["FIT_REFERENCE_READING"], pairs(reference, reference_errors), unit)
    raw, raw_errors = 3 * values, 3 * errors
    assert commit_fit(master, unit, 8, raw, raw_errors)[:2] == [DONE, 8]
    as_double = [array.astype("f8") for array in (raw, raw_errors, reference, reference_errors)]
    ratio = as_double[0] / as_double[2]
    spread = ratio * np.hypot(as_double[1] / as_double[0], as_double[3] / as_double[2])
    found = client.fit("better", FIT_AT_MM, ratio, spread, eta=eta, reference=single_known)
    np.testing.assert_allclose(fit_results(master, unit), expected_results(found), rtol=1e-5)
    assert abs(found.sigma_a - 0.03) < 3 * found.sigma_a_error
    third = AT["FIT_REFERENCE_READING"] + 8
    master.write(third, floats(0.0), unit)
    assert commit_fit(master, unit, 9, raw, raw_errors)[:4] == [ERROR, 8, BAD_VALUE_STATUS, third]


@pytest.mark.parametrize("scale, at_mm", [("absolute", (1.0, 2.0)), ("free", FIT_AT_MM)])
def test_a_second_medium_and_a_factor_have_registers(master, client, scale, at_mm):
    unit, eta = 94, single([1.3])[0]
    R = 2 * client.eval("better", (0.6624, 2.789, 0.0, eta), at_mm).R[0]
    values = np.float32(R / (2 if scale == "absolute" else 1))
    errors = np.float32(0.05 * values)
    master.write(AT["FIT_READING_COUNT"], words(len(at_mm)) + floats(*at_mm), unit)
    setting(master, unit, ETA=floats(1.3), FIT_SCALE=client.info.choices["scale"][scale].id)
    commit_fit(master, unit, 7, values, errors)
    found = client.fit("better", at_mm, values, errors, eta=eta, scale=scale)
    assert found.status == "ambiguous" and (found.factor == pytest.approx(2, rel=1e-5)) == (scale == "free")
    np.testing.assert_allclose(fit_results(master, unit), expected_results(found), rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("count, fibre_mm", [(3, 0), (4, 0), (25, 0), (3, 0.2), (6, 0.2), (25, 0.2)])
def test_one_request_fits_once_the_design_is_prepared(master, client, count, fibre_mm):
    unit, at = 92, np.float32(np.geomspace(0.5, 6, count)).tolist()
    R = client.eval("better", single((0.03, 1.2, 0.0, 1.3)), at).R[0]
    master.write(AT["FIT_READING_COUNT"], words(count) + floats(*at), unit)
    master.write(AT["FIT_SOURCE"], floats(fibre_mm, fibre_mm), unit)
    master.write(AT["ETA"], floats(1.3), unit)
    readings = np.random.default_rng(count).normal(R, 0.02 * R, (20, count))
    for token, values in enumerate(readings, 1):
        written = words(token, 0) + floats(0.0) + pairs(values, 0.02 * R)
        answer = master.write_read(AT["FIT_COMMIT"], written, AT["FIT_STATUS"], 8, unit)
        if token == 1:
            assert eventually(lambda: as_words(master.read(AT["FIT_DONE"], 1, unit)) == [1])
        else:
            assert as_words(answer)[:3] == [DONE, token, 0]


def test_an_answer_that_waits_for_a_fit_ends_with_another_request(slave, client):
    """A slab's fit takes so long that a second master asks meanwhile. The masters before it get
    their answers, whether they have the results or not, and one may leave without its own."""
    unit, at = 93, np.float32([0.5, 1.0, 2.0, 4.0]).tolist()
    R = client.eval("multipole", single((0.03, 1.2, 0.0, 1.3, 5.0)), at).R[0]
    readings = floats(0.0) + pairs(R, 0.02 * R)
    with Tcp(slave) as first, Tcp(slave) as second, Tcp(slave) as leaves:
        setting(first, unit, MODEL=25, ETA=floats(1.3), THICKNESS=floats(5.0))
        first.write(AT["FIT_READING_COUNT"], words(4) + floats(*at), unit)
        for token in range(1, 7):
            master = leaves if token == 6 else first
            written = words(token, 0) + readings
            pdu = write_read_pdu(AT["FIT_COMMIT"], written, AT["FIT_STATUS"], 2)
            master.socket.sendall(master.frame(unit, pdu))
            if token == 6:
                leaves.socket.close()
            else:
                assert as_words(second.read(AT["FIT_STATUS"], 1, unit))[0] in (IS_BUSY, DONE)
                assert as_words(first.receive()[2][2:])[0] in (IS_BUSY, DONE)
            assert eventually(lambda: as_words(second.read(AT["FIT_DONE"], 1, unit)) == [token])
            found = as_floats(second.read(AT["FIT_SIGMA_A"], 4, unit))
            np.testing.assert_allclose(found, [0.03, 1.2], rtol=1e-3)


@pytest.mark.parametrize("model, thickness", [("beam", 0.0), ("multipole", 5.0)])
def test_a_fit_is_done_when_its_master_has_left(slave, client, model, thickness):
    """Each asks for a medium of its own, which the fit has prepared after it has found it, and leaves at
    another moment, by closing or by a reset."""
    unit, at = 94, np.float32([0.5, 1.0, 2.0, 4.0]).tolist()
    with Tcp(slave) as observer:
        setting(observer, unit, MODEL=MODELS[model], ETA=floats(1.3), THICKNESS=floats(thickness))
        observer.write(AT["FIT_READING_COUNT"], words(4) + floats(*at), unit)
        for token in range(1, 9):
            medium = (0.03 + 0.002 * token, 1.25, 0.0, 1.3, thickness)
            R = client.eval(model, single(medium), at).R[0]
            pdu = write_read_pdu(AT["FIT_COMMIT"], words(token, 0) + floats(0.0) + pairs(R, 1e-4 * R), AT["FIT_STATUS"], 2)
            leaves = Tcp(slave)
            if token % 2:
                leaves.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            leaves.socket.sendall(leaves.frame(unit, pdu))
            state = lambda: as_words(observer.read(AT["FIT_STATUS"], 2, unit))  # noqa: E731
            assert eventually(lambda: state()[0] == IS_BUSY or state() == [DONE, token])  # it has arrived
            time.sleep(0.003 * (token % 4))
            leaves.socket.close()
            assert eventually(lambda: state() == [DONE, token])


def test_a_fit_that_is_no_success_is_not_done(master):
    unit = 91
    master.write(AT["ETA"], floats(1.3), unit)
    master.write(AT["FIT_READING_COUNT"], words(4) + floats(*FIT_AT_MM), unit)
    rising = np.array([1e-4, 1e-3, 1e-2, 1e-1])
    head = commit_fit(master, unit, 7, rising, 0.01 * rising)
    assert head[:3] == [FIT_ERROR, 7, 0] and head[7] == 7
    assert master.read(AT["FIT_FIT_STATUS_NAME"], 8, unit).rstrip(b"\0") == b"implausible"
    values = fit_results(master, unit)
    errors = 0.01 * rising
    errors[2] = 0
    head = commit_fit(master, unit, 8, rising, errors)
    assert head[:4] == [ERROR, 7, BAD_VALUE_STATUS, AT["FIT_READING"] + 2 * 5]
    assert master.read(AT["FIT_FIT_STATUS_NAME"], 8, unit).rstrip(b"\0") == b"implausible"  # behind the error's text
    np.testing.assert_array_equal(fit_results(master, unit), values)  # those of the token 7
    master.write(AT["FIT_READING"], floats(-1.0, 0.1), unit)  # noise may make a reading negative
    with exception(BAD_VALUE):
        master.write(AT["FIT_READING_COUNT"], words(1), unit)


# ---- fits of tissues -----------------------------------------------------------------------------

NM = (660.0, 760.0, 800.0, 850.0, 930.0, 970.0)
SOUGHT = {"hbo2_uM": 1, "hb_uM": 2, "water_fraction": 3, "a_per_mm": 32, "b": 33}
TISSUE = {"hbo2_uM": 56, "hb_uM": 24, "water_fraction": 0.6, "a_per_mm": 1.9, "b": 1.2}


@pytest.mark.parametrize("wavelengths", [2, 6])
def test_a_fit_of_a_tissue_has_the_values_of_the_wire(master, client, wavelengths):
    """Readings of a tissue give it back, with the numbers that Python gets for the same readings."""
    unit, places, nm = 96 + wavelengths, single([2.0, 4.0, 7.0, 12.0]), NM[:wavelengths]
    sought = {name: SOUGHT[name] for name in (list(SOUGHT) if wavelengths > 2 else ["hbo2_uM", "hb_uM", "a_per_mm"])}
    given = {name: one for name, one in TISSUE.items() if name not in sought} | {"fat_fraction": 0.25}
    given = {name: single([one])[0] for name, one in given.items()}
    truth = {name: TISSUE[name] for name in sought} | given
    R = client.eval("transport", client.tissue(nm, properties=truth), places, evaluator="f64").R
    values, errors = np.float32(R), np.float32(0.01 * R)
    ids = SOUGHT | {"fat_fraction": 4}
    written = floats(*np.stack([values, errors], -1).ravel().tolist())
    setting(master, unit, MODEL=MODELS["transport"])
    setting(master, unit, TISSUE_WAVELENGTH_COUNT=words(len(nm), len(places), len(given), len(sought)))
    setting(master, unit, TISSUE_PROPERTY=words(*sought.values()), TISSUE_PARAMETER=words(*(ids[n] for n in given)))
    setting(master, unit, TISSUE_VALUE=floats(*given.values()), TISSUE_WAVELENGTH=floats(*nm), TISSUE_AT=floats(*places))
    for token in (7, 8):  # the second fits at once, as the places are prepared
        answer = master.write_read(AT["TISSUE_COMMIT"], words(token, 0) + floats(0.0) + written, AT["TISSUE_STATUS"], 125, unit)
        assert token == 7 or as_words(answer)[:7] == [DONE, 8, 0, 0, 2, values.size, 1]
        assert ended(master, "TISSUE", unit)[:3] == (DONE, token, 0)
    fit = client.fit_tissue(list(sought), nm, places, values, errors, properties=given, residuals=True)
    n, count = len(sought), values.size
    estimates = list(fit.estimates.values())
    same = lambda name, count, known: np.testing.assert_allclose(numbers(master, name, count, unit), known, rtol=1e-6)
    same("TISSUE_ESTIMATE", n, [one["value"] for one in estimates])
    same("TISSUE_ESTIMATE_ERROR", n, [one["error"] for one in estimates])
    same("TISSUE_ESTIMATE_NUMERICAL", n, [one["numerical"] for one in estimates])
    same("TISSUE_COVARIANCE", n * n, fit.covariance.ravel())
    same("TISSUE_RESIDUAL", count, fit.residuals.ravel())
    names = ["saturation", "saturation_error", "total", "total_error"]
    same("TISSUE_SATURATION", 4, [fit.sets[name] for name in names])
    same("TISSUE_G", 2, [0.9, 1.4])
    assert as_words(master.read(AT["TISSUE_FIT_STATUS"], 4, unit)) == [1, 1, 1, 1]
    assert as_words(master.read(AT["TISSUE_ESTIMATE_STATUS"], 8, unit)) == [1] * n + [0] * (8 - n)
    assert np.isnan(numbers(master, "TISSUE_ESTIMATE", 8, unit)[n:]).all()
    for name, value in zip(sought, numbers(master, "TISSUE_ESTIMATE", n, unit)):
        assert value == pytest.approx(TISSUE[name], rel=0.01)


def test_a_fit_of_a_tissue_names_the_register_that_is_wrong(master):
    unit = 95
    setting(master, unit, TISSUE_SOUGHT_COUNT=2, TISSUE_PROPERTY=words(2, 2))
    for fault, register in [({}, "TISSUE_PROPERTY"), ({"TISSUE_PROPERTY": words(1, 35)}, "TISSUE_PROPERTY")]:
        setting(master, unit, **fault)
        with exception(BAD_VALUE):
            master.write_one(AT["TISSUE_COMMIT"], 7, unit)
        assert head(master, "TISSUE", unit)[2:4] == (BAD_VALUE_STATUS, AT[register] + 1)
    with exception(BAD_VALUE):
        setting(master, unit, TISSUE_PROPERTY=words(1, 99))
    with exception(BAD_VALUE):
        setting(master, unit, TISSUE_PROPERTY=words(1, 2), TISSUE_COMMIT=7)
    assert master.read(AT["TISSUE_ERROR_TEXT"], 40, unit).startswith(b"a_per_mm: 0 to 1000")
    setting(master, unit, TISSUE_PROPERTY=words(1, 2), TISSUE_TISSUE=8, TISSUE_PLACE_COUNT=2, TISSUE_AT=floats(2.0, 4.0))
    setting(master, unit, MODEL=MODELS["transport"], TISSUE_READING=floats(*[0.01, 1e-4] * 3, 0.01, 0.0), TISSUE_COMMIT=7)
    assert ended(master, "TISSUE", unit)[:4] == (ERROR, 0, BAD_VALUE_STATUS, AT["TISSUE_READING"] + 14)
