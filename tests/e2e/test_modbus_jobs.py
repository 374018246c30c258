"""Jobs over Modbus: the same bits as by the binary protocol, errors, tolerances, and slow jobs."""

from __future__ import annotations

import struct
import time
from typing import NamedTuple

import numpy as np
import pytest
from daemons import eventually
from dipole import Draw, Grid, Refused
from lists import EVALUATORS, MODELS, MOMENTS, choices, needs
from modbus_master import (
    AT, BAD_ADDRESS, BAD_VALUE, BLOCKS, BUSY, DONE, ERROR, IS_BUSY, MIRROR, TCP, WRITE_REGISTER,
    Exception_, Tcp, as_doubles, as_floats, as_words, exception, floats, input_block, swapped, words,
    write_read_pdu,
)

SKIN = (0.032, 0.74, 0.0, 1.3)
MEDIA = [SKIN, (0.0, 11.6, 0.0, 1.3), (2.5, 1.5, 0.8, 1.5), (1e-3, 30.0, -0.3, 1.0)]
BAD_VALUE_STATUS, BUSY_STATUS = 6, 10


@pytest.fixture
def client(slave):
    """Returns a client of the binary protocol."""
    with slave.client() as one:
        yield one


def single(values) -> tuple[float, ...]:
    """Rounds numbers to float32."""
    return tuple(float(np.float32(value)) for value in values)


def run(master: Tcp, unit: int, block: bytes):
    """Commits a job, waits for its end, and returns the head of the output block."""
    master.write_read(100, block, 300, 8, unit)
    return master.wait(unit)


def register_of(refusal: Refused) -> int:
    """Returns the register from which a field of the request is made."""
    if refusal.field == "r":
        return AT["RADII"] + 2 * refusal.index
    return AT.get(refusal.field.upper()) or AT[f"PARAMETER_{refusal.field.upper()}"]


def assert_equal_answers(master: Tcp, unit: int, expected, count: int) -> None:
    """Checks that the results of a unit are those of a client, bit for bit."""
    job = master.job(unit)
    assert (job.status, job.error, job.count) == (DONE, 0, count)
    for name, values in [("R", expected.R), ("CDF", expected.cdf)]:
        found = as_floats(master.read(AT[name], 100, unit))
        assert found[:count].tobytes() == values[0].astype("f4").tobytes()
        assert np.isnan(found[count:]).all()
        doubles = as_doubles(master.read(AT[name + "_DOUBLE"], 200, unit))
        assert doubles[:count].tobytes() == values[0].astype("f8").tobytes()
    albedo = as_doubles(master.read(AT["ALBEDO_DOUBLE"], 4, unit))[0]
    assert albedo == expected.albedo[0]
    assert as_floats(master.read(AT["ALBEDO"], 2, unit))[0] == np.float32(albedo)
    errors = as_doubles(master.read(AT["NUMERICAL_ERROR_DOUBLE"], 12, unit))
    wire = [expected.numerical_error_constant[0], expected.numerical_error_per_mm[0]]
    assert errors[:2].tolist() == wire
    assert np.array_equal(errors[2:], expected.model_error[:1], equal_nan=True)
    bound = as_floats(master.read(AT["NUMERICAL_ERROR"], 2, unit))[0]
    r = as_floats(master.read(AT["DISTANCES"], 2 * count, unit))
    largest = float(r[np.isfinite(r)].max(initial=0))
    assert bound >= wire[0] + wire[1] * largest


# ---- the same bits -------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_every_model_has_the_wires_bits(master, client, model):
    unit, parameters = 1 + MODELS[model], single(needs(model).values())
    names = dict(zip(needs(model), parameters))
    for name, value in names.items():
        master.write(AT[f"PARAMETER_{name.upper()}"], floats(value), unit)
    radii = single([0.3, 0.5, 1.0, 2.5, 4.0])
    for medium in map(single, MEDIA):
        try:
            expected = client.eval(model, medium, radii, evaluator="f32", parameters=names)
        except Refused as refusal:
            with exception(BAD_VALUE):
                run(master, unit, input_block(1, medium, radii, model=MODELS[model]))
            assert master.job(unit).error_address == register_of(refusal)
            continue
        job = run(master, unit, input_block(1, medium, radii, model=MODELS[model]))
        assert job.model == MODELS[model]
        assert_equal_answers(master, unit, expected, len(radii))


