"""Evaluations over Modbus: the same bits as by the binary protocol, errors, tolerances, and media
that take long to prepare."""

import struct

import numpy as np
import pytest
from daemons import eventually
from dipole import Refused
from lists import EVALUATORS, MODELS, MOMENTS, medium_for, thickness
from modbus_master import (
    AT, BAD_ADDRESS, BAD_VALUE, BAD_VALUE_STATUS, BUSY, BUSY_STATUS, DONE, ERROR, IS_BUSY, MIRROR,
    SKIN, SLOW, TCP, WRITE_REGISTER, Tcp, as_doubles, as_floats, as_words, exception, floats,
    input_block, run_job, single, slow_medium, swapped, write_read_pdu,
)

MEDIA = [SKIN, (0.0, 11.6, 0.0, 1.3), (2.5, 1.5, 0.8, 1.5), (1e-3, 30.0, -0.3, 1.0)]


@pytest.fixture
def client(slave):
    """Returns a client of the binary protocol."""
    with slave.client() as one:
        yield one


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
    stated = expected.errors.values()
    wire = [max(one.numerical_error[0] for one in stated),
            max(one.numerical_error_per_mm[0] for one in stated)]
    assert errors[:2].tolist() == wire
    assert np.array_equal(errors[2:], expected.model_error[:1], equal_nan=True)
    bound = as_floats(master.read(AT["NUMERICAL_ERROR"], 2, unit))[0]
    r = as_floats(master.read(AT["DISTANCES"], 2 * count, unit))
    largest = float(r[np.isfinite(r)].max(initial=0))
    assert bound >= wire[0] + wire[1] * largest
    each = as_floats(master.read(AT["NUMERICAL_ERRORS"], 8, unit))
    models = as_floats(master.read(AT["MODEL_ERRORS"], 8, unit))
    for i, name in enumerate(("R", "albedo", "cdf", "S")):
        if name not in expected.errors:
            assert np.isnan([each[i], models[i]]).all()
            continue
        one = expected.errors[name]
        exact = one.numerical_error[0] + one.numerical_error_per_mm[0] * largest
        assert exact <= each[i] <= 1.001 * exact + 2.0**-23
        assert models[i] == pytest.approx(one.model_error[0], rel=1e-6, nan_ok=True)


# ---- the same bits -------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_every_model_has_the_wires_bits(master, client, model):
    unit = 1 + MODELS[model]
    master.write(AT["THICKNESS"], floats(thickness(model)), unit)
    radii = single([0.3, 0.5, 1.0, 2.5, 4.0])
    for medium in map(single, MEDIA):
        try:
            expected = client.eval(model, medium_for(model, medium), radii, evaluator="f32")
        except Refused as refusal:
            block = input_block(1, medium, radii, model=MODELS[model])
            if model == "transport-transmitted":  # only solving finds that T has no digit
                assert run_job(master, unit, block).status == ERROR
            else:
                with exception(BAD_VALUE):
                    run_job(master, unit, block)
            assert master.job(unit).error_address == register_of(refusal)
            continue
        job = run_job(master, unit, input_block(1, medium, radii, model=MODELS[model]))
        assert job.model == MODELS[model]
        assert_equal_answers(master, unit, expected, len(radii))


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
    run_job(master, 64, input_block(1, SKIN, [1.0, 2.0, 3.0]))
    run_job(master, 64, input_block(2, SKIN, [1.0]))
    for name in ("R", "CDF", "DISTANCES"):
        values = as_floats(master.read(AT[name], 100, 64))
        assert np.isfinite(values[0]) and np.isnan(values[1:]).all()


