"""Inversion: the media have the given albedos and lengths, whatever else is asked; a request of any
size is answered in turns, in parts and in time."""

from __future__ import annotations

import dipole
import numpy as np
import pytest
from dipole import Draw, Medium, inversion, wire
from frames import INVERT, SKIN, ask, assert_refused, assert_serves, frame, invert_payload, refused
from known import receive_answer
from lists import MODELS

INVERTED = INVERT | wire.REPLY
ALBEDOS = np.array([1e-6, 0.003, 0.05, 0.2, 0.5, 0.8, 0.97, 0.9999])
LENGTHS_MM = np.array([0.01, 0.1, 0.7, 1.0, 3.0, 10.0, 100.0, 1000.0])


def lengths_of(inversion: dipole.Inversion) -> dict[str, np.ndarray]:
    """Returns the lengths of media, by the formulas of PROTOCOL.md."""
    sigma_t_prime = inversion.sigma_a + inversion.sigma_s * (1 - inversion.g)
    absorbed = inversion.sigma_a / sigma_t_prime
    with np.errstate(divide="ignore"):
        return {
            "mean-free-path": 1 / sigma_t_prime,
            "diffuse-mean-free-path": 1 / (sigma_t_prime * np.sqrt(3 * absorbed / (1 + absorbed))),
            "classical-diffuse-path": 1 / np.sqrt(3 * inversion.sigma_a * sigma_t_prime),
        }


# ---- values --------------------------------------------------------------------------------------


GIVEN = ["mean-free-path", "diffuse-mean-free-path", "classical-diffuse-path"]


@pytest.mark.parametrize("given", GIVEN)
@pytest.mark.parametrize("model", ["classical", "better", "extended", "better+single", "burley"])
def test_media_have_the_albedos_and_lengths(client, model, given):
    """Checks the albedos of the media by an eval, which computes them independently."""
    for g, eta in ((0.0, 1.3), (0.9, 1.0), (-0.5, 2.0)):
        found = client.invert(model, ALBEDOS, LENGTHS_MM, given=given, g=g, eta=eta)
        reached = ALBEDOS <= found.albedo_most
        assert found.missing == np.count_nonzero(~reached)
        judged = client.eval(model, found.media[reached], wanted=["albedo"])
        np.testing.assert_array_equal(judged.albedo, found.albedo[reached])
        np.testing.assert_allclose(found.albedo[reached], ALBEDOS[reached], rtol=1e-12)
        np.testing.assert_allclose(
            lengths_of(found)[given][reached], LENGTHS_MM[reached], rtol=1e-13
        )
        assert np.all(np.isnan(found.sigma_a[~reached]) & np.isnan(found.sigma_s[~reached]))


def test_costly_models(client):
    """The albedo of the model quantized jumps when a Gaussian is added, so it has few digits."""
    found = client.invert("quantized", [0.05, 0.5, 0.9], 1.0)
    judged = client.eval("quantized", found.media, wanted=["albedo"])
    np.testing.assert_array_equal(judged.albedo, found.albedo)
    np.testing.assert_allclose(found.albedo, [0.05, 0.5, 0.9], rtol=1e-7)


@pytest.mark.parametrize("model", ["beam", "beam+single"])
def test_slow_models(client, model):
    """The profiles of slow models are prepared on other threads, and are kept."""
    found = client.invert(model, [0.1, 0.5, 0.8], [1.0, 0.5, 2.0], eta=1.41)
    judged = client.eval(model, found.media, wanted=["albedo"])
    np.testing.assert_array_equal(judged.albedo, found.albedo)
    np.testing.assert_allclose(found.albedo, [0.1, 0.5, 0.8], rtol=1e-12)


@pytest.mark.parametrize("g", [0.0, 0.8, 0.97])
def test_transport(client, g):
    """The albedo alone, which is all that the search asks for, has the bits of a profile's."""
    wanted = [0.9999, 0.7, 0.3, 1e-3] if g < 0.95 else [0.7]  # each is solved
    found = client.invert("transport", wanted, 1.0, eta=1.4, g=g)
    np.testing.assert_allclose(found.albedo, wanted, rtol=1e-11)
    how = {"evaluator": "f64", "tolerance": 1e-2} if g > 0.95 else {}  # solved, which takes a second
    judged = client.eval("transport", found.media, wanted=["albedo"], **how)
    np.testing.assert_array_equal(judged.albedo, found.albedo)