@pytest.mark.parametrize("evaluator", EVALUATORS)
@pytest.mark.parametrize("model", ["better", "transport"])
def test_every_evaluator(master, client, model, evaluator):
    radii = single([0.0, 0.1, 1.0, 10.0] if model == "better" else [0.1, 1.0, 10.0])
    expected = client.eval(model, single(SKIN), radii, evaluator=evaluator)
    block = input_block(1, SKIN, radii, model=MODELS[model], evaluator=EVALUATORS[evaluator])
    job = run(master, 60, block)
    assert job.evaluator == EVALUATORS[evaluator]
    assert_equal_answers(master, 60, expected, len(radii))
    assert as_floats(master.read(AT["DISTANCES"], 2 * len(radii), 60)).tolist() == list(radii)


@pytest.mark.parametrize("moments", MOMENTS)
def test_every_kind_of_moments(master, client, moments):
    expected = client.eval("better", single(SKIN), [1.0], evaluator="f32", moments=moments)
    run(master, 61, input_block(1, SKIN, [1.0], moments=MOMENTS[moments].id))
    assert_equal_answers(master, 61, expected, 1)


@pytest.mark.parametrize("spacing, number", [("linear", 2), ("logarithmic", 3)])
@pytest.mark.parametrize("evaluator", EVALUATORS)
@pytest.mark.parametrize("count", [1, 2, 7, 50])
def test_grids(master, client, spacing, number, evaluator, count):
    start, stop = single([0.1, 7.3])
    grid = Grid(start, stop, count, spacing)
    expected = client.eval("better", single(SKIN), grid=grid, evaluator=evaluator)
    grid = (number, count, start, stop)
    run(master, 62, input_block(1, SKIN, grid=grid, evaluator=EVALUATORS[evaluator]))
    assert_equal_answers(master, 62, expected, count)
    found = as_floats(master.read(AT["DISTANCES"], 2 * count, 62))
    assert found.tobytes() == expected.r.astype("f4").tobytes()


def test_a_list_of_the_most_distances_in_one_request(master, client):
    """The largest request of function 23 writes 120 registers and reads 115."""
    radii = single(np.linspace(0.0, 20.0, 49).tolist() + [np.inf])
    block = input_block(9, SKIN, radii)
    assert len(block) == 2 * 120
    answer = master.write_read(100, block, 300, 115, 63)
    expected = client.eval("better", single(SKIN), radii, evaluator="f32")
    assert as_words(answer[:4]) == [DONE, 9]
    assert as_floats(answer[24:224]).tobytes() == expected.R[0].tobytes()
    assert_equal_answers(master, 63, expected, 50)


def test_fewer_distances_than_before(master):
    """Registers that held values of an earlier answer become NaN."""
    run(master, 64, input_block(1, SKIN, [1.0, 2.0, 3.0]))
    run(master, 64, input_block(2, SKIN, [1.0]))
    for name in ("R", "CDF", "DISTANCES"):
        values = as_floats(master.read(AT[name], 100, 64))
        assert np.isfinite(values[0]) and np.isnan(values[1:]).all()


@pytest.mark.parametrize("wanted", range(1, 8))
def test_what_is_wanted(master, client, wanted):
    names = [name for bit, name in [(1, "R"), (2, "albedo"), (4, "cdf")] if wanted & bit]
    master.write_one(AT["WANTED"], wanted, 65)
    run(master, 65, input_block(1, SKIN, [1.0, 2.0]))
    expected = client.eval("better", single(SKIN), [1.0, 2.0], evaluator="f32", wanted=names)
    for bit, name in [(1, "R"), (4, "cdf")]:
        found = as_floats(master.read(AT[name.upper()], 4, 65))
        values = getattr(expected, name)[0] if wanted & bit else None
        assert np.isnan(found).all() if values is None else found.tolist() == values.tolist()
    albedo = as_floats(master.read(AT["ALBEDO"], 2, 65))[0]
    assert np.isnan(albedo) == (not wanted & 2)