@pytest.mark.parametrize("wanted", range(1, 8))
def test_what_is_wanted(master, client, wanted):
    names = [name for bit, name in [(1, "R"), (2, "albedo"), (4, "cdf")] if wanted & bit]
    master.write_one(AT["WANTED"], wanted, 65)
    run_job(master, 65, input_block(1, SKIN, [1.0, 2.0]))
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
        run_job(master, 73, input_block(1, SKIN, radii, evaluator=EVALUATORS[evaluator]))
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
    run_job(master, 73, input_block(1, SKIN, [1.0]))
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
        run_job(master, 1, block)
        assert_equal_answers(master, 1, expected, 1)


# ---- a tolerance instead of a model --------------------------------------------------------------


TISSUE = (0.05, 9.5, 0.9, 1.4)
TOLERANCES = [(0.3, 3, TISSUE), (0.02, 7, SKIN), (0.01, 1, TISSUE)]


@pytest.mark.parametrize("evaluator", ["f32", "f64"])
@pytest.mark.parametrize("tolerance, wanted, medium", TOLERANCES)
def test_a_tolerance(master, client, evaluator, tolerance, wanted, medium):
    names = ["R", "albedo", "cdf"][: {1: 1, 3: 2, 7: 3}[wanted]]
    radii = single([5.0, 10.0])
    [asked] = single([tolerance])
    how = {"evaluator": evaluator, "tolerance": asked, "wanted": names}
    expected = client.eval(None, single(medium), radii, **how)
    master.write_one(AT["WANTED"], wanted, 66)
    how = {"evaluator": EVALUATORS[evaluator], "tolerance": tolerance}
    job = run_job(master, 66, input_block(1, medium, radii, model=0, **how))
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
    "a slab without thickness": (input_block(4, SKIN, [1.0], model=25), "THICKNESS"),
}


@pytest.mark.parametrize("name", WRONG)
def test_combinations_that_cannot_be(master, name):
    """The whole request is refused. The input registers keep their values, and the output registers
    say why."""
    block, field = WRONG[name]
    run_job(master, 67, input_block(3, SKIN, [2.0]))
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
    job = run_job(master, 67, input_block(5, SKIN, [2.0]))
    assert (job.status, job.done, job.error, job.error_address) == (DONE, 5, 0, 0)
    assert not master.read(AT["ERROR_TEXT"], 40, 67).rstrip(b"\0")


def test_a_distance_that_a_model_does_not_cover(master):
    """If a model does not cover a distance, the error has the address of that distance."""
    master.write(AT["PARAMETER_FIT_FROM"], floats(0.5, 2.0), 68)
    with exception(BAD_VALUE):
        run_job(master, 68, input_block(1, SKIN, [0.6, 1.0, 3.0], model=MODELS["gaussians"]))
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
    for i, one in enumerate(masters):  # whatever other tests have left in the units
        one.write_one(AT["DEFAULTS"], 1, 100 + i * unit_step)
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
        assert run_job(master, 2, input_block(7, SKIN, [1.0])).done == 7  # Other units do not wait.
        job = master.wait()
        assert (job.status, job.done, job.error, job.sequence) == (DONE, 1, 0, 1)
        expected = client.eval("beam", medium, radii, evaluator="lut")
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
        expected = client.eval("beam", medium, radii, evaluator="lut")
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


def test_preparing_that_fails(daemon):
    """A preparation may fail: that a fit does not reach its tolerance shows only then."""
    one = daemon(*TCP)
    with Tcp(one) as master:
        block = input_block(1, SKIN, [1.0], model=MODELS["gaussians"], tolerance=1e-11)
        assert as_words(master.write_read(100, block, 300, 1)) == [IS_BUSY]
        job = master.wait()
        assert (job.status, job.done, job.error) == (ERROR, 0, BAD_VALUE_STATUS)
        assert job.error_address == AT["PARAMETER_TOLERANCE"]
        assert run_job(master, 1, input_block(2, SKIN, [1.0]))[:3] == (DONE, 2, 0)


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
                    master.ask(struct.pack(">BHH", WRITE_REGISTER, 9900, 1))

        ask()
        before = one.allocations()
        ask()
        assert one.allocations() == before