def test_a_palette_by_transport(client):
    """Media of 100 colours take half a second of a processor, not half a minute."""
    wanted = np.linspace(0.05, 0.95, 100)
    found = client.invert("transport", wanted, 1.0, eta=1.3)
    np.testing.assert_allclose(found.albedo, wanted, rtol=1e-12)


def test_skin_comes_back(client):
    for channel in client.media()["skin1"]:
        albedo = client.eval("better", channel, wanted=["albedo"]).albedo
        path = 1 / (channel.sigma_a + channel.sigma_s)
        found = client.invert("better", albedo, path, eta=channel.eta)
        np.testing.assert_allclose(found.media[0], channel, rtol=1e-10, atol=0)


def test_white(client):
    found = client.invert("better", [1.0], [2.0])
    assert found.sigma_a[0] == 0 and found.sigma_s[0] == 0.5 and found.albedo[0] == 1
    for given in ("diffuse-mean-free-path", "classical-diffuse-path"):
        none = client.invert("better", [1.0, 0.5], [2.0, 2.0], given=given)
        assert none.missing == 1 and list(np.isnan(none.sigma_a)) == [True, False]


@pytest.mark.parametrize("g", [0.0, 0.5, 0.97])
def test_transport_to_both_ends(client, g):
    wanted = [1.0, 1 - 1e-8, 0.99999996, 0.0] if g == 0 else [1.0, 0.0]
    found = client.invert("transport", wanted, 2.0, g=g)
    np.testing.assert_allclose(found.albedo, wanted, rtol=1e-12, atol=0)
    how = {"evaluator": "f64", "tolerance": 1e-2} if g > 0.95 else {}  # solved, which takes a second
    judged = client.eval("transport", found.media, wanted=["albedo"], **how)
    np.testing.assert_array_equal(judged.albedo, found.albedo)
    assert found.sigma_a[0] == found.sigma_s[-1] == 0 and found.sigma_a[-1] == 0.5
    assert found.albedo_most == 1 and found.missing == 0
    black = client.invert("better", [0.0], [1.0], given="diffuse-mean-free-path")
    assert lengths_of(black)["diffuse-mean-free-path"] == 1.0


def test_out_of_reach(client):
    found = client.invert("single", [0.01, 0.5, 0.0, 1.0], 1.0)
    assert list(np.isnan(found.sigma_a)) == [False, True, False, True]
    assert list(np.isnan(found.albedo)) == [False, True, False, True]
    assert found.missing == 2 and 0 < found.albedo_least < 0.01 < found.albedo_most < 0.1


@pytest.mark.parametrize("g", [1 - 2**-53, 1 - 2**-50, -1 + 2**-53])
def test_g_next_to_1(client, g):
    """sigma_s is sigma_s' / (1 - g), up to 9e15 times as much; it is found where it is in range."""
    found = client.invert("better", [0.5, 0.5], [1e3, 1e-14], g=g, eta=1.3)
    medium = Medium(found.sigma_a[0], found.sigma_s[0], g, 1.3)
    assert client.eval("better", medium, [1.0]).albedo[0] == pytest.approx(0.5, rel=1e-12)
    assert medium.sigma_a + medium.sigma_s * (1 - g) == pytest.approx(1e-3, rel=1e-12)
    assert (found.missing == 1) == np.isnan(found.sigma_s[1]) == (g > 0)


def test_shapes(client):
    """The albedos are a texture, with one length for each of its channels."""
    texture = np.random.default_rng(3).uniform(0.05, 0.95, (4, 5, 3))
    found = client.invert("better", texture, [1.0, 0.5, 0.25], g=0.8)
    assert found.sigma_a.shape == found.sigma_s.shape == found.albedo.shape == texture.shape
    assert found.media.shape == (4, 5, 3, 4)
    one = client.invert("better", texture[2, 3, 1], 0.5, g=0.8)
    assert one.sigma_a.shape == ()
    assert one.sigma_a == found.sigma_a[2, 3, 1] and one.sigma_s == found.sigma_s[2, 3, 1]
    with pytest.raises(dipole.ArgumentError, match="albedo, length"):
        client.invert("better", [0.1, 0.2], [1.0, 2.0, 3.0])
    with pytest.raises(dipole.ArgumentError, match="length paths"):
        client.invert("better", 0.1, 1.0, given="paths")


def test_what_is_found_is_what_an_eval_and_a_sample_take(client):
    found = client.invert("better", [0.4, 0.7], [1.0, 2.0])
    assert client.eval("better", found.media, [1.0]).R.shape == (2, 1)
    assert client.sample("better", found.media, draw=Draw(5)).r.shape == (2, 5)