def test_S_at_two_angles(master, client):
    """S can be wanted, and the registers cos_in and cos_out are its angles."""
    cosines = dict(zip(["cos_in", "cos_out"], single([0.9, 0.3])))
    master.write(AT["PARAMETER_COS_IN"], floats(*cosines.values()), 73)
    master.write_one(AT["WANTED"], 1 + 256, 73)
    for evaluator in EVALUATORS:
        radii = single([0.5, 1.0, 2.0])
        run(master, 73, input_block(1, SKIN, radii, evaluator=EVALUATORS[evaluator]))
        how = {"evaluator": evaluator, "wanted": ["R", "S"], "parameters": cosines}
        expected = client.eval("better", single(SKIN), radii, **how)
        single_S = as_floats(master.read(AT["S"], 100, 73))
        double_S = as_doubles(master.read(AT["S_DOUBLE"], 200, 73))
        assert single_S[:3].tobytes() == expected.S[0].astype("f4").tobytes()
        assert double_S[:3].tobytes() == expected.S[0].astype("f8").tobytes()
        assert np.isnan(single_S[3:]).all() and np.isnan(double_S[3:]).all()
        assert swapped(master.read(AT["S"], 100, 73)) == master.read(AT["S"] + MIRROR, 100, 73)
        R = as_floats(master.read(AT["R"], 6, 73))
        assert R.tobytes() == expected.R[0].astype("f4").tobytes()
    master.write_one(AT["WANTED"], 1, 73)
    run(master, 73, input_block(1, SKIN, [1.0]))
    assert np.isnan(as_floats(master.read(AT["S"], 100, 73))).all()


# ---- limits that no float32 hits -----------------------------------------------------------------

AT_LIMITS = {
    "the tolerance of lut": ({"evaluator": "lut"}, {"tolerance": 1e-6}, 1.3),
    "the largest eta of jensen": ({"moments": "jensen"}, {}, 2.2),
    "the least eta of jensen": ({"moments": "jensen"}, {}, 0.46),
    "the largest eta of fit": ({"moments": "fit"}, {}, 2.485),
    "the least eta of pbrt": ({"moments": "pbrt"}, {}, 0.195),
    "the least eta": ({}, {}, 0.001),
}


@pytest.mark.parametrize("name", AT_LIMITS)
def test_the_float32_nearest_to_a_limit_is_the_limit(daemon, name):
    """The float32 that is the nearest to a limit counts as the limit, even if it lies beyond the
    limit. All these limits are inclusive."""
    choice, parameters, eta = AT_LIMITS[name]
    choice = {"evaluator": "f32", "moments": "exact", **choice}
    medium = (*single(SKIN[:3]), eta if eta != SKIN[3] else single([eta])[0])
    one = daemon(*TCP)
    with Tcp(one) as master, one.client() as client:
        expected = client.eval("better", medium, [1.0], parameters=parameters, **choice)
        block = input_block(
            1, medium, [1.0], evaluator=EVALUATORS[choice["evaluator"]],
            moments=MOMENTS[choice["moments"]].id, tolerance=parameters.get("tolerance", 0.0),
        )
        run(master, 1, block)
        assert_equal_answers(master, 1, expected, 1)


# ---- a tolerance instead of a model --------------------------------------------------------------


@pytest.mark.parametrize("evaluator", ["f32", "f64"])
@pytest.mark.parametrize("tolerance", [0.3, 0.02])
@pytest.mark.parametrize("wanted", [3, 7])
@pytest.mark.parametrize("medium", [SKIN, (0.05, 9.5, 0.9, 1.4)], ids=["skin", "g"])
def test_a_tolerance(master, client, evaluator, tolerance, wanted, medium):
    names = ["R", "albedo", "cdf"] if wanted == 7 else ["R", "albedo"]
    radii = single([5.0, 10.0])
    [asked] = single([tolerance])
    how = {"evaluator": evaluator, "tolerance": asked, "wanted": names}
    expected = client.eval(None, single(medium), radii, **how)
    master.write_one(AT["WANTED"], wanted, 66)
    how = {"evaluator": EVALUATORS[evaluator], "tolerance": tolerance}
    job = run(master, 66, input_block(1, medium, radii, model=0, **how))
    assert job.status == DONE
    assert job.model == MODELS[expected.model]
    assert job.evaluator == EVALUATORS[expected.evaluator]
    found = as_doubles(master.read(AT["R_DOUBLE"], 8, 66))
    assert found.tolist() == expected.R[0].astype("f8").tolist()


# ---- combinations that cannot be -----------------------------------------------------------------

