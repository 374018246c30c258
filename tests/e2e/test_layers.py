"""Media of several layers: the same values through every message, while small requests go on."""


import numpy as np
import pytest
from command_line import dipole, read_csv
from dipole import ArgumentError, Client, Grid, Medium, Points, Refused, Stack
from test_http import post

HALF_SPACE = (0.5, 1.0, 0.0, 1.3)
STACK = Stack(Medium(*HALF_SPACE, 0.7), Medium(*HALF_SPACE))  # a half space that is cut
SKIN = (0.032, 0.74, 0.0, 1.3)
R_MM = [0.5, 1.0, 2.0]


def stacks(seed: int, count: int) -> list[Stack]:
    """Returns random media of two layers."""
    numbers = np.random.default_rng(seed).uniform(0.1, 1.0, (count, 5))
    return [Stack(Medium(a, s, 0.0, 1.3, d), Medium(b, t, 0.0, 1.3)) for a, s, d, b, t in numbers.tolist()]


def test_every_message_has_the_values_of_a_stack(daemon):
    """A half space that is cut has its own values; the messages share one solution of it."""
    one = daemon("--workers", "1", "--http", "127.0.0.1:0")
    with Client(one.url(), timeout_s=200) as client:
        options = {"evaluator": "f64", "tolerance": 1.0}
        cut = client.eval("transport", STACK, R_MM, wanted=["R", "albedo", "cdf"], **options)
        whole = client.eval("transport", HALF_SPACE, R_MM, wanted=["R", "albedo"], evaluator="f64")
        errors = cut.numerical_error(quantity="R") + whole.numerical_error(quantity="R")
        assert (abs(cut.R / whole.R - 1) <= errors).all()
        assert cut.albedo[0] == pytest.approx(whole.albedo[0], rel=1e-4)
        assert cut.model_error.tolist() == [0.0]

        drawn = client.sample("transport", STACK, cut.cdf[0], **options)
        np.testing.assert_allclose(drawn.r[0], R_MM, rtol=1e-9)
        points = Points(np.zeros((1, 3)), np.ones((1, 1)))
        places = np.array([[r, 0.0, 0.0] for r in R_MM])
        parameters = {"tolerance": 1.0}
        sums = client.gather("transport", STACK, points, places, tolerance=0, evaluator="f64",
                             parameters=parameters)  # fmt: skip
        np.testing.assert_allclose(sums.M[:, 0], cut.R[0], rtol=float(sums.numerical_error[0]))
        builds = client.statistics()["cache_builds"]
        assert client.eval("transport", STACK, [3.0], **options).R.shape == (1, 1)
        layers = [dict(layer._asdict()) for layer in STACK]
        reply = post(one, "/v1/eval", model="transport", medium=[layers], r=R_MM, **options).json
        assert reply["channels"][0]["R"] == cut.R[0].tolist()
        assert reply["channels"][0]["layers"] == layers
        assert client.statistics()["cache_builds"] == builds