def test_answers_that_do_not_fit_are_not_taken(client):
    """A client refuses a reply that does not fit its request, because its caller relies on the
    shape."""
    asked = {"model": 2, "moments": 1, "given": 1, "medium_count": 4, "g": 0.0, "eta": 1.3}
    right = {
        "model": 2,
        "moments": 1,
        "given": 1,
        "part": 0,
        "part_count": 2,
        "count": 3,
        "first": 0,
        "missing_count": 1,
        "albedo_least": 0.0,
        "albedo_most": 1.0,
    }

    def payload(**changes) -> bytes:
        fixed = {**right, **changes}
        return wire.INVERT_REPLY.pack(**fixed) + bytes(24 * min(fixed["count"], 9))

    last = {"part": 1, "count": 1, "first": 3}
    wrong = [{"model": 1}, {"moments": 2}, {"given": 2}, {"part": 1}, {"part_count": 1}]
    wrong += [{"count": 4}, {"count": 0}, {"first": 1}, {"missing_count": 4}]
    for changes in wrong:
        with pytest.raises(dipole.ProtocolError):
            inversion.Answer(asked, (4,), client.info).add(payload(**changes))
    for changes in ({"albedo_most": 0.5}, {"first": 2}, {"count": 2}, {"part": 0}):
        answer = inversion.Answer(asked, (4,), client.info)
        answer.add(payload())
        with pytest.raises(dipole.ProtocolError):
            answer.add(payload(**{**last, **changes}))
    for cut in (payload()[:-8], payload()[:40]):
        with pytest.raises(dipole.ProtocolError):
            inversion.Answer(asked, (4,), client.info).add(cut)
    answer = inversion.Answer(asked, (4,), client.info)
    answer.add(payload())
    assert not answer.ended and not answer.ready
    answer.add(payload(**last))
    assert answer.ended and answer.ready.popleft().missing == 2
    with pytest.raises(dipole.ProtocolError):
        answer.add(payload(**last))


# ---- requests that are wrong ---------------------------------------------------------------------