WRONG = {
    "neither model nor tolerance": (input_block(4, SKIN, [1.0], model=0), "MODEL"),
    "a tolerance that nothing keeps": (
        input_block(4, SKIN, [1.0], model=0, tolerance=2e-12), "PARAMETER_TOLERANCE"
    ),
    "a grid that runs backwards": (input_block(4, SKIN, grid=(2, 3, 5.0, 1.0)), "RADIUS_STOP"),
    "ratios from 0": (input_block(4, SKIN, grid=(3, 3, 0.0, 1.0)), "RADIUS_START"),
    "nothing there": (input_block(4, (0.0, 0.0, 0.0, 1.3), [1.0]), "SIGMA_S"),
    "a fit that does not hold": (input_block(4, (0.1, 1, 0, 3.0), [1.0], moments=2), "ETA"),
    "a slab without thickness": (input_block(4, SKIN, [1.0], model=25), "PARAMETER_THICKNESS"),
}


@pytest.mark.parametrize("name", WRONG)
def test_combinations_that_cannot_be(master, name):
    """The whole request is refused. The input registers keep their values, and the output registers
    say why."""
    block, field = WRONG[name]
    run(master, 67, input_block(3, SKIN, [2.0]))
    before = master.read(100, 160, 67)
    results = master.read(AT["COUNT"], 120, 67)
    with exception(BAD_VALUE):
        master.write(100, block, 67)
    job = master.job(67)
    assert (job.status, job.done, job.error) == (ERROR, 3, BAD_VALUE_STATUS)
    assert job.error_address == AT[field]
    assert master.read(AT["ERROR_TEXT"], 40, 67).rstrip(b"\0")
    assert master.read(100, 160, 67) == before
    assert master.read(AT["COUNT"], 120, 67) == results
    job = run(master, 67, input_block(5, SKIN, [2.0]))
    assert (job.status, job.done, job.error, job.error_address) == (DONE, 5, 0, 0)
    assert not master.read(AT["ERROR_TEXT"], 40, 67).rstrip(b"\0")


def test_a_distance_that_a_model_does_not_cover(master):
    """If a model does not cover a distance, the error has the address of that distance."""
    master.write(AT["PARAMETER_FIT_FROM"], floats(0.5, 2.0), 68)
    with exception(BAD_VALUE):
        run(master, 68, input_block(1, SKIN, [0.6, 1.0, 3.0], model=MODELS["gaussians"]))
    assert master.job(68).error_address == AT["RADII"] + 4


# ---- tokens --------------------------------------------------------------------------------------


def test_step_by_step(master):
    """A tool may write one register after the other."""
    master.write(AT["SIGMA_A"], floats(0.1), 70)
    master.write_one(AT["RADIUS_COUNT"], 2, 70)
    master.write(AT["RADII"], floats(1.0, 2.0), 70)
    assert master.job(70).status == 0
    master.write_one(AT["COMMIT"], 0, 70)
    assert master.job(70).status == 0
    for sequence, token in enumerate([1, 65535, 65535, 3], 1):
        master.write_one(AT["COMMIT"], token, 70)
        job = master.job(70)
        assert (job.status, job.done, job.sequence, job.count) == (DONE, token, sequence, 2)
        assert as_words(master.read(AT["COMMIT"], 1, 70)) == [token]


@pytest.mark.parametrize("unit_step", [1, 0])
def test_many_masters_at_once(slave, client, unit_step):
    """Many masters, each on its own unit or all on one, read with function 23 the results of the
    job that they wrote."""
    masters = [Tcp(slave) for _ in range(32)]
    media = [(0.01 * (i + 1), 1.0, 0.0, 1.3) for i in range(32)]
    expected = [
        client.eval("better", single(medium), [1.0, 2.0], evaluator="f32").R for medium in media
    ]
    for round in range(20):
        for i, one in enumerate(masters):
            block = input_block(32 * round + i + 1, media[i], [1.0, 2.0])
            pdu = write_read_pdu(100, block, 300, 20)
            one.socket.sendall(one.frame(100 + i * unit_step, pdu))
        for i, one in enumerate(masters):
            _, unit, answer = one.receive()
            assert unit == 100 + i * unit_step
            assert as_words(answer[2:6]) == [DONE, 32 * round + i + 1]
            assert as_floats(answer[26:34]).tobytes() == expected[i].tobytes()
    for one in masters:
        one.socket.close()


# ---- what takes long -----------------------------------------------------------------------------

SLOW = {"model": MODELS["transport"], "evaluator": EVALUATORS["f64"]}


def slow_medium(number: int) -> tuple[float, ...]:
    """Returns a medium that no request has had."""
    return single((0.032 + 1e-3 * number, 0.74, 0.0, 1.3))


