"""Values each of which has a medium of its own: the message varying, and libdipole's clients."""

from __future__ import annotations

import pickle

import dipole
import numpy as np
import pytest
from dipole import Medium, varying, wire
from frames import VARYING, ask, assert_refused, assert_serves, frame, refused, varying_payload
from known import receive_answer
from lists import MODELS

REPLY = VARYING | wire.REPLY
MODELS_THAT_VARY = ["classical", "better", "burley", "burley-dmfp"]
QUANTITIES = ("R", "albedo", "cdf", "pdf", "2_pi_r_R")


def texture(count: int, seed: int = 1) -> dict[str, np.ndarray]:
    """Returns media and radii of all orders of magnitude that renderers meet."""
    source = np.random.default_rng(seed)
    sigma_t = 10 ** source.uniform(-2, 2, count)
    absorbed = 10 ** source.uniform(-5, -0.1, count)
    return {
        "sigma_a": sigma_t * absorbed,
        "sigma_s": sigma_t * (1 - absorbed),
        "r": 10 ** source.uniform(-2, 1, count) / sigma_t,
    }


def bits(result: dipole.Varying) -> list[bytes]:
    arrays = {**result.quantities, **result.coefficients}
    return [array.tobytes() for array in (*arrays.values(), result.statuses)]


# ---- values --------------------------------------------------------------------------------------


@pytest.mark.parametrize("evaluator", ["f64", "f32"])
@pytest.mark.parametrize("model", MODELS_THAT_VARY)
def test_values_are_those_of_an_eval(client, model, evaluator):
    """Each value is within what the reply states of an eval of its medium in double precision."""
    given = texture(40)
    if evaluator == "f32":
        given = {name: np.float32(array).astype(float) for name, array in given.items()}
    for g, eta in ((0.0, 1.3), (0.8, 1.0), (-0.4, 1.7)):
        found = client.varying(
            model, **given, g=g, eta=eta, wanted=QUANTITIES, evaluator=evaluator
        )
        assert np.all(found.statuses == 0) and 0 < found.numerical_error < 1e-4
        for i in range(40):
            medium = Medium(given["sigma_a"][i], given["sigma_s"][i], g, eta)
            exact = client.eval(model, medium, [given["r"][i]], wanted=QUANTITIES)
            known = {"albedo": exact.albedo[0]}
            known |= {name: exact.quantities[name][0, 0] for name in QUANTITIES if name != "albedo"}
            for name, value in known.items():
                allowed = found.numerical_error + 1e-13
                assert abs(found[name][i] - value) <= allowed * abs(value), (name, i, g, eta)


def test_what_is_drawn_has_that_cdf(client):
    given = texture(500)
    u = np.random.default_rng(2).uniform(0.01, 0.99, 500)
    media = {"sigma_a": given["sigma_a"], "sigma_s": given["sigma_s"]}
    drawn = client.varying("better", **media, u=u, wanted=["r", "pdf", "cdf"], evaluator="f64")
    np.testing.assert_allclose(drawn["cdf"], u, rtol=0, atol=1e-12)
    again = client.varying("better", **media, r=drawn["r"], wanted=["pdf"], evaluator="f64")
    np.testing.assert_array_equal(again["pdf"], drawn["pdf"])


@pytest.mark.parametrize("given", ["mean-free-path", "diffuse-mean-free-path"])
def test_media_have_the_colours(client, given):
    colours = np.linspace(0.01, 0.9, 60)
    found = client.varying(
        "better", colour=colours, length=0.7, given=given, g=0.3, eta=1.4, evaluator="f64",
        coefficients=["sigma_a", "sigma_s", "scattered"],
    )
    assert np.all(found.answered) and found.colour_least <= 0.01 and found.colour_most >= 0.9
    inverted = client.invert("better", colours, 0.7, given=given, g=0.3, eta=1.4)
    media = np.stack([found["sigma_a"], found["sigma_s"]], axis=-1)
    for medium, colour in zip(media, colours, strict=True):
        albedo = client.eval("better", Medium(*medium, 0.3, 1.4), wanted=["albedo"]).albedo[0]
        assert abs(albedo - colour) <= 1e-5
    np.testing.assert_allclose(found["sigma_a"], inverted.sigma_a, rtol=2e-3)
    scattered = found["sigma_s"] / (found["sigma_a"] + found["sigma_s"])
    np.testing.assert_allclose(found["scattered"], scattered, rtol=1e-14)
    values = client.varying("better", colour=colours, length=0.7, given=given, g=0.3, eta=1.4,
                            r=0.5, evaluator="f64")
    same = client.varying("better", sigma_a=found["sigma_a"], sigma_s=found["sigma_s"], g=0.3,
                          eta=1.4, r=0.5, evaluator="f64")
    np.testing.assert_array_equal(values["R"], same["R"])