WRONG = {
    **refused("bad-value", "model", "classical", {"0": invert_payload(model=0)}),
    **refused("bad-value", "moments", "exact", {"9": invert_payload(moments=9)}),
    **refused("bad-value", "given", "1 (mean-free-path)", {
        "0": invert_payload(given=0), "4": invert_payload(given=4)
    }),
    **refused("bad-value", "zero", "0", {"1": invert_payload(zero=1)}),
    **refused("bad-value", "g", "1", {f"{g}": invert_payload(g=g) for g in (1.0, -1.0, np.nan)}),
    **refused("bad-value", "eta", "0.001", {"0": invert_payload(eta=0.0)}),
    **refused("bad-value", "eta", "2.485", {"fit": invert_payload(moments=2, eta=3.0)}),
    **refused("bad-count", "medium_count", "at least 1", {"none": invert_payload([], [])}),
    **refused("bad-count", "medium_count", "as many", {
        **{f"{n:#x}": invert_payload(medium_count=n) for n in (1, 3, 2**60, 2**60 + 2, 2**64 - 1)},
        "odd": invert_payload([0.5], [1, 2]),
        "trailing bytes": invert_payload() + bytes(8),
        "cut": invert_payload()[:-8],
    }),
    **refused("bad-length", "payload_bytes", "at least 32", {"none": b"", "short": bytes(24)}),
    **refused("bad-value", "albedo", "0 to 1", {
        f"{albedo}": (invert_payload([0.5, albedo]), 1)
        for albedo in (-0.5, -1e-300, np.nextafter(1, 2), 1.1, np.inf, np.nan)
    }),
    **refused("bad-value", "length", "1e-14 to 1e14", {
        f"{length}": (invert_payload(lengths=[1.0, length]), 1)
        for length in (0.0, -1.0, 0.9e-14, 1.1e14, np.inf, np.nan)
    }),
    **refused("bad-value", "model", "covers all radii", {
        "a fit": invert_payload(model=MODELS["gaussians"]),
    }),
    **refused("bad-value", "model", "depends on the medium", {
        "the same for every medium": invert_payload(model=MODELS["skin-red"]),
    }),
    **refused("bad-value", "thickness", "slab", {
        "a slab": invert_payload(model=MODELS["multipole"]),
    }),
    **refused("too-large", "medium_count", "at most 64 media of a model that takes long", {
        "slow": invert_payload([0.5] * 65, [1.0] * 65, model=MODELS["beam"]),
    }),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(connection, name):
    assert_refused(connection, INVERT, *WRONG[name])


def test_as_many_slow_ones_as_media_are_allowed(daemon):
    with daemon("--max-media", "2").client() as client:
        assert client.invert("beam", [0.5, 0.6], 1.0).missing == 0
        with pytest.raises(dipole.Refused) as caught:
            client.invert("beam", [0.5, 0.6, 0.7], 1.0)
        assert caught.value.field == "medium_count" and "at most 2" in caught.value.allowed


# ---- large requests ------------------------------------------------------------------------------


def test_in_parts_the_same_bits(daemon):
    """A reply has the same bits when it fits into a frame exactly and when it is cut into parts."""
    one = daemon("--max-frame-bytes", "65536", "--max-part-bytes", "8192")
    whole = daemon()
    room = (65536 - wire.INVERT_REPLY.bytes) // 24
    texels = np.random.default_rng(5).uniform(0.0, 1.0, room + 1)
    texels[::100] = 1.0  # An albedo of 1 has no diffuse path.
    how = {"given": "diffuse-mean-free-path", "g": 0.3}
    with one.client() as small, whole.client() as large, one.connect() as connection:
        at_once = large.invert("better", texels, 1.5, **how)
        assert at_once.missing == len(texels[::100])
        for count, parts in ((room, 1), (room + 1, 9)):
            in_parts = small.invert("better", texels[:count], 1.5, **how)
            for name in ("sigma_a", "sigma_s", "albedo"):
                np.testing.assert_array_equal(
                    getattr(in_parts, name), getattr(at_once, name)[:count]
                )
            assert in_parts.missing == np.count_nonzero(texels[:count] == 1.0)
            payload = invert_payload(texels[:count], [1.5] * count, given=2, g=0.3)
            connection.send_bytes(frame(INVERT, 77, payload))
            first, received = receive_answer(connection)
            assert first.type == INVERTED and len(received) == parts
            assert parts == 1 or all(len(part) <= 8192 for part in received)
        alone = [large.invert("better", texel, 1.5, **how).sigma_a for texel in texels[:20]]
        np.testing.assert_array_equal(alone, at_once.sigma_a[:20])


@pytest.mark.parametrize("isa", ["portable", "sse2"])
def test_every_instruction_set_finds_the_same(daemon, client, isa):
    with daemon("--isa", isa).client() as other:
        for model in ("classical", "extended", "classical+single"):
            one, two = (some.invert(model, ALBEDOS, 1.0, g=0.2) for some in (client, other))
            np.testing.assert_array_equal(one.media, two.media)


def test_leaving_while_it_is_searched(daemon):
    one = daemon("--workers", "1")
    for model in ("better", "transport"):
        with one.connect() as leaving:
            payload = invert_payload([0.5] * 50, [1.0] * 50, model=MODELS[model])
            leaving.send_bytes(frame(INVERT, 1, payload))
    with one.connect() as connection:
        assert_serves(connection)
        assert ask(connection, INVERT, invert_payload([0.5], [1.0])).type == INVERTED


def test_behind_another(daemon):
    """Requests of one connection are answered in their order."""
    with daemon().connect() as connection:
        payloads = [invert_payload([0.1 * i, 0.5], [1.0, 1.0]) for i in range(1, 10)]
        alone = [ask(connection, INVERT, payload).payload for payload in payloads]
        frames = [frame(INVERT, i, payload) for i, payload in enumerate(payloads)]
        connection.send_bytes(b"".join(frames))
        for i in range(len(payloads)):
            reply = connection.receive_frame()
            assert (reply.request_id, reply.payload) == (i, alone[i])
        assert ask(connection, wire.MESSAGES["eval"], bytes(8)).type == wire.TYPE_ERROR
        assert_serves(connection)


def test_a_client_asks_again_when_the_daemon_is_gone(daemon):
    """Clients repeat invert and sample requests when the daemon is gone: every daemon gives the
    same answer."""
    one = daemon()
    with dipole.Client(one.url("unix"), retry_s=20.0) as client:
        before = client.invert("better", 0.5, 1.0), client.sample("better", SKIN, draw=Draw(5))
        client._connection.socket.shutdown(2)
        after = client.invert("better", 0.5, 1.0), client.sample("better", SKIN, draw=Draw(5))
        assert before[0].sigma_a == after[0].sigma_a
        np.testing.assert_array_equal(before[1].r, after[1].r)