def test_named_layers_are_a_medium_everywhere(daemon, tmp_path):
    """By Python, HTTP and the command line, by name and by the column of `dipole media`."""
    one = daemon("--http", "127.0.0.1:0")
    with Client(one.url(), timeout_s=200) as client:
        skin = client.media()["skin-dark"]
        assert [len(stack) for stack in skin] == [2, 2, 2] and skin[0][0].thickness == 0.06
        options = {"wanted": "R", "evaluator": "f64", "tolerance": 0.1}
        named, given = client.eval("transport", "skin-dark", R_MM, **options), [*skin]
        assert (named.R == client.eval("transport", given, R_MM, **options).R).all()
        with pytest.raises(ArgumentError, match="layers"):
            client.values("transport", "skin-dark", R_MM)
    asked = {"model": "transport", "medium": "skin-dark", "r": R_MM, "evaluator": "f64", "wanted": "R"}
    reply = post(one, "/v1/eval", tolerance=0.1, **asked).json
    assert [channel["R"] for channel in reply["channels"]] == named.R.tolist()
    assert post(one, "/v1/eval", thickness=1.0, **asked).json["field"] == "thickness"

    def lines(*arguments: str, status: int = 0, stdin: str = "") -> list[dict[str, str]]:
        made = dipole(*arguments, "--connect", one.url(), "--format", "csv", status=status, stdin=stdin)
        return read_csv(made.stdout)

    choice = ("--model", "transport", "--evaluator", "f64", "--tolerance", "0.1", "--wanted", "R", "--r", "0.5,1,2")
    rows = lines("eval", "--medium", "skin-dark", *choice)
    listed = [row for row in lines("media") if row["medium"] == "skin-dark"]
    text = "medium,channel,layers\n" + "".join(f'skin-dark,{row["channel"]},\n' for row in listed)
    text += "".join(f',,"{row["layers"]}"\n' for row in listed) + ',,"1,2"\n'
    points = lines("points", *choice, status=3, stdin=text)
    assert points.pop()["status"].startswith("layers: '1,2': allowed")
    values = [float(row["R"]) for row in points]
    assert values == [*named.R.reshape(-1)] * 2 == [float(row["R"]) for row in rows] * 2
    for wrong in (["--g", "0.9"], ["--medium", "skin-dark,skin1"]):
        assert lines("eval", "--medium", "skin-dark", *choice, *wrong, status=2) == []


def test_media_of_a_file(daemon, tmp_path):
    (tmp_path / "media").write_text(
        "# two of them\nfilm 0.5,1,0,1.3,0.5 0.25,1.5,0.25,1.3\n\n"
        "leaf red 1,2,0.5,1.4,0.25\nleaf green 2,2,0.5,1.4,0.25 # darker\nleaf blue 3,2,0.5,1.4,0.25\n"
    )
    one = daemon("--media", str(tmp_path / "media"), "--http", "127.0.0.1:0")
    with one.client() as client:
        media = client.media()
        film = Stack(Medium(0.5, 1.0, 0.0, 1.3, 0.5), Medium(0.25, 1.5, 0.25, 1.3))
        assert list(media)[-2:] == ["film", "leaf"] and media["skin1"][0] == Medium(0.032, 0.74)
        assert media["film"] == (film,) * 3
        assert media["leaf"] == tuple(Medium(a, 2.0, 0.5, 1.4, 0.25) for a in (1.0, 2.0, 3.0))
        options = {"wanted": "R", "evaluator": "f64", "tolerance": 0.1}
        found = client.eval("transport", "film", R_MM, **options).R
        assert (found == client.eval("transport", film, R_MM, **options).R).all()
    reply = post(one, "/v1/eval", model="transport", medium="film", r=R_MM, **options).json
    assert [channel["R"] for channel in reply["channels"]] == found.tolist()


def test_transmitted_light_is_drawn_and_gathered(daemon):
    """The model whose R is T has it in every message, by tables, too; half spaces have none."""
    slab = Medium(*HALF_SPACE, 2.0)
    with Client(daemon("--workers", "1").url(), timeout_s=200) as client:
        both = client.eval("transport", slab, R_MM, wanted=["T"], evaluator="f64")
        through = client.eval("transport-transmitted", slab, R_MM, wanted=["R", "cdf", "albedo"], evaluator="f64")
        assert (through.R == both.T).all() and (both.T > 0).all()
        assert (client.eval("better", SKIN, R_MM, wanted=["T"]).T == 0).all()
        walked = client.mc(slab, Grid(0.0, 10.0, 11), photons=100000).energies[0].T
        beam = np.exp(-3.0) * (1 - (0.3 / 2.3) ** 2)  # what has not scattered
        assert abs(through.albedo[0] + beam - walked.value) <= 4 * walked.error
        drawn = client.sample("transport-transmitted", slab, through.cdf[0], evaluator="f64")
        np.testing.assert_allclose(drawn.r[0], R_MM, rtol=1e-9)
        points = Points(np.zeros((1, 3)), np.ones((1, 1)))
        places = np.array([[r, 0.0, 0.0] for r in R_MM])
        sums = client.gather("transport-transmitted", slab, points, places, tolerance=0, evaluator="f64")
        np.testing.assert_allclose(sums.M[:, 0], both.T[0], rtol=1e-12)
        table = client.table("transport-transmitted", slab, tolerance=1e-2)
        np.testing.assert_allclose(table.R(R_MM), both.T[0], rtol=1e-2)