def test_the_surface_reflects_a_part_of_a_colour(client):
    """A colour with what the surface reflects is specular + (1 - specular) times one without."""
    bare = client.varying("better", colour=[0.3, 0.6], length=1.0, eta=1.5, evaluator="f64")
    specular = ((1.5 - 1) / (1.5 + 1)) ** 2
    assert bare.specular == pytest.approx(specular, rel=1e-12)
    whole = [specular + (1 - specular) * colour for colour in (0.3, 0.6)]
    seen = client.varying("better", colour=whole, length=1.0, eta=1.5, specular=True,
                          evaluator="f64")
    np.testing.assert_allclose(seen["sigma_a"], bare["sigma_a"], rtol=1e-10)
    assert seen.colour_least == pytest.approx(specular, abs=1e-6)


def test_transport(client):
    """A surface of transport keeps its tolerance, and media have the colours by the solver."""
    given = texture(400, seed=5)
    media = [Medium(a, s, 0.0, 1.4) for a, s in zip(given["sigma_a"], given["sigma_s"], strict=True)]
    for tolerance in (1e-3, 1e-4):
        found = client.varying("transport", **given, eta=1.4, wanted=["R", "cdf"],
                               evaluator="f64", tolerance=tolerance)
        known = found.statuses == 0
        assert np.count_nonzero(known) > 250 and found.numerical_error < 3 * tolerance
        for i in np.flatnonzero(known)[::25]:
            table = client.eval("transport", media[i], [given["r"][i]], evaluator="lut",
                                tolerance=1e-5)
            allowed = found.numerical_error + max(one.numerical_error[0] for one in table.errors.values())
            assert found["R"][i] == pytest.approx(table.R[0, 0], rel=allowed)
            assert found["cdf"][i] == pytest.approx(table.cdf[0, 0], rel=allowed)
    colours = np.linspace(0.01, 0.97, 12)
    found = client.varying("transport", colour=colours, length=1.0, eta=1.4, evaluator="f64")
    for sigma_a, sigma_s, colour in zip(found["sigma_a"], found["sigma_s"], colours, strict=True):
        solved = client.eval("transport", Medium(sigma_a, sigma_s, 0.0, 1.4), wanted=["albedo"],
                             evaluator="lut")
        assert abs(solved.albedo[0] - colour) < 1e-5


def test_a_surface_is_prepared_once(daemon):
    with daemon().client() as client:
        for tolerance in (1e-3, 1e-3, 1e-4):
            client.varying("transport", sigma_a=0.1, sigma_s=1.0, r=1.0, tolerance=tolerance)
        assert client.statistics()["cache_builds"] == 2


# ---- statuses ------------------------------------------------------------------------------------


def test_a_value_that_is_wrong_is_named_and_the_others_are_answered(client):
    nan = np.nan
    sigma_a = [0.1, -1, nan, 0.1, 0.1, 0.1, 0.1, np.inf, 0.1]
    sigma_s = [1.0, 1.0, 1.0, -1, nan, 1e9, 1.0, 1.0, 1.0]
    r = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1, 1.0, nan]
    names = ["ok", "sigma_a", "sigma_a", "sigma_s", "sigma_s", "sigma_s", "radius", "sigma_a",
             "radius"]
    statuses = client.info.choices["value"]
    for evaluator in ("f64", "f32"):
        found = client.varying("better", sigma_a=sigma_a, sigma_s=sigma_s, r=r,
                               wanted=["R", "albedo"], coefficients="sigma_a", evaluator=evaluator)
        assert [statuses[name].id for name in names] == found.statuses.tolist()
        for array in (found["R"], found["albedo"], found["sigma_a"]):
            np.testing.assert_array_equal(np.isnan(array), ~found.answered)
        assert set(found.faults) == set(names) - {"ok"}
        alone = client.varying("better", sigma_a=0.1, sigma_s=1.0, r=1.0, evaluator=evaluator)
        assert found["R"][0] == alone["R"]
    drawn = client.varying("better", sigma_a=0.1, sigma_s=1.0, u=[0.5, -0.1, 1.1, nan])
    assert drawn.statuses.tolist() == [0, *[statuses["number"].id] * 3]