def test_busy_then_done(daemon):
    one = daemon(*TCP, "--workers", "1")
    with Tcp(one) as master, one.client() as client:
        medium, radii = slow_medium(1), single([0.5, 1.0])
        answer = master.write_read(100, input_block(1, medium, radii, **SLOW), 300, 12)
        assert as_words(answer[:4]) == [IS_BUSY, 0]
        before = master.read(100, 120)
        with exception(BUSY):
            master.write(100, input_block(2, SKIN, [3.0]))
        job = master.job()
        assert (job.status, job.error, job.error_address) == (IS_BUSY, BUSY_STATUS, AT["COMMIT"])
        assert master.read(100, 120) == before
        assert run(master, 2, input_block(7, SKIN, [1.0])).done == 7  # Other units do not wait.
        job = master.wait()
        assert (job.status, job.done, job.error, job.sequence) == (DONE, 1, 0, 1)
        expected = client.eval("transport", medium, radii, evaluator="f64")
        assert_equal_answers(master, 1, expected, 2)
        again = master.write_read(100, input_block(2, medium, radii, **SLOW), 300, 8)
        # The answer comes at once, because the profile is prepared now.
        assert as_words(again[:4]) == [DONE, 2]


def test_input_may_be_written_while_busy(daemon):
    """Writing the input while the unit is busy does not change the committed job."""
    one = daemon(*TCP)
    with Tcp(one) as master, one.client() as client:
        medium, radii = slow_medium(2), single([0.5, 1.0])
        master.write(100, input_block(1, medium, radii, **SLOW))
        assert master.job().status == IS_BUSY
        master.write(100, input_block(0, SKIN, [3.0, 4.0, 5.0]))
        assert master.wait().done == 1
        expected = client.eval("transport", medium, radii, evaluator="f64")
        assert_equal_answers(master, 1, expected, 2)


def test_a_new_commit_clears_the_error_of_the_one_before(daemon):
    """A new commit clears the error of the job before, also while the unit is busy."""
    with Tcp(daemon(*TCP)) as master:
        with exception(BAD_VALUE):
            master.write(AT["ETA"], floats(0.0))
        assert master.job().error == BAD_VALUE_STATUS
        master.write(100, input_block(1, slow_medium(4), [1.0], **SLOW))
        job = master.job()
        assert (job.status, job.error, job.error_address) == (IS_BUSY, 0, 0)
        assert not master.read(AT["ERROR_TEXT"], 40).rstrip(b"\0")
        assert master.wait()[:3] == (DONE, 1, 0)