def test_all_power_is_accounted_for(daemon):
    """By Python and HTTP, with and without radii, by tables, too: what leaves, and what each layer absorbs."""
    one = daemon("--workers", "1", "--http", "127.0.0.1:0")
    layers = Stack(Medium(0.3, 3.0, 0.5, 1.4, 0.5), Medium(0.05, 2.0, 0.3, 1.33, 1.0))
    with Client(one.url(), timeout_s=200) as client:
        alone = client.eval("transport", [layers], wanted=["balance"], evaluator="f64", tolerance=0.1)
        beside = client.eval("transport", [layers], R_MM, wanted=["R", "albedo", "balance"], tolerance=0.1)
        (shares,) = beside.balance
        assert alone.balance == beside.balance and shares["reflected"] == beside.albedo[0]
        assert abs(sum(shares) - 1) < 1e-6 and beside.errors["balance"].numerical_error[0] < 1e-6
        walked = client.mc(layers, Grid(0.0, 10.0, 11), photons=100000).energies[0]
        through = shares["transmitted"] + shares["unscattered_below"]
        for found, known in zip((through, shares["absorbed_1"], shares["absorbed_2"]), (walked.T, *walked.in_layer)):
            assert abs(found - known.value) <= 4 * known.error
        assert len({one.error for one in (walked.R, walked.T, *walked.in_layer)}) == 4 + 1  # 0 of other layers
        (half,) = client.eval("transport", SKIN, wanted=["albedo", "balance"]).balance
        assert half["reflected"] + half["absorbed_1"] == 1 and half["transmitted"] == 0
        for model, wrong in (("better", "transport has it"), (None, "in place of a model")):
            with pytest.raises(Refused, match=wrong):
                client.eval(model, SKIN, wanted=["balance"], tolerance=0.1)
    asked = [dict(layer._asdict()) for layer in layers]
    reply = post(one, "/v1/eval", model="transport", medium=[asked], wanted="balance", evaluator="f64", tolerance=0.1).json
    told = reply["channels"][0]["balance"]
    assert [*told.items()] == [*zip(alone.balance.dtype.names, alone.balance[0].tolist())]


def test_small_requests_go_on_beside_a_hundred_stacks(daemon):
    """The client that asked for the stacks leaves without an answer."""
    one = daemon("--workers", "1")
    slow, fast = one.client(), one.client()
    with fast:
        for seed in range(2):
            slow.submit("transport", stacks(seed, 50), [1.0], evaluator="f64")
        alone = fast.eval("better", SKIN, R_MM).R
        for _ in range(300):
            assert np.array_equal(fast.eval("better", SKIN, R_MM).R, alone)
        assert fast.statistics()["cache_entries"] < 100  # all small requests come before the last stacks
        slow.close()
        assert np.array_equal(fast.eval("better", SKIN, R_MM).R, alone)


def test_a_deadline_ends_the_wait_for_a_stack(daemon):
    with daemon("--workers", "1").client() as client:
        with pytest.raises(Refused) as refused:
            client.eval("transport", stacks(3, 1), R_MM, tolerance=1e-3, deadline_ms=100)
        assert refused.value.status == "deadline"
        assert client.ping() > 0


def test_a_slab_whose_light_is_not_found_is_refused(daemon):
    with daemon("--workers", "1").client() as client, pytest.raises(Refused) as refused:
        client.eval("transport", Medium(1.0, 10.0, 0.95, 1.4, 0.1), R_MM, evaluator="f64")
    assert refused.value.field == "thickness"