def test_colours_without_a_medium_are_not_clamped(client):
    colours = [0.5, 1.5, -0.1, np.nan]
    found = client.varying("better", colour=colours, length=[1.0, 1.0, 1.0, 1.0])
    colour = client.info.choices["value"]["colour"].id
    assert found.statuses.tolist() == [0, colour, colour, colour]
    assert np.isnan(found["sigma_a"]).tolist() == [False, True, True, True]
    found = client.varying("better", colour=0.5, length=[1.0, 0.0, -1.0, np.nan, 1e30], r=1.0)
    length = client.info.choices["value"]["length"].id
    assert found.statuses.tolist() == [0, length, length, length, length]
    assert np.isnan(found["R"]).tolist() == [False, True, True, True, True]


# ---- the same bits -------------------------------------------------------------------------------


@pytest.mark.parametrize("evaluator", ["f64", "f32"])
def test_the_same_bits_in_every_grouping(client, evaluator):
    given = texture(5000)
    options = {"wanted": QUANTITIES, "evaluator": evaluator}
    whole = client.varying("better", **given, **options)
    for size in (1, 3, 7, 255, 257, 2049):
        for begin in range(0, 5000, 1117):
            cut = {name: array[begin : begin + size] for name, array in given.items()}
            part = client.varying("better", **cut, **options)
            for name in QUANTITIES:
                expected = whole[name][begin : begin + size]
                assert part[name].tobytes() == expected.tobytes(), (size, begin, name)


def test_in_parts_the_same_bits(daemon):
    """A reply has the same bits when it fits into a frame and when it is cut into parts."""
    one = daemon("--max-frame-bytes", "131072", "--max-part-bytes", "16384")
    given = texture(4000)
    given["sigma_a"][::100] = -1
    options = {"wanted": QUANTITIES, "coefficients": ["sigma_a"], "evaluator": "f64"}
    with one.client() as small, daemon().client() as large, one.connect() as connection:
        whole = large.varying("better", **given, **options)
        parted = small.varying("better", **given, **options)
        assert bits(whole) == bits(parted)
        assert np.count_nonzero(~whole.answered) == 40
        # The error of a part holds for its values, that of a whole for all of them.
        assert 0 < parted.numerical_error <= whole.numerical_error
        media = list(zip(given["sigma_a"], given["sigma_s"], strict=True))
        wanted = sum(large.info.choices["quantity"][name].id for name in QUANTITIES)
        payload = varying_payload(media, given["r"], wanted=wanted, coefficients=1)
        connection.send_bytes(frame(VARYING, 77, payload))
        first, received = receive_answer(connection)
        assert first.type == REPLY and len(received) > 1
        assert all(len(part) <= 16384 for part in received)


@pytest.mark.parametrize("isa", ["portable", "sse2"])
def test_every_instruction_set_gives_the_same_bits(daemon, client, isa):
    given = texture(3000)
    u = np.random.default_rng(3).uniform(0, 1, 3000)
    media = {"sigma_a": given["sigma_a"], "sigma_s": given["sigma_s"]}
    with daemon("--isa", isa).client() as other:
        for model in MODELS_THAT_VARY:
            for evaluator in ("f64", "f32"):
                both = [
                    bits(one.varying(model, **given, wanted=QUANTITIES, evaluator=evaluator))
                    + bits(one.varying(model, **media, u=u, wanted=["r"], evaluator=evaluator))
                    + bits(one.varying(model, colour=u, length=1.0, evaluator=evaluator))
                    for one in (client, other)
                ]
                assert both[0] == both[1], (model, evaluator)


# ---- requests that are wrong ---------------------------------------------------------------------

COLOURED = {"given": 1, "light": 1, "wanted": 0, "coefficients": 3, "numbers": None}