def test_a_master_that_leaves_while_busy(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master:
        master.write(100, input_block(1, slow_medium(3), [1.0], **SLOW))
    with Tcp(one) as master:
        assert master.wait()[:2] == (DONE, 1)


def test_stopping_while_busy(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master:
        for unit in range(1, 6):
            master.write(100, input_block(1, slow_medium(10 + unit), [1.0], **SLOW), unit)
        one.terminate()
        assert master.is_closed()


def test_preparing_that_fails(daemon):
    """A preparation may fail: that a fit does not reach its tolerance shows only then."""
    one = daemon(*TCP)
    with Tcp(one) as master:
        block = input_block(1, SKIN, [1.0], model=MODELS["gaussians"], tolerance=1e-11)
        assert as_words(master.write_read(100, block, 300, 1)) == [IS_BUSY]
        job = master.wait()
        assert (job.status, job.done, job.error) == (ERROR, 0, BAD_VALUE_STATUS)
        assert job.error_address == AT["PARAMETER_TOLERANCE"]
        assert run(master, 1, input_block(2, SKIN, [1.0]))[:3] == (DONE, 2, 0)


def test_evaluations_go_through_batches(daemon):
    """Requests of both protocols that arrive together are evaluated together."""
    one = daemon(*TCP, "--workers", "1")
    masters = [Tcp(one) for _ in range(16)]

    def burst() -> bool:
        for i, master in enumerate(masters):
            pdu = write_read_pdu(100, input_block(1, SKIN, [1.0]), 300, 8)
            master.socket.sendall(master.frame(1 + i, pdu))
        for master in masters:
            master.receive()
        counted = client.statistics()
        return counted["batches_evaluated"] < counted["batched_requests"] / 2

    with one.client() as client:
        assert eventually(burst)
    for master in masters:
        master.socket.close()


def test_answering_takes_nothing_from_the_heap(daemon):
    one = daemon(*TCP, counting=True)
    with Tcp(one) as master:
        block = input_block(1, SKIN, [1.0, 2.0])

        def ask() -> None:
            for _ in range(100):
                master.write_read(100, block, 300, 20)
                master.write_one(5, 5)
                with exception(BAD_ADDRESS):
                    master.ask(struct.pack(">BHH", WRITE_REGISTER, 9000, 1))

        ask()
        before = one.allocations()
        ask()
        assert one.allocations() == before


def test_words_are_checked_before_anything_is_written(master):
    """A commit with NaN in the input gets status 3, and the input is not changed."""
    before = master.read(100, 120, 72)
    with exception(BAD_VALUE):
        master.write(100, input_block(1, (0.1, float("nan"), 0.0, 1.3), [1.0]), 72)
    job = master.job(72)
    assert (job.status, job.error_address) == (ERROR, AT["SIGMA_S"])
    assert master.read(100, 120, 72) == before


# ---- sample, invert, mc --------------------------------------------------------------------------

CANCELLED = 4
DEADLINE_STATUS = 12
KINDS = ["SAMPLE", "INVERT", "MC"]
DRAWS, LENGTHS = choices("CORE_DRAW"), choices("CORE_LENGTH")


class Head(NamedTuple):
    """The first registers of a job's output."""

    status: int
    done: int
    error: int
    error_address: int
    sequence: int
    count: int
    place: int


def head(master: Tcp, kind: str, unit: int = 1) -> Head:
    return Head(*as_words(master.read(AT[f"{kind}_STATUS"], 7, unit)))


def ended(master: Tcp, kind: str, unit: int = 1) -> Head:
    """Waits until the job is not busy. Returns the head of its output block."""
    assert eventually(lambda: head(master, kind, unit).status != IS_BUSY, 60)
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
        set_medium(master, unit, slow_medium(100 + number), "transport", "f64")
    elif kind == "INVERT":
        set_medium(master, unit, slow_medium(number), "transport", "f64")
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
    set_medium(master, unit, SKIN, "classical", evaluator)
    setting(master, unit, SAMPLE_DRAW=words(DRAWS[draw], 5, 0, 3, 0x1234, 0x5678))
    setting(master, unit, SAMPLE_U=floats(*u))
    answer = master.write_read(AT["SAMPLE_COMMIT"], words(9), AT["SAMPLE_STATUS"], 7, unit)
    at_once = Head(*as_words(answer))[:3] == (DONE, 9, 0)
    assert at_once or evaluator == "lut"  # A table is prepared first.
    assert ended(master, "SAMPLE", unit)[:3] == (DONE, 9, 0)
    rule = None if draw == "list" else Draw(
        5, draw, 0 if draw == "regular" else 0x12345678, 3 if draw == "random" else 0
    )
    how = {"evaluator": evaluator, "draw": rule}
    expected = client.sample("classical", single(SKIN), u if draw == "list" else None, **how)
    for field, values in [("SAMPLE_R", expected.r), ("SAMPLE_PDF", expected.pdf)]:
        found = numbers(master, field, 50, unit)
        assert found[:5].tobytes() == values[0].astype("f4").tobytes()
        assert np.isnan(found[5:]).all()
    stated = numbers(master, "SAMPLE_NUMERICAL_ERROR", 2, unit)
    largest = expected.r[0][np.isfinite(expected.r[0])].max()
    wire = expected.numerical_error_constant[0] + expected.numerical_error_per_mm[0] * largest
    assert wire <= stated[0] <= 1.001 * wire + 2.0**-23
    assert np.isnan(stated[1])
    assert numbers(master, "SAMPLE_PROGRESS", 1, unit).tolist() == [1.0]


@pytest.mark.parametrize("given", LENGTHS)
def test_an_invert_has_the_wires_values(master, client, given):
    """One albedo is out of reach, and fewer media than before leave NaN behind."""
    unit, albedos, lengths = 120 + LENGTHS[given], [0.02, 0.9, 0.013], [1.3, 1.0, 0.67]
    set_medium(master, unit, (0, 0, 0.25, 1.4), "single")
    setting(master, unit, INVERT_GIVEN=words(LENGTHS[given], 50), INVERT_COMMIT=1)
    assert ended(master, "INVERT", unit)[:2] == (DONE, 1)
    setting(master, unit, INVERT_MEDIUM_COUNT=3, INVERT_ALBEDO=floats(*albedos))
    setting(master, unit, INVERT_LENGTH=floats(*lengths), INVERT_COMMIT=2)
    assert ended(master, "INVERT", unit) == (DONE, 2, 0, 0, 2, 3, 0)
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


@pytest.mark.parametrize("thickness", [None, 2.0])
@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
def test_an_mc_has_the_wires_values(master, client, spacing, thickness):
    unit, medium = 130, single([0.1, 0.9, 0.3, 1.3])
    start, stop = single([0.2, 5.0])
    set_medium(master, unit, medium)
    setting(master, unit, MC_SPACING=2 if spacing == "linear" else 3)
    setting(master, unit, RADIUS_START=floats(start, stop), MC_RING_COUNT=7)
    setting(master, unit, MC_PHOTONS=floats(20000), MC_SEED=words(1, 2), MC_ERROR_TOTAL=floats(-1))
    if thickness is not None:
        setting(master, unit, PARAMETER_THICKNESS=floats(thickness))
    setting(master, unit, MC_COMMIT=3)
    assert ended(master, "MC", unit)[:3] == (DONE, 3, 0)
    expected = client.mc(
        medium, Grid(start, stop, 8, spacing), photons=20000, seed=0x10002, thickness=thickness
    )
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


def test_an_mc_takes_a_phase_function(master, client):
    unit, medium = 133, single([0.125, 8.0, 0.75, 1.375])
    set_medium(master, unit, medium)
    setting(master, unit, RADIUS_START=floats(0, 1), MC_RING_COUNT=5, MC_PHOTONS=floats(20000))
    setting(master, unit, PARAMETER_PHASE=floats(2), PARAMETER_PHASE_SHARE=floats(0.875))
    setting(master, unit, MC_COMMIT=3)
    assert ended(master, "MC", unit)[:3] == (DONE, 3, 0)
    expected = client.mc(
        medium, Grid(0, 1, 6), photons=20000, seed=0,
        parameters={"phase": "modified", "phase_share": 0.875},
    )
    assert (numbers(master, "MC_R", 5, unit) == np.float32(expected.values[0][0])).all()


def test_an_mc_ends_when_its_errors_are_small(master):
    set_medium(master, 131, (0.1, 0.9, 0.0, 1.3))
    setting(master, 131, MC_PHOTONS=floats(1e9), MC_ERROR_TOTAL=floats(0.02))
    setting(master, 131, MC_COMMIT=1)
    assert ended(master, "MC", 131).status == DONE
    assert as_words(master.read(AT["MC_STATE"], 1, 131)) == [2]
    assert 0 < numbers(master, "MC_ERROR_TOTAL_NOW", 1, 131)[0] <= np.float32(0.02)


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
            assert eventually(lambda: 0 < numbers(master, f"{kind}_PROGRESS", 1)[0] < 1, 60)
        # The running job does not delay this one.
        assert run(master, 1, input_block(3, SKIN, [1.0]))[:2] == (DONE, 3)
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
        assert run(master, 29, input_block(2, SKIN, [1.0]))[:3] == (DONE, 2, 0)


@pytest.mark.parametrize("kind", ["SAMPLE", "INVERT"])
def test_a_job_has_a_place_in_the_queue(daemon, kind):
    """One profile is prepared after the other, or two at a time: the last master's place is that of
    all before it, and gets less."""
    one = daemon(*TCP)
    with Tcp(one) as master:
        for unit in range(2, 30):
            master.write(100, input_block(1, slow_medium(unit), [1.0], **SLOW), unit)
        commit_slow(master, kind)
        first = head(master, kind).place
        assert 20 < first <= 28
        assert as_words(master.read(AT["PLACE"], 1, 28))[0] < 28
        assert eventually(lambda: head(master, kind).place < first, 60)
        master.write_one(AT[f"{kind}_CANCEL"], 1)
        assert head(master, kind).place == 0


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
            set_medium(master, 1, slow_medium(99), "transport", "f64")
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
    "a slab without thickness": ("SAMPLE", {"MODEL": 25}, "PARAMETER_THICKNESS"),
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


VALUES = [
    ("SAMPLE_DRAW", words(0)), ("SAMPLE_DRAW", words(5)), ("SAMPLE_SAMPLE_COUNT", words(51)),
    ("SAMPLE_SAMPLE_COUNT", words(0)), ("SAMPLE_U", floats(1.5)), ("SAMPLE_CANCEL", words(2)),
    ("SAMPLE_DEADLINE_MS", floats(-1)), ("INVERT_GIVEN", words(4)),
    ("INVERT_MEDIUM_COUNT", words(51)), ("INVERT_ALBEDO", floats(0.5, 1.5)),
    ("INVERT_LENGTH", floats(0)), ("INVERT_LENGTH", floats(2e14)), ("MC_RING_COUNT", words(0)),
    ("MC_RING_COUNT", words(51)), ("MC_PHOTONS", floats(0)), ("MC_ERROR_TOTAL", floats(1e-10)),
]


@pytest.mark.parametrize("field, data", VALUES)
def test_values_of_jobs_out_of_range(master, field, data):
    with exception(BAD_VALUE):
        master.write(AT[field], data, 160)
    at = AT[field] + (2 if len(data) == 8 else 0)
    assert master.job(160)[2:4] == (BAD_VALUE_STATUS, at)


def test_limits_of_jobs_can_be_reached(master, client):
    """1e14 and 1e-14 mm, and an error of 1e-9, have no float32."""
    set_medium(master, 161, (0, 0, 0.0, 1.3))
    setting(master, 161, INVERT_MEDIUM_COUNT=2, INVERT_LENGTH=floats(1e14, 1e-14), INVERT_COMMIT=1)
    assert ended(master, "INVERT", 161)[:3] == (DONE, 1, 0)
    expected = client.invert("better", [0.5, 0.5], [1e14, 1e-14], eta=single([1.3])[0])
    found = numbers(master, "INVERT_SIGMA_S", 2, 161)
    assert found.tolist() == expected.sigma_s.astype("f4").tolist()
    set_medium(master, 161, (0.1, 0.9, 0.0, 1.3))
    setting(master, 161, MC_PHOTONS=floats(1), MC_ERROR_RINGS=floats(1e-9), MC_COMMIT=2)
    assert ended(master, "MC", 161)[:3] == (DONE, 2, 0)


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
        with one.client() as client, pytest.raises(Refused, match="Monte Carlo jobs"):
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
            assert eventually(lambda: numbers(master, f"{kind}_PROGRESS", 1)[0] > progress, 60)


def test_an_mc_ends_when_no_request_names_its_unit(daemon):
    """It keeps its place while a master asks for its progress, and ends with its results so far when
    none has for the idle timeout."""
    one = daemon(*TCP, "--max-mc-jobs", "1", "--modbus-idle-timeout-ms", "1000")
    with Tcp(one) as master:
        commit_slow(master, "MC")
        begun = time.monotonic()
        while time.monotonic() < begun + 2.5:
            assert head(master, "MC").status == IS_BUSY
        commit_slow(master, "INVERT")  # jobs that keep no place from others go on
    with one.client() as client:
        medium = (0.1, 0.9, 0.0, 1.3)
        assert eventually(lambda: client.statistics()["mc_jobs_open"] == 0, 20)
        client.mc(medium, Grid(0.0, 1.0, 3), photons=1)
    with Tcp(one) as master:
        assert ended(master, "MC").status == CANCELLED
        assert numbers(master, "MC_PHOTONS_WALKED", 1)[0] > 0
        assert head(master, "INVERT").status == IS_BUSY


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
        assert eventually(lambda: numbers(master, "INVERT_PROGRESS", 1)[0] > progress, 60)


def test_stopping_while_jobs_of_all_kinds_run(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master:
        for unit, kind in enumerate(KINDS, 1):
            commit_slow(master, kind, unit)
        assert eventually(lambda: numbers(master, "MC_PROGRESS", 1, 3)[0] > 0)
        one.terminate()
        assert master.is_closed()


def test_slow_jobs_of_many_units_leave_others_their_turns(daemon):
    """Inverts on ten units; an eval of the binary protocol is answered meanwhile."""
    one = daemon(*TCP, "--workers", "1")
    with Tcp(one) as master, one.client() as client:
        for unit in range(1, 11):
            set_medium(master, unit, SKIN, "quantized")
            setting(master, unit, INVERT_MEDIUM_COUNT=20, INVERT_COMMIT=1)
        assert client.eval("better", SKIN, [1.0]).R[0, 0] > 0
        assert head(master, "INVERT", 10).status == IS_BUSY
        for unit in range(1, 11):
            assert ended(master, "INVERT", unit)[:3] == (DONE, 1, 0)