WRONG = {
    **refused("bad-length", "payload_bytes", "at least 48", {"none": b"", "short": bytes(40)}),
    **refused("bad-value", "model", "classical", {"0": varying_payload(model=0)}),
    **refused("bad-value", "model", "media vary", {
        "a slab's": varying_payload(model=MODELS["single"]),
    }),
    **refused("bad-value", "evaluator", "f64 or f32", {
        "0": varying_payload(evaluator=0), "lut": varying_payload(evaluator=3),
    }),
    **refused("bad-value", "moments", "exact", {"9": varying_payload(moments=9)}),
    **refused("bad-value", "given", "mean-free-path", {"9": varying_payload(given=9)}),
    **refused("bad-value", "light", "beam", {
        "0": varying_payload(given=1), "3": varying_payload(given=1, light=3),
    }),
    **refused("bad-value", "light", "0 where", {"1": varying_payload(light=1)}),
    **refused("bad-value", "specular", "0 where", {"1": varying_payload(specular=1)}),
    **refused("bad-value", "specular", "0 or 1", {
        "2": varying_payload(given=1, light=1, specular=2),
    }),
    **refused("bad-value", "wanted", "at least one", {"none": varying_payload(wanted=0)}),
    **refused("bad-value", "wanted", "sum of", {"unknown": varying_payload(wanted=0x4000)}),
    **refused("bad-value", "wanted", "numbers u", {
        "dR_dr": varying_payload(wanted=16),
        "r of radii": varying_payload(wanted=8),
        "R without radii": varying_payload(numbers=None),
    }),
    **refused("bad-value", "coefficients", "sum of", {"8": varying_payload(coefficients=8)}),
    **refused("bad-value", "zero", "0", {"1": varying_payload(zero=1)}),
    **refused("bad-value", "g", "1", {f"{g}": varying_payload(g=g) for g in (1.0, -1.0, np.nan)}),
    **refused("bad-value", "eta", "0.001", {"0": varying_payload(eta=0.0)}),
    **refused("bad-value", "parameter", "one of", {
        "unknown": varying_payload(parameters=[(99, 1.0)]),
    }),
    **refused("bad-count", "parameter_count", "no more", {
        "too many": varying_payload(parameter_count=100),
    }),
    **refused("bad-count", "value_count", "as many", {
        **{f"{n:#x}": varying_payload(value_count=n) for n in (1, 3, 2**60, 2**61, 2**64 - 1)},
        "trailing bytes": varying_payload() + bytes(8),
        "cut": varying_payload()[:-8],
    }),
    **refused("bad-value", "r", "padding", {
        "not zero": varying_payload(((0.1, 1.0),), (1.0,), evaluator=2)[:-1] + b"\1",
    }),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(connection, name):
    assert_refused(connection, VARYING, *WRONG[name])


def test_no_values(connection):
    reply = ask(connection, VARYING, varying_payload((), ()))
    assert reply.type == REPLY
    fixed = wire.VARYING_REPLY.unpack(reply.payload)
    assert (fixed.count, fixed.answered_count, fixed.part_count) == (0, 0, 1)
    assert_serves(connection)


# ---- the Python client ---------------------------------------------------------------------------


def test_shapes(client):
    """Arrays of any shapes are broadcast: a texture with a length for each of its channels."""
    colours = np.random.default_rng(3).uniform(0.05, 0.9, (4, 5, 3))
    found = client.varying("better", colour=colours, length=[1.0, 0.5, 0.25], g=0.8)
    assert found["sigma_a"].shape == found.statuses.shape == colours.shape
    one = client.varying("better", colour=colours[2, 3, 1], length=0.5, g=0.8)
    assert one["sigma_a"].shape == () and one["sigma_a"] == found["sigma_a"][2, 3, 1]
    assert "better" in repr(found)
    for options in ({"sigma_a": 1.0}, {"colour": 1.0}, {"sigma_a": 1.0, "colour": 1.0}, {},
                    {"sigma_a": 1.0, "sigma_s": 1.0, "r": 1.0, "u": 0.5},
                    {"sigma_a": [1.0, 2.0], "sigma_s": [1.0, 2.0, 3.0]}):
        with pytest.raises(dipole.ArgumentError):
            client.varying("better", **options)


def test_more_values_than_a_request_holds(client, monkeypatch):
    given = texture(1000)
    whole = client.varying("better", **given)
    monkeypatch.setattr(varying, "VALUES_MOST", 300)
    assert bits(client.varying("better", **given)) == bits(whole)


def test_answers_that_do_not_fit_are_not_taken(client):
    answer_of = next(varying.varying(client._calls, "better", sigma_a=[0.1] * 4, sigma_s=1.0, r=1.0)).answer
    fixed_of = answer_of()._plan.fixed
    right = {
        **{name: fixed_of[name] for name in
           ("model", "evaluator", "moments", "wanted", "coefficients")},
        "notes": 0, "count": 3, "first": 0, "part": 0, "part_count": 2,
        "answered_count": 3, "numerical_error": 0.0, "model_error": 0.0, "colour_least": 0.0,
        "colour_most": 1.0, "specular": 0.0,
    }

    def payload(**changes) -> bytes:
        fixed = {**right, **changes}
        count = min(fixed["count"], 9)
        return wire.VARYING_REPLY.pack(**fixed) + bytes(wire.padded(4 * count) + wire.padded(count))

    wrong = [{"model": 1}, {"wanted": 3}, {"part": 1}, {"part_count": 1}, {"first": 1},
             {"count": 4}, {"count": 5}]
    for changes in wrong:
        with pytest.raises(dipole.ProtocolError):
            answer_of().add(payload(**changes))
    answer = answer_of()
    answer.add(payload())
    assert not answer.ended
    answer.add(payload(part=1, first=3, count=1))
    assert answer.ended


# ---- at home -------------------------------------------------------------------------------------


def awkward(count: int = 3000, g: float = 0.0) -> tuple[np.ndarray, ...]:
    """Returns sigma_a, sigma_s, r and u of all magnitudes, with some that have no answer."""
    dice = np.random.default_rng(20120101)
    sigma_t, ratio = 10 ** dice.uniform(-3, 3, count), 10 ** dice.uniform(-6, 2.2, count)
    ratio[::16] = 0
    sigma_s = sigma_t / (1 + ratio) / (1 - g)
    sigma_a = sigma_t - sigma_s * (1 - g)
    sigma_a[:3] = [-1, np.nan, np.inf]
    sigma_s[3:6] = [-1, 0, np.nan]
    r = 10 ** dice.uniform(-4, 2, count) / sigma_t
    r[6:12] = [0, -0.0, -1, np.nan, np.inf, 1e-30]
    u = dice.uniform(0, 1, count)
    u[6:12] = [0, 1, -0.1, 1.1, 1e-12, 1 - 1e-7]
    return sigma_a, sigma_s, r, u


@pytest.mark.parametrize("evaluator", ["f32", "f64"])
@pytest.mark.parametrize(
    "model, g, eta", [("transport", 0.0, 1.4), ("transport", 0.8, 1.3), ("better", 0.8, 1.3)]
)
def test_a_surface_evaluates_at_home_with_the_same_bits(client, evaluator, model, g, eta):
    surface = client.surface(model, g, eta, evaluator=evaluator)
    sigma_a, sigma_s, r, u = awkward(g=g)
    media = {"sigma_a": sigma_a, "sigma_s": sigma_s, "g": g, "eta": eta, "evaluator": evaluator}
    found = client.varying(model, **media, r=r, wanted=["R", "cdf", "pdf", "2_pi_r_R"])
    for name, values in (("R", surface.R), ("cdf", surface.cdf), ("pdf", surface.pdf),
                         ("2_pi_r_R", surface.ring)):
        assert values(sigma_a, sigma_s, r).tobytes() == found[name].tobytes(), name
    np.testing.assert_array_equal(surface.is_within_error(sigma_a, sigma_s, r),
                                  found.statuses == 0)
    assert np.count_nonzero(found.statuses == 1) < 1500
    assert np.any(found.statuses == 1) == (model == "transport")
    drawn = client.varying(model, **media, u=u)
    assert surface.radius(sigma_a, sigma_s, u).tobytes() == drawn["r"].tobytes()
    assert found.numerical_error <= surface.numerical_error


@pytest.mark.parametrize("evaluator", ["f32", "f64"])
@pytest.mark.parametrize("model", ["transport", "better", "burley-dmfp"])
def test_a_surface_finds_media_at_home_with_the_same_bits(client, model, evaluator):
    dice = np.random.default_rng(20120101)
    colours = dice.uniform(-0.05, 1.05, 1000)
    colours[:9] = [0, 1, np.nan, np.inf, -np.inf, 1e-9, 1 - 1e-7, -0.0, 0.04]
    lengths = 10 ** dice.uniform(-4, 4, 1000)
    lengths[10:16] = [0, -1, np.nan, np.inf, 1e-9, 1e9]
    surface = client.surface(model, 0.5, 1.5, evaluator=evaluator)
    for light in ["beam", "diffuse"] if model == "transport" else ["beam"]:
        for given in client.info.choices["length"]:
            for specular in (False, True):
                found = client.varying(
                    model, colour=colours, length=lengths, light=light, given=given, g=0.5,
                    eta=1.5, specular=specular, evaluator=evaluator,
                    coefficients=["sigma_a", "sigma_s", "scattered"],
                )
                for share in (specular, found.specular if specular else 0.0):
                    how = {"given": given, "light": light, "specular": share}
                    for name, values in surface.media(colours, lengths, **how)._asdict().items():
                        assert values.tobytes() == found[name].tobytes(), (how, name)


def test_a_surface_keeps_shapes_and_its_frame(client, tmp_path):
    surface = client.surface("transport", tolerance=1e-2)
    assert surface.parameters == {"tolerance": 1e-2} and "transport" in repr(surface)
    media = surface.media(np.full((2, 3), 0.5), [1.0, 0.5, 0.25])
    R = surface.R(media.sigma_a, media.sigma_s, 0.5)
    assert R.shape == media.sigma_a.shape == (2, 3) and R.dtype == np.float32
    assert surface.R(0.1, 1.0, 0.5).shape == ()
    surface.save(tmp_path / "surface")
    again = dipole.Surface.load(tmp_path / "surface", client.info, "f64")
    assert again.R(0.1, 1.0, 0.5) == pytest.approx(float(surface.R(0.1, 1.0, 0.5)), rel=1e-5)
    assert dipole.Surface.load(surface.data).model == surface.model_id
    for light, specular in (("diffuse", 0.5), ("moon", False), ("beam", 1.0)):
        with pytest.raises(dipole.ArgumentError):
            surface.media(0.5, 1.0, light=light, specular=specular)
    with pytest.raises(dipole.ArgumentError):
        surface.media(0.5, 1.0, given="miles")
    with pytest.raises(dipole.ArgumentError):
        surface.R([0.1, 0.2], [1.0, 1.0, 1.0], 1.0)
    assert pickle.loads(pickle.dumps(again)).R(0.1, 1.0, 0.5) == again.R(0.1, 1.0, 0.5)
    with pytest.raises(dipole.ArgumentError):
        client.surface("better", evaluator="lut")
    with pytest.raises(dipole.TableError):
        dipole.Table(surface.data)
    with pytest.raises(dipole.TableError):
        dipole.Surface(client.table("better", Medium(0.1, 1.0)).data)
    with pytest.raises(dipole.Refused, match="tolerance"):
        client.surface("transport", tolerance=1e-6)


def test_damaged_surfaces_are_refused(client):
    data = client.surface("transport", tolerance=1e-2).data
    for damaged in (data[:-1], data + b"\0", data[:100], b"", data[:-1] + b"\xff"):
        with pytest.raises(dipole.TableError):
            dipole.Surface(damaged)


@pytest.mark.parametrize("model", ["burley", "burley-diffuse", "burley-dmfp"])
def test_an_albedo_in_single_precision_is_within_its_error(client, model):
    media = {"sigma_a": 214.6922607421875, "sigma_s": 64.18435668945312, "eta": 1.4}
    found = client.varying(model, **media, wanted=["albedo"])
    assert abs(float(found["albedo"]) / 0.004059579960877682 - 1) <= found.numerical_error < 4e-7


def test_the_model_error_has_no_array_of_its_own(client):
    how = {"sigma_a": [0.1, 0.2], "sigma_s": 1.0, "r": 1.0, "g": 0.8, "eta": 1.4}
    one = client.varying("transport", wanted=["R", "model_error"], **how)
    assert list(one.quantities) == ["R"]
    assert np.array_equal(one["R"], client.varying("transport", wanted="R", **how)["R"])
