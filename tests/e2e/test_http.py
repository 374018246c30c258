"""--http: requests of the binary protocol as JSON, with its limits and errors."""

import contextlib
import http.client
import itertools
import json
import os
import random
import re
import resource
import socket
import time
from pathlib import Path

import dipole
import numpy as np
import pytest
from beside import Beside
from daemons import BUILD, HANG_S, Daemon, eventually, finished, sanitized
from installing import npm_install

TIMEOUT_S = 300
SKIN = {"sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3}
JSON = {"Content-Type": "application/json"}
# The packages that npm fetches, if npm is installed: versions that are known to work.
NODE_MODULES = {
    "@seriousme/openapi-schema-validator": "2.11.0",
    "openapi-client-axios": "7.9.1",
    "axios": "1.16.0",
}


def address(daemon) -> tuple[str, int]:
    line = next(line for line in daemon.log if "url=http://" in line and "/metrics" not in line)
    host, _, port = line.split("url=http://")[1].split()[0].rpartition(":")
    return host, int(port)


@pytest.fixture(scope="module")
def served():
    """Returns a daemon that serves HTTP at a free port, for tests that change nothing in it."""
    one = Daemon("--http", "127.0.0.1:0", "--metrics", "127.0.0.1:0")
    yield one
    one.close()


class Answer:
    def __init__(self, answer: http.client.HTTPResponse):
        self.status = answer.status
        self.headers = answer.headers
        self.text = answer.read()

    @property
    def json(self):
        return json.loads(self.text)


def ask(daemon, method: str, path: str, body=None, headers=None) -> Answer:
    """Makes one HTTP request. A body that is no bytes becomes JSON."""
    connection = http.client.HTTPConnection(*address(daemon), timeout=TIMEOUT_S)
    try:
        if body is not None and not isinstance(body, bytes):
            body = json.dumps(body).encode()
        connection.request(method, path, body, JSON if headers is None else headers)
        return Answer(connection.getresponse())
    finally:
        connection.close()


def get(daemon, path: str) -> Answer:
    return ask(daemon, "GET", path)


def post(daemon, path: str, **fields) -> Answer:
    return ask(daemon, "POST", path, fields)


def good(answer: Answer):
    assert answer.status == 200, answer.text
    assert answer.headers["Content-Type"] == "application/json"
    return answer.json


def bits(values, like) -> bytes:
    """Returns the bytes of values that JSON has, where null is NaN, in the precision of `like`."""
    numbers = [float("nan") if v is None else float(v) for v in np.ravel(values).tolist()]
    return np.array(numbers, np.float64).astype(like.dtype).tobytes()


# ---- answers are those of the binary protocol ----------------------------------------------------


RADII = [0.0, 0.1, 0.123456789, 1.0, 1e-7, 25.0]
WANTED = ["R", "albedo", "cdf", "dR_dr", "ln_R", "pdf", "2_pi_r_R", "S", "dlnR_dln_sigma_a", "r"]
MEDIA = [dipole.Medium(0.1, 1, 0.5, 1.4), dipole.Medium(0.2, 1, 0.5, 1.4)]
COEFFICIENTS = {"sigma_a": [0.1, 0.2], "sigma_s": 1, "g": 0.5, "eta": 1.4}
VARY = {"sigma_a": [0.1, 0.2, 0.0], "sigma_s": 1.5}
# Points in a plane, with two channels, and where their light is asked for.
POINTS = {"x": [0, 1.5, -2, 4], "y": [0.25, 0, 1, -3], "z": 0,
          "power": [[1, 0.5, 0.125, 2], [0, 1, 3, 0.1]]}
PLACES = {"x": [0.5, -1, 3], "y": 0.5, "z": [0, 0.1, 0]}
TWO = {"sigma_a": [0.032, 0.17], "sigma_s": [0.74, 0.88]}
SET = dipole.Points(np.array([POINTS["x"], POINTS["y"], [0] * 4], float).T, np.array(POINTS["power"]).T)
QUERIES = np.array([PLACES["x"], [0.5] * 3, PLACES["z"]]).T

# The path, the fields, and the same request of the Python client.
SAME = {
    **{f"eval {e}": ("eval", {"model": "better", "evaluator": e, "medium": "skin1", "r": RADII, "wanted": WANTED},
                     lambda c, e=e: c.eval("better", "skin1", RADII, evaluator=e, wanted=WANTED))
       for e in ("f64", "f32", "lut")},
    "coefficients and parameters": (
        "eval", {"model": "better", **COEFFICIENTS, "cos_in": 0.5, "wanted": ["S"], "r": [0.5, 2]},
        lambda c: c.eval("better", MEDIA, [0.5, 2.0], wanted="S", parameters={"cos_in": 0.5})),
    "a grid": ("eval", {"model": "better", **COEFFICIENTS, "wanted": ["R", "r"], "spacing": "logarithmic",
                        "radius_count": 5, "radius_start": 0.1, "radius_stop": 10},
               lambda c: c.eval("better", MEDIA, grid=dipole.Grid(0.1, 10, 5, "logarithmic"), wanted=["R", "r"])),
    "a thickness": ("eval", {"model": "multipole", "medium": "skin1", "thickness": 60, "r": RADII, "wanted": "R"},
                    lambda c: c.eval("multipole", [one._replace(thickness=60) for one in c.media()["skin1"]], RADII, wanted="R")),
    "the name of a parameter": ("eval", {"model": "gaussians", "fit_model": "better", "medium": "skin1", "r": [1], "wanted": "R"},
                                lambda c: c.eval("gaussians", "skin1", [1.0], wanted="R", parameters={"fit_model": 2})),
    "balance": ("eval", {"evaluator": "lut", **COEFFICIENTS, "r": [1], "wanted": ["R", "balance"]},
                lambda c: c.eval("transport", MEDIA, [1.0], evaluator="lut", wanted=["R", "balance"])),
    "sample": ("sample", {"model": "better", "medium": "skin1", "draw": "random", "sample_count": 100,
                          "seed": str(2**64 - 1), "wanted": ["r", "pdf"]},
               lambda c: c.sample("better", "skin1", draw=dipole.Draw(100, seed=2**64 - 1))),
    "invert": ("invert", {"model": "better", "albedo": [0.5, 0.9], "length": [1, 2], "eta": 1.3,
                          "given": "diffuse-mean-free-path"},
               lambda c: c.invert("better", [0.5, 0.9], [1, 2], given="diffuse-mean-free-path")),
    "radii of media": ("varying", {**VARY, "model": "better", "r": [0.5, 1.0, 2.0], "wanted": ["R", "cdf", "albedo"]},
                       lambda c: c.varying("better", **VARY, r=[0.5, 1.0, 2.0], wanted=["R", "cdf", "albedo"])),
    "numbers u": ("varying", {**VARY, "model": "better", "evaluator": "f64", "u": [0.1, 0.5, 0.9],
                              "wanted": ["r", "pdf"], "g": 0.3},
                  lambda c: c.varying("better", **VARY, u=[0.1, 0.5, 0.9], wanted=["r", "pdf"], g=0.3, evaluator="f64")),
    "colours": ("varying", {"colour": [0.1, 0.4], "length": [1.0, 2.0], "given": "diffuse-mean-free-path",
                            "specular": 1, "eta": 1.4},
                lambda c: c.varying("transport", colour=[0.1, 0.4], length=[1.0, 2.0], specular=True, eta=1.4,
                                    given="diffuse-mean-free-path")),
    **{f"gather {tolerance}": (
        "gather", {"set": SET.name.hex(), "model": "better", "evaluator": "f64", "tolerance": tolerance, **TWO, **PLACES},
        lambda c, tolerance=tolerance: c.gather("better", [dipole.Medium(*pair) for pair in zip(*TWO.values())], SET,
                                                QUERIES, tolerance=tolerance, evaluator="f64"))
       for tolerance in (0, 1e-3)},
}  # fmt: skip


def in_words(value) -> str:
    """Returns a value as a query has it."""
    return value if isinstance(value, str) else ",".join(map(str, np.ravel(value)))


@pytest.mark.parametrize("how", ["GET", "POST"])
@pytest.mark.parametrize("name", SAME)
def test_answers_are_those_of_the_binary_protocol(served, name, how):
    path, fields, call = SAME[name]
    sent = good(post(served, "/v1/points", **POINTS))
    assert sent == {"set": SET.name.hex(), "known": 1}
    if how == "GET":
        query = "&".join(f"{key}={in_words(value)}" for key, value in fields.items())
        answer = good(get(served, f"/v1/{path}?{query}"))
    else:
        answer = good(post(served, f"/v1/{path}", **fields))
    with served.client() as client:
        found = call(client)
    arrays = {}
    if path == "varying":
        arrays = {**found.quantities, **found.coefficients}
        assert answer["statuses"] == ["ok"] * len(answer["statuses"]) and answer["count"] == found.statuses.size
    elif path == "invert":
        arrays = {"sigma_a": found.sigma_a, "sigma_s": found.sigma_s, "albedo": found.albedo}
    for key, values in arrays.items():
        assert bits(answer[key], values) == values.tobytes() and key in answer["units"], key
    assert path != "sample" or "r" not in answer  # each channel has its own
    for i, channel in enumerate(answer.get("channels", [])):
        values = {"M": found.M[:, i]} if path == "gather" else {key: one[i] for key, one in found.values.items()}
        for key, expected in values.items():
            listed = answer["r"] if key == "r" and path == "eval" else channel[key]
            assert bits(listed, expected) == expected.tobytes(), key
        if "albedo" in channel and path == "eval":
            assert channel["albedo"] is None or channel["albedo"] == found.albedo[i]
        if name == "balance":
            assert list(channel["balance"].values()) == list(found.balance[i])
        for key, stated in channel.get("errors", {}).items():
            errors = np.array([one[i] for one in found.errors[key]])
            assert bits(list(stated.values()), errors) == errors.tobytes(), key
    if path == "gather":
        assert answer["points_visited"] == found.points_visited and answer["units"]["M"] == "W/mm^2"
    assert (answer["model"], answer.get("evaluator")) == (found.model, getattr(found, "evaluator", None))
    assert name != "coefficients and parameters" or "similarity" in answer["notes"]


@pytest.mark.parametrize("wanted, unit", [("R_f,r,albedo", "1/mm"), ("R,R_f,r", "mm"), ("R,r", "mm")])
def test_frequencies_have_their_unit(served, wanted, unit):
    answer = good(get(served, f"/v1/eval?model=better&medium=skin1&r=1&wanted={wanted}"))
    assert answer["units"]["r"] == unit


def models(daemon) -> list[str]:
    return [one["name"] for one in good(get(daemon, "/v1/models"))["models"]]


def test_tolerance_chooses(served):
    answer = good(post(served, "/v1/eval", medium=SKIN, r=[0.5, 1], tolerance=0.01))
    with served.client() as client:
        expected = client.eval(None, dipole.Medium(**SKIN), [0.5, 1], tolerance=0.01)
    assert answer["model"] == expected.model
    offers = good(post(served, "/v1/offers", medium=SKIN, r=[0.5, 1], tolerance=0.01))
    taken = offers["offers"][offers["taken"]]
    assert taken["model"] == answer["model"] and taken["meets"] == 1


def test_defaults_are_those_of_the_command_line(served):
    for request, model, evaluator in (
        ("eval?medium=skin1&r=1", "transport", "lut"),
        ("eval?model=better&medium=skin1&r=1", "better", "f64"),
        ("eval?medium=skin1&r=1&model=transport", "transport", "lut"),
        ("sample?medium=skin1&u=.5&model=transport", "transport", "lut"),
        ("eval?medium=skin1&r=1&model=transport&tolerance=1e-7", "transport", "f64"),
        ("eval?medium=skin1&r=1&model=29&tolerance=1e-6", "transport", "lut"),
        ("varying?sigma_a=1&sigma_s=1&u=0.5", "transport", "f32"),
        (f"gather?set={SET.name.hex()}&x=1&y=1&z=0&sigma_a=1,1&sigma_s=1,1", "transport", "lut"),
    ):
        good(post(served, "/v1/points", **POINTS))
        answer = good(get(served, f"/v1/{request}"))
        assert (answer["model"], answer["evaluator"]) == (model, evaluator), request
    assert good(get(served, "/v1/invert?albedo=0.5&length=1"))["given"] == "mean-free-path"
    answer = good(get(served, "/v1/varying?colour=0.1,0.5&length=1"))
    assert (answer["wanted"], answer["coefficients"]) == ([], ["sigma_a", "sigma_s"])
    assert good(get(served, "/v1/varying?sigma_a=1&sigma_s=1&r=1"))["wanted"] == ["R", "model_error"]


def test_infinite_radius_and_unknown_numbers(served):
    fields = {"model": "better", "medium": SKIN, "r": [1, "inf"], "wanted": ["R", "r"]}
    answer = good(post(served, "/v1/eval", **fields))
    assert answer["r"] == [1, "inf"] and answer["channels"][0]["R"][1] == 0
    assert answer["channels"][0]["albedo"] is None
    assert good(get(served, "/v1/eval?model=better&medium=skin1&r=inf"))["r"] == ["inf"]
    listed = good(get(served, "/v1/sample?model=better&medium=skin1&u=0,0.5,1"))
    assert listed["channels"][0]["r"][0] == 0 and listed["channels"][0]["r"][2] == "inf"


@pytest.mark.parametrize("scale", ["absolute", "free", "reference"])
def test_fit(served, scale):
    at, known = [0.5, 1, 2, 4, 8], dipole.Medium(0.1, 1.2)
    with served.client() as client:
        values = client.eval("better", [dipole.Medium(0.02, 1.0), dipole.Medium(0.1, 0.8)], at).R
        options = {"reference": known} if scale == "reference" else {"scale": scale}
        values = values / client.eval("better", known, at).R if scale == "reference" else values
        expected = client.fit("better", at, values, values * 0.01, residuals=True, eta=1.3, **options)
    fields = {"model": "better", "at": at, "values": values.tolist(), "scale": scale, "residuals": 1, "eta": 1.3}
    if scale == "reference":
        fields["reference"] = {"sigma_a": 0.1, "sigma_s": 1.2, "eta": 1.3}
    answer = good(post(served, "/v1/fit", errors=(values * 0.01).tolist(), **fields))
    assert (answer["g"], answer["g_is_default"], answer["eta"]) == (0, True, 1.3)
    assert answer["fitted_count"] == 2 and answer["units"]["sigma_a"] == "1/mm"
    for i, one in enumerate(answer["sets"]):
        assert one["status"] == "fitted"
        assert one["sigma_a"] == expected.sigma_a[i] and one["factor"] == expected.factor[i]
        assert one["residuals"] == expected.residuals[i].tolist()
    one_set = good(
        post(served, "/v1/fit", model="better", at=at, values=[0.1, 0.05, 0.01, 1e-3, 1e-4],
             errors=[0.01] * 5, g=0.5, eta=1.4)
    )
    assert (one_set["g"], one_set["g_is_default"], one_set["eta"]) == (0.5, False, 1.4)
    assert len(one_set["sets"]) == 1 and "residuals" not in one_set["sets"][0]


def test_a_value_that_is_wrong_has_a_status(served):
    answer = good(post(served, "/v1/varying", model="better", sigma_a=[0.1, -1, 0.1],
                       sigma_s=[1, 1, 1], r=[1, 1, -1], g=0.5))
    assert answer["notes"] == ["similarity"]
    assert answer["statuses"] == ["ok", "sigma_a", "radius"] and answer["computed_count"] == 1
    assert [value is None for value in answer["R"]] == [False, True, True]


def test_the_gather_of_the_protocol(served):
    """Its example in JSON asks for what its example in bytes does."""
    text = (Path(__file__).parents[2] / "proto/PROTOCOL.md").read_text()
    posts = re.findall(r"    POST (/v1/\w+)\n((?:    .+\n)+)", text)
    answers = [good(post(served, path, **json.loads(fields))) for path, fields in posts]
    reply = text.split("```hex gather-reply")[1].split("```")[0].strip().split("\n")
    sum_bytes = bytes.fromhex(reply[-1].split("#")[0])[-8:]
    assert [path for path, _ in posts] == ["/v1/points", "/v1/gather"]
    assert np.float64(answers[1]["channels"][0]["M"][0]).tobytes() == sum_bytes


def test_a_sum_of_seconds_is_one_answer(served):
    """Parts that tell the progress of long sums are those of the binary protocol alone."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-20, 20, (2, 20_000)).round(3).tolist()
    sent = good(post(served, "/v1/points", x=x, y=y, z=0, power=1))
    fields = {"set": sent["set"], "tolerance": 0, "model": "better", "evaluator": "f64", **SKIN}
    answer = good(post(served, "/v1/gather", x=x[:7000], y=y[:7000], z=1, **fields))
    assert len(answer["channels"][0]["M"]) == 7000 and None not in answer["channels"][0]["M"]
    many = post(served, "/v1/gather", x=[1] * 16_385, y=0, z=0, **fields)
    assert (many.status, many.json["status"], many.json["field"]) == (413, "too-large", "query_count")


def test_table_and_lists(served):
    answer = good(post(served, "/v1/table", model="better", tolerance=1e-3, **SKIN))
    with served.client() as client:
        expected, info = client.table("better", dipole.Medium(**SKIN), tolerance=1e-3), client.info
    assert answer["parameters"] == {"tolerance": 1e-3}
    assert answer["albedo"] == expected.albedo and len(answer["words"]) == answer["word_count"]
    answer = good(get(served, "/v1/models"))
    assert answer["limits"]["max_media"] == 64
    assert [m["name"] for m in answer["models"]] == list(info.choices["model"])
    for name in ["quantities", "parameters", "notes", "spacings"]:
        assert all({"id", "name", "about"} == set(one) for one in answer[name])
    media = good(get(served, "/v1/media"))["media"]
    skin = next(one for one in media if one["name"] == "skin1")
    assert skin["sigma_a"] == [0.032, 0.17, 0.48] and skin["eta"] == [1.3] * 3 and skin["thickness"] == [0] * 3


# ---- faults ------------------------------------------------------------------------------------


GOOD = {"model": "better", "medium": SKIN, "r": [1]}
TWO_SETS = [[1, 0.5, 0.2], [1, 0.4, 0.1]]
BASES = {
    "eval": GOOD,
    "fit": {"model": "better", "at": [1, 2, 3], "values": TWO_SETS, "errors": TWO_SETS, "eta": 1.4},
    "varying": {"model": "transport", "sigma_a": [1, 1, 1], "sigma_s": [1, 1, 1], "r": [1, 1, 1]},
    "points": POINTS,
    "gather": {"set": SET.name.hex(), **TWO, **PLACES},
    "fit_tissue": {"sought": [{"property": "a_per_mm", "low": 0.5, "high": 900}], "tissue": "liver", "wavelength": [700], "at": [1, 2], "values": [0.1, 0.01], "errors": [0.01, 0.001]},
}
# By path: what is changed, the field that is named, its position, and a status other than 400.
FAULTS = {
    "eval": [
        ({"r": [1, -1]}, "r", 1), ({"r": [None]}, "r"), ({"r": ["nan"]}, "r"), ({"r": [[1]]}, "r"),
        ({"r": [1e300], "evaluator": "f32"}, "r"), ({"model": "best"}, "model"), ({"model": 999}, "model"),
        ({"model": ["better"]}, "model"), ({"evaluator": "f16"}, "evaluator"), ({"wanted": []}, "wanted"),
        ({"wanted": ["Q"]}, "wanted"), ({"medium": "skin9"}, "medium"), ({"medium": []}, "medium_count"),
        ({"medium": 5}, "medium"), ({"medium": {**SKIN, "x": 1}}, "medium"), ({"medium": {"sigma_a": 1}}, "sigma_s"),
        ({"medium": {**SKIN, "sigma_s": -1}}, "sigma_s"), ({"medium": '"[[[[['}, "medium"), ({"medium": [SKIN] * 65}, "medium_count", 0, 413),
        ({"sigma_a": 1}, "sigma_a"), ({"radius_count": 5}, "radius_count"), ({"spacing": "linear"}, "spacing"),
        ({"radius_start": 1}, "radius_start"), ({"tolerance": 2}, "tolerance"), ({"thickness": 1}, "thickness"),
        ({"r": [[[[1]]]]}, "body"), ({"wanted": ["R", "Q"]}, "wanted", 1), ({"eta": 1.3}, "eta"),
        ({"medium": [[SKIN], [SKIN, SKIN]]}, "layer_count", 1), ({"r": [1e-300], "evaluator": "f32"}, "r"),
        ({"thickness": "x"}, "thickness"), ({"medium": [[SKIN] * 9]}, "layer_count"), ({"fit_model": "x"}, "fit_model"),
        ({"deadline_ms": -1}, "deadline_ms"), ({"deadline_ms": 2**40}, "deadline_ms"),
        ({"medium_count": 1}, "medium_count"), ({"unknown": 1}, "unknown"), ({"n" * 100: 1}, "body"),
    ],
    "fit": [
        ({"at": [1, 2]}, "values"), ({"at": None}, "at"), ({"errors": [[1, 1, 1]]}, "set_count"),
        ({"values": [[1, 2, 3], [1, 2]]}, "values"), ({"values": [[1, [2], 3], [1, 2, 3]]}, "values", 1),
        ({"scale": "reference"}, "reference"), ({"reference": SKIN}, "reference"),
        ({"scale": "reference", "reference": {"x": 1}}, "reference"), ({"reading_count": 3}, "reading_count"),
        ({"axis": "x"}, "axis"), ({"residuals": 2}, "residuals"), ({"source": [1]}, "source"), ({"eta": None}, "eta"),
        ({"scale": "reference", "reference": {"sigma_a": 0.1, "sigma_s": 1.0}}, "eta"),
    ],
    "varying": [
        ({"sigma_a": None}, "sigma_a"), ({"sigma_s": []}, "sigma_s"), ({"sigma_s": [1, 2]}, "sigma_s"),
        ({"sigma_a": [1, "x", 1]}, "sigma_a", 1), ({"colour": 0.5}, "sigma_a"), ({"length": 1}, "sigma_a"),
        ({"u": 0.5}, "u"), ({"r": [1, 2]}, "r"), ({"light": "beam"}, "light"), ({"given": "mean-free-path"}, "given"),
        ({"wanted": ["r"]}, "wanted"), ({"wanted": []}, "wanted"), ({"coefficients": ["x"]}, "coefficients"),
        ({"evaluator": "lut"}, "evaluator"), ({"model": "single"}, "model"), ({"value_count": 3}, "value_count"),
        ({"numbers": 1}, "numbers"), ({"tolerance": 1e-6}, "tolerance"),
    ],
    "points": [
        ({"x": None}, "x"), ({"x": [1, 2]}, "x"), ({"y": [1, 2, "a", 4]}, "y", 2), ({"z": 1e30}, "points"),
        ({"y": [1, 2, 3, "inf"]}, "points", 3), ({"power": [1, 2, -1, 4]}, "power", 2),
        ({"power": [1, 2, 1e300, 4]}, "power", 2), ({"power": [[1] * 4] * 9}, "channel_count"),
        ({"power": [[1] * 4, [1] * 3]}, "power"), ({"power": []}, "power"),
        ({"x": [], "y": [], "z": [], "power": []}, "point_count"), ({"set": "00" * 16}, "set"), ({"set": "0x12"}, "set"),
        ({"set": [1, 2]}, "set"), ({"point_count": 4}, "point_count"), ({"model": "better"}, "model"),
    ],
    "gather": [
        ({"set": "00" * 16}, "set", 0, 404), ({"set": None}, "set"), ({"set": 5}, "set"), ({"x": [1, "nan", 3]}, "x", 1),
        ({"x": [1, 2, 1e10]}, "queries", 2), ({"z": [1, 2]}, "z"), ({"y": None}, "y"), ({"tolerance": 0.7}, "tolerance"),
        ({"sigma_s": [1, -1]}, "sigma_s", 1), ({"sigma_a": 1, "sigma_s": 1}, "medium_count"),
        ({"model": "lambert"}, "model"), ({"power": 1}, "power"),
    ],
    "fit_tissue": [
        ({"sought": [{"property": "hb_uM", "low": 5, "high": 4}]}, "high"), ({"sought": [{"property": "hb_uM", "low": -1}]}, "low"),
    ],
}  # fmt: skip


@pytest.mark.parametrize("path", FAULTS)
def test_faults_name_the_field(served, path):
    """They are those of the binary protocol, with the position of what is wrong."""
    good(post(served, "/v1/points", **POINTS))
    for change, field, *more in FAULTS[path]:
        answer = post(served, f"/v1/{path}", **{**BASES[path], **change})
        index, status = (*more, *(0, 400)[len(more) :])
        assert (answer.status, answer.json["field"], answer.json["index"]) == (status, field, index), (change, answer.text)
        assert answer.json["allowed"] and (status != 404 or answer.json["status"] == "unknown-points")
    good(post(served, f"/v1/{path}", **BASES[path]))
    coloured = post(served, "/v1/varying", colour=0.5)
    assert coloured.status == 400 and coloured.json["field"] == "length"


BAD_BODIES = [
    b"", b"{", b"[]", b"5", b"null", b"\xff\xfe", b'{"r":[1e999]}', b'{"r":[1],"r":[2]}',
    b'{"model":"\\ud800"}', b'{"model":"\xed\xa0\x80"}', b'{"r":[01]}', b'{"r":[NaN]}',
    b'{"r":[1],}', b'{"r":[1]} x', b'{"\\u0000":1}', b'{"r":[99999999999999999999999]}',
    b"[" * 100000, b'{"a":' * 5000 + b"1" + b"}" * 5000, b'{"r":[' + b"[]," * 100000 + b"1]}",
    b'{"x":"' + b"[" * 1000 + b'"}', b'{"model":"' + b"x" * 100000 + b'"}',
]


@pytest.mark.parametrize("body", BAD_BODIES, ids=lambda body: repr(body[:20]))
def test_bodies_that_are_wrong(served, body):
    answer = ask(served, "POST", "/v1/eval", body)
    assert answer.status == 400, answer.text
    assert answer.json["status"].startswith("bad-")
    assert answer.json["allowed"] and not answer.json["allowed"].endswith(": ")


@pytest.mark.parametrize(
    "query", ["r", "r=%", "r=%g0", "r=%00", "r=1&r=2", "r=%ff", "r=1,,2", "=", "model=%C3%28",
              "r=0x1", "r=1e999", "r=1 2", "medium=" + "%41" * 5000, "x" * 3000 + "=1",
              "&".join(f"x{i}=1" for i in range(200)), "medium=skin1&spacing=linear&radius_stop=1&radius_count=05", "r=" + "1," * 10000 + "x", "%ff=1",
              "r%2Cx=1", "r,x=1"]
)
def test_queries_that_are_wrong(served, query):
    answer = get(served, "/v1/eval?model=better&" + query.replace(" ", "%20"))
    assert 400 <= answer.status < 500, answer.text


@pytest.mark.parametrize("length", [1, 8, 100])
def test_long_queries_get_an_answer(served, length):
    """libmicrohttpd takes memory for each name, and closes a connection that has too little."""
    for count in (65, 300, 400, 500, 1000, 3000, 30000 // length):
        answer = get(served, "/v1/eval?" + "&".join(length * "a" for _ in range(count)))
        assert answer.status in (400, 414), (count, answer.text)
    assert good(get(served, "/healthz")) == {"status": "ok"}


def test_faults_say_what_to_do(served):
    """A reader of the answer alone can mend the request."""
    def refusal(answer: Answer) -> dict:
        assert answer.status == 400, answer.text
        return answer.json

    with served.client() as client:
        counted = lambda: np.array([client.statistics()[one] for one in ("requests_eval", "replies_bad-value")])
        before = counted()
        assert "or a name as medium" in refusal(get(served, "/v1/eval?r=1"))["allowed"]
        assert (counted() - before).tolist() == [1, 1]
    unknown = refusal(get(served, "/v1/eval?model=best&medium=skin1&r=1"))["allowed"]
    assert "(better)" in unknown and unknown.endswith("/v1/models")
    twice = refusal(get(served, "/v1/eval?model=better&medium=skin1&r=1&r=2"))["allowed"]
    assert "r=0.5,1,2" in twice
    uneven = refusal(get(served, "/v1/eval?sigma_a=1,2&sigma_s=1,2,3&r=1"))
    assert uneven["field"] == "sigma_s" and "as many" in uneven["allowed"]
    assert "one medium" in refusal(get(served, "/v1/table?medium=skin1"))["allowed"]
    for sought in ({"low": 1}, {"property": "hb_uM", "low": "x"}, {"property": "x"}):
        assert refusal(post(served, "/v1/fit_tissue", sought=["b", sought]))["field"] == "sought"
    media = [SKIN, SKIN, {"sigma_a": 1}]
    for last in ({"sigma_a": 1}, {"sigma_a": 1, "sigma_s": "x"}, {"x": 1}, "skin9", None):
        media[2] = last
        assert refusal(post(served, "/v1/eval", model="better", medium=media, r=[1]))["index"] == 2


@pytest.mark.parametrize("number", ["0,05", "05", "-00.5", "+01", "1,0005", "00"])
def test_a_decimal_comma_is_no_list(served, number):
    for name in ("sigma_a", "r", "tolerance"):
        fields = {"sigma_a": "1", "r": "1", name: number}
        answer = get(served, "/v1/eval?sigma_s=1&" + "&".join(f"{n}={t}" for n, t in fields.items()))
        assert answer.status == 400 and "0.05" in answer.json["allowed"]
    assert good(get(served, "/v1/eval?sigma_a=0&sigma_s=1e05&r=0.05,0,0.0,1e-02,10"))


def test_no_field_is_left_out_without_a_word(served):
    """Fields count in the query of a GET and in the body of a POST, and nowhere else."""
    body = {"model": "better", "medium": "skin1", "r": [1]}
    for method, path in [("GET", "/v1/eval"), ("HEAD", "/v1/eval"), ("GET", "/v1/eval?medium=skin1&r=1")]:
        assert ask(served, method, path, body).status == 400, (method, path)
    answer = ask(served, "GET", "/v1/eval?medium=skin1&r=1", body)
    assert answer.json["field"] == "body" and "POST" in answer.json["allowed"]
    answer = ask(served, "POST", "/v1/eval?model=classical", body)
    assert answer.status == 400 and answer.json["field"] == "query"
    assert good(ask(served, "POST", "/v1/eval?", body))


def test_types_and_codings_of_bodies(served):
    body = json.dumps(GOOD).encode()
    for kind in ("application/json", "application/json; charset=utf-8", "Application/JSON"):
        assert good(ask(served, "POST", "/v1/eval", body, {"Content-Type": kind}))
    for kind in ("application/jsonx", "application/json-seq", "application/x-www-form-urlencoded"):
        answer = ask(served, "POST", "/v1/eval", body, {"Content-Type": kind})
        assert answer.status == 415 and answer.json["field"] == "Content-Type"
    assert good(ask(served, "POST", "/v1/eval", body, {**JSON, "Content-Encoding": "identity"}))
    for coding in ("gzip", "br"):
        answer = ask(served, "POST", "/v1/eval", body, {**JSON, "Content-Encoding": coding})
        assert answer.status == 415 and answer.json["field"] == "Content-Encoding"


HEALTH = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"


@pytest.mark.parametrize(
    "lengths",
    [b"Content-Length: 2\r\nContent-Length: %d\r\n", b"Content-Length: %d\r\nContent-Length: 2\r\n",
     b"Transfer-Encoding: chunked\r\nContent-Length: %d\r\n"],
)
def test_a_body_of_two_lengths_is_the_last_request(served, lengths):
    """A proxy may go by the other length. What it takes for the body must not be answered."""
    for body in (b"{}" + HEALTH, b"2\r\n{}\r\n0\r\n\r\n" + HEALTH):
        header = b"POST /v1/eval HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        [answer] = exchange(served, [header + lengths % len(body) + b"\r\n" + body])
        assert answer.count(b"HTTP/1.1 ") == 1 and answer.startswith(b"HTTP/1.1 400 "), answer
        assert b"Connection: close" in answer
        assert b'"field":"Content-Length"' in answer or b"chunked encoding" in answer


HOST = b"Host: localhost\r\n"


@pytest.mark.parametrize(
    "header, field",
    [(HOST + broken, "header") for broken in (
        b"Content-Length : 5\r\n", b"Content-Length\t: 5\r\n", b"X: a\r\n b\r\n", b"Y[: a\r\n",
        b"X:\r\n Content-Length: 5\r\n", b"X: a\r\n \r\n", b"X:   a\r\n\tb\r\n c\r\n", b"X Y: a\r\n",
        b"X: a\rContent-Length: 5\r\n")]
    + [(b" Content-Length: 5\r\n" + HOST, "header"), (b"", "Host"), (2 * HOST, "Host")]
    + [(HOST + b"Transfer-Encoding: " + coding + b"\r\n", "Transfer-Encoding") for coding in (
        b"gzip", b"gzip, chunked", b"chunked, chunked", b"xchunked", b"identity", b"", b"\x0bchunked")]
    + [(HOST + b"Transfer-Encoding: chunked\r\nTransfer-Encoding: gzip\r\n", "Content-Length")],
)
@pytest.mark.parametrize("port", ["http", "metrics"])
def test_a_request_whose_end_is_unclear_is_the_last(served, header, field, port):
    """RFC 9112: a proxy may read the same bytes otherwise. The client need not close its side."""
    line = next(line for line in served.log if "url=http" in line and ("/metrics" in line) == (port == "metrics"))
    where = ("127.0.0.1", int(re.search(r"http://.*?:(\d+)", line)[1]))
    body = b"5\r\n{   }\r\n0\r\n\r\n" + HEALTH
    for first in (b"", HEALTH)[: 1 + (port == "http")]:  # each is the last at the other port
        with socket.create_connection(where, TIMEOUT_S) as sock:
            sock.sendall(first + b"POST /v1/eval HTTP/1.1\r\n" + header +
                         b"Content-Type: application/json\r\n\r\n" + body)
            answer = b"".join(iter(lambda: sock.recv(65536), b""))
        statuses = re.findall(rb"HTTP/1\.1 (\d+)", answer)
        assert statuses == [b"200"] * bool(first) + [b"400"] and b"Connection: close" in answer
        assert field.encode() in answer.rpartition(b"\r\n\r\n")[2]


def test_without_a_host_or_in_chunks(served):
    [answer] = exchange(served, [b"GET /healthz HTTP/1.0\r\n\r\n"])
    assert answer.startswith(b"HTTP/1.1 200 ") or answer.startswith(b"HTTP/1.0 200 ")
    head = b"POST /v1/eval HTTP/1.%d\r\n" + HOST + b"Content-Type: application/json\r\n"
    body = b"Connection: close\r\nTransfer-Encoding: Chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n"
    answers = exchange(served, [head % 1 + body, head % 0 + body])
    assert b"or a name as medium" in answers[0] and b'"Transfer-Encoding"' in answers[1]


# ---- other names and other sites -----------------------------------------------------------------


@pytest.mark.parametrize("port", ["http", "metrics"])
def test_a_name_that_is_not_the_daemons_is_421(served, daemon, port):
    """Else a page could have DNS lead its own name here, and would count as the same origin."""
    def status(one, host: str, line: str = "GET /healthz") -> int:
        where = next(re.search(r"http://(127.0.0.1):(\d+)", x) for x in one.log
                     if "url=http" in x and ("/metrics" in x) == (port == "metrics"))
        with socket.create_connection((where[1], int(where[2])), TIMEOUT_S) as sock:
            sock.sendall(f"{line} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
            return int(sock.recv(65536).split()[1])

    named = daemon("--http", "127.0.0.1:0", "--metrics", "127.0.0.1:0", "--http-name", "render.example")
    for host in ("localhost", "localhost.", "LocalHost:80", "127.0.0.1:80", "192.0.2.1", "[::1]", "[2001:db8::1]:80"):
        assert status(served, host) == status(named, host) == 200, host
    for host in ("evil.example", "localhost.evil.example", "", "127.0.0.1.evil.example", "localhost.."):
        assert status(served, host) == status(named, host) == 421, host
    for host in ("localhost:evil", "::1", "[::1].evil", "[::1", "[localhost]", "127.0.0.1@evil", "a" * 300):
        assert status(served, host) == status(named, host) == 400, host
    for host in ("render.example", "Render.Example:8017"):
        assert (status(served, host), status(named, host)) == (421, 200)
    assert status(served, "localhost", "GET http://evil.example/healthz") == 421


def test_other_sites_ask_nothing(served, daemon):
    """A browser says which site a page is of. A query would store points without a word."""
    path = "/v1/points?x=1&y=1&z=1&power=1"
    cross = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}
    origin = {"Origin": "http://example.org"}
    for headers, there, anyone in [
        ({}, 200, 200), ({"Sec-Fetch-Site": "same-origin"}, 200, 200), ({"Sec-Fetch-Site": "none"}, 200, 200),
        (cross, 403, 200), ({**cross, "Origin": "http://example.net"}, 403, 200), ({**cross, **origin}, 200, 200),
    ]:
        one = daemon("--http", "127.0.0.1:0", "--http-allow-origin", "http://example.org")
        two = daemon("--http", "127.0.0.1:0", "--http-allow-origin", "*")
        assert ask(served, "GET", path, headers=headers).status == (403 if "cross-site" in headers.values() else 200)
        assert ask(one, "GET", path, headers=headers).status == there
        assert ask(two, "GET", path, headers=headers).status == anyone
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert [ask(served, "GET", at, headers=link).status for at in ("/", path)] == [200, 403]
    answer = ask(served, "POST", "/v1/eval", GOOD, {**JSON, **cross})
    assert answer.status == 403 and answer.json["field"] == "Sec-Fetch-Site"


@pytest.mark.parametrize(
    "change, status",
    [((b"Length: 9", b"Length: 99999999999"), 413), ((b"/json", b"/xml"), 415), ((b"eval", b"x"), 404)],
)
def test_who_asks_before_the_body_is_refused_at_once(served, change, status):
    """A client that sends `Expect: 100-continue` need not send a large body in vain."""
    header = (b"POST /v1/eval HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
              b"Expect: 100-continue\r\nContent-Length: 9\r\n\r\n")
    with socket.create_connection(address(served), TIMEOUT_S) as sock:
        sock.sendall(header)
        assert sock.recv(65536) == b"HTTP/1.1 100 Continue\r\n\r\n"
        sock.sendall(b'{"r":[1]}')
        assert sock.recv(65536).startswith(b"HTTP/1.1 400 ")
    with socket.create_connection(address(served), TIMEOUT_S) as sock:
        sock.sendall(header.replace(*change))
        assert sock.recv(65536).startswith(b"HTTP/1.1 %d " % status)


def test_requests_for_a_proxy_name_the_host(served):
    for target, status in [("http://[::1]/healthz", 200), ("HTTP://[::1]:1/healthz?y", 200), ("http://[::1]", 200),
                           ("http://[::1]/v1/eval?model=better&medium=skin1&r=1", 200),
                           ("http://[::1]/http://[::1]/healthz", 404), ("ftp://[::1]/healthz", 404)]:
        [answer] = exchange(served, [f"GET {target} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode()])
        assert answer.startswith(b"HTTP/1.1 %d " % status), (target, answer[:200])


def test_paths_methods_and_types(served):
    unknown = ["//", "/index.html", "/v1", "/v1/", "/v1/evals", "/v1/hello", "/v1/eval/", "/v1/eval%00", "/%2e%2e"]
    for path in [*unknown, "/v1/mc", "/metrics"]:
        assert get(served, path).status == 404, path
    for method in ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "X"]:
        answer = ask(served, method, "/v1/eval", headers={})
        assert answer.status == 405 and "POST" in answer.headers["Allow"]
    for path in ("/", "/healthz", "/v1/media", "/v1/openapi.json"):
        answer = ask(served, "POST", path, {})
        assert answer.status == 405 and answer.headers["Allow"] == "GET, HEAD", path
    assert ask(served, "POST", "/v1/eval", b"{}", {"Content-Type": "text/plain"}).status == 415
    answer = ask(served, "HEAD", "/healthz")
    assert answer.status == 200 and answer.text == b""


def test_too_large(served):
    answer = post(served, "/v1/eval", model="better", medium=SKIN, spacing="linear",
                  radius_count=10**6, radius_stop=1)
    assert answer.status == 413 and answer.json["field"] == "radius_count"
    answer = post(served, "/v1/eval", model="better", medium=SKIN, spacing="linear",
                  radius_count=10**11, radius_stop=1)
    assert answer.status == 413 and answer.json["field"] == "radius_count"
    body = b'{"model":"better","r":[' + b"1," * 600000 + b"1]}"
    assert ask(served, "POST", "/v1/eval", body).status == 413
    for more, status in ((0, 200), (1, 413)):
        body = b'{"model":"better","medium":"skin1","r":1}'.ljust(2**20 + more)
        assert ask(served, "POST", "/v1/eval", body).status == status
    most = good(post(served, "/v1/eval", model="better", medium=SKIN, spacing="linear",
                     radius_count=65000, radius_stop=1))
    assert len(most["r"]) == len(most["channels"][0]["R"]) == 65000


def test_a_chunked_body_is_bounded(daemon):
    one = daemon("--http", "127.0.0.1:0", "--frame-timeout-ms", "2000")
    before = one.resident_bytes()
    head = (
        b"POST /v1/eval HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Transfer-Encoding: chunked\r\n\r\n"
    )
    chunk = b"10000\r\n" + b" " * 65536 + b"\r\n"
    with socket.create_connection(address(one), TIMEOUT_S) as sock:
        sock.sendall(head + 40 * chunk + b"0\r\n\r\n")
        assert sock.recv(1000).startswith(b"HTTP/1.1 413 ")
        with pytest.raises(OSError):  # One that never ends has frame_timeout_ms.
            sock.sendall(head)
            while True:
                sock.sendall(chunk)
                time.sleep(0.01)
    assert sanitized() or one.resident_bytes() < before + 16 * 2**20
    assert good(get(one, "/healthz")) == {"status": "ok"}


def test_a_payload_is_refused_before_it_is_made(daemon):
    """The numbers of a body may make a payload that is many times as large."""
    one = daemon("--http", "127.0.0.1:0")
    zeros, before = [0] * 200_000, one.resident_bytes("VmHWM")
    medium = {"sigma_a": 1, "sigma_s": 1}
    for name, fields, field in [
        ("points", {"x": zeros, "y": 0, "z": 0, "power": [[1]] * 600}, "channel_count"),
        ("points", {"x": zeros, "y": 0, "z": 0, "power": [[1]] * 8}, "body"),
        ("points", {"x": zeros[:40_000], "y": 0, "z": 0, "power": [[1]] * 8}, "body"),
        ("gather", {"x": zeros, "y": 0, "z": 0, "set": "0" * 32, **medium}, "body"),
        ("eval", {"sigma_a": zeros, "sigma_s": 1, "r": 1}, "body"),
        ("eval", {"medium": ["skin1"] * 100_000, "r": 1}, "body"),
        ("sample", {**medium, "u": zeros, "model": "better"}, "body"),
        ("invert", {"albedo": zeros[:90_000], "length": zeros[:90_000], "given": "mean-free-path"},
         "body"),
        ("fit", {"eta": 1.4, **dict.fromkeys(["at", "values", "errors"], zeros[:90_000])}, "body"),
        ("varying", {"colour": zeros, "length": 1, "u": 1, "evaluator": "f64"}, "body"),
    ]:
        answer = post(one, f"/v1/{name}", **fields)
        assert (answer.status, answer.json["field"]) == (413 if field == "body" else 400, field)
    assert sanitized() or one.resident_bytes("VmHWM") < before + 64 * 2**20


LARGE = ("/v1/eval?model=better&medium=skin1&spacing=linear&radius_count=40000&radius_stop=9"
         "&wanted=R")


class SlowReaders:
    """Clients that ask for more large answers than the kernel holds, and read nothing."""

    def __init__(self, daemon, count: int):
        self.socks = []
        for _ in range(count):
            sock = socket.socket()
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            sock.connect(address(daemon))
            sock.sendall(f"GET {LARGE} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode() * 9)
            self.socks.append(sock)

    def close(self) -> None:
        for sock in self.socks:
            sock.close()


def test_a_slow_reader_holds_the_text_of_its_answer_alone(daemon):
    one = daemon("--http", "127.0.0.1:0")
    text_bytes = len(get(one, LARGE).text)
    with one.client() as client:
        reader, seen = SlowReaders(one, 1), []

        def stands() -> bool:
            seen.append(client.statistics())
            return len(seen) > 9 and all(
                seen[-1][name] == seen[-9][name] for name in ("buffer_bytes", "requests_eval")
            )

        assert eventually(stands, interval_s=0.1)
        assert text_bytes < seen[-1]["buffer_bytes"] < text_bytes + 300_000, text_bytes
        reader.close()


def test_slow_readers_have_half_of_the_memory_for_a_time(daemon):
    most = 16 * 2**20
    one = daemon("--http", "127.0.0.1:0", "--max-total-bytes", str(most))
    with one.client() as client:
        readers = SlowReaders(one, 25)
        assert eventually(lambda: get(one, LARGE).status == 429)  # after them, if any fit
        assert most / 4 < client.statistics()["buffer_bytes"] < 0.75 * most
        assert good(get(one, "/v1/eval?model=better&medium=skin1&r=1"))  # small ones are answered
        many = client.eval("better", [dipole.Medium(**SKIN)] * 11, np.linspace(0, 9, 40_000))
        assert many.R.shape == (11, 40_000)  # 7 MB
        # They read nothing for frame_timeout_ms, and are closed.
        assert eventually(lambda: client.statistics()["buffer_bytes"] < most / 16, interval_s=0.1)
        readers.close()
        assert good(get(one, LARGE))


def test_a_deadline_is_503(served):
    answer = post(served, "/v1/eval", model="beam", evaluator="lut", deadline_ms=1,
                  r=[1], sigma_a=[0.011, 0.012, 0.013], sigma_s=1, g=0, eta=1.31)
    assert answer.status == 503 and answer.json["field"] == "deadline_ms"


def test_busy_is_429_with_retry_after(daemon):
    one = daemon("--http", "127.0.0.1:0", "--max-total-bytes", "1048576")
    with socket.create_connection(address(one), TIMEOUT_S) as hog:
        # Another client's body takes most of the memory.
        hog.sendall(b"POST /v1/eval HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
                    b"Content-Length: 1000000\r\n\r\n" + b" " * 600000)

        def is_busy() -> bool:
            answer = post(one, "/v1/eval", model="better", medium=SKIN, spacing="linear",
                          radius_count=40000, radius_stop=1)
            if answer.status == 429:
                assert int(answer.headers["Retry-After"]) >= 1
                assert answer.json["status"] == "busy"
            return answer.status == 429

        assert eventually(is_busy)
    assert eventually(lambda: get(one, "/v1/eval?model=better&medium=skin1&r=1").status == 200)


@pytest.mark.skipif(sanitized(), reason="a sanitizer's memory is another")
@pytest.mark.parametrize("room", [0, 2**21])
@pytest.mark.parametrize("r", [[1] * 300_000, ["x" * 800_000]])
def test_json_without_memory_is_busy(daemon, r, room):
    # Freed memory of this size goes back to the system, so that the room is all that there is.
    one = daemon("--http", "127.0.0.1:0", env={"LD_PRELOAD": "", "MALLOC_MMAP_THRESHOLD_": "131072"})
    assert post(one, "/v1/eval", model="better", medium=SKIN, r=[1]).status == 200
    old = resource.prlimit(one.process.pid, resource.RLIMIT_DATA)
    limit = one.resident_bytes("VmData") + room
    resource.prlimit(one.process.pid, resource.RLIMIT_DATA, (limit, old[1]))
    answer = post(one, "/v1/eval", model="better", medium=SKIN, r=r)
    assert (answer.status, answer.json["status"]) == (429, "busy"), answer.text
    resource.prlimit(one.process.pid, resource.RLIMIT_DATA, old)
    assert post(one, "/v1/eval", model="better", medium=SKIN, r=r).status in (400, 413)


# ---- CORS --------------------------------------------------------------------------------------


def test_other_origins_are_refused_unless_asked_for(served, daemon):
    origin = {"Origin": "http://example.org", "Access-Control-Request-Method": "POST"}
    answer = ask(served, "OPTIONS", "/v1/eval", headers=origin)
    assert answer.status == 405 and "Access-Control-Allow-Origin" not in answer.headers
    one = daemon("--http", "127.0.0.1:0", "--http-allow-origin", "http://example.org")
    answer = ask(one, "OPTIONS", "/v1/eval", headers=origin)
    assert answer.status == 204
    assert answer.headers["Access-Control-Allow-Origin"] == "http://example.org"
    assert (answer.headers["Access-Control-Allow-Headers"], answer.headers["Vary"]) == ("Content-Type", "Origin")
    answer = ask(one, "POST", "/v1/eval", GOOD, {**JSON, **origin})
    assert answer.status == 200 and answer.headers["Access-Control-Allow-Origin"]


# ---- connections -------------------------------------------------------------------------------


def test_many_requests_over_one_connection(served):
    connection = http.client.HTTPConnection(*address(served), timeout=TIMEOUT_S)
    socks = set()
    for i in range(20):
        connection.request("GET", f"/v1/eval?model=better&medium=skin1&r={i}")
        assert connection.getresponse().read()
        socks.add(connection.sock)
    assert len(socks) == 1
    connection.close()


def test_one_more_connection_is_closed(daemon):
    one = daemon("--http", "127.0.0.1:0", "--max-http-connections", "3")
    held = [socket.create_connection(address(one), TIMEOUT_S) for _ in range(3)]
    for sock in held:
        sock.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert sock.recv(100).startswith(b"HTTP/1.1 200")
    with socket.create_connection(address(one), TIMEOUT_S) as sock:
        try:
            sock.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert sock.recv(100) == b""
        except ConnectionError:
            pass
    held.pop().close()
    assert eventually(lambda: _serves(one))
    for sock in held:
        sock.close()


def _serves(daemon) -> bool:
    try:
        return get(daemon, "/healthz").status == 200
    except (OSError, http.client.HTTPException):
        return False


@pytest.mark.parametrize(
    "beginning",
    [
        b"",
        b"GET /healthz HTTP/1.1\r\nX: ",
        b"POST /v1/eval HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 100\r\n\r\n{",
    ],
)
def test_slow_and_idle_clients_are_closed(daemon, beginning):
    one = daemon("--http", "127.0.0.1:0", "--frame-timeout-ms", "400")
    began = time.monotonic()
    with socket.create_connection(address(one), TIMEOUT_S) as sock:
        sock.sendall(beginning)
        sock.settimeout(0.1)
        while True:
            assert time.monotonic() - began < HANG_S
            try:
                if sock.recv(1000) == b"":
                    break
            except TimeoutError:
                if beginning:
                    sock.sendall(b"x")  # A byte now and then does not help.
            except OSError:
                break
    assert time.monotonic() - began >= 0.35
    assert _serves(one)


def test_idle_and_slow_clients_leave_the_binary_protocol_alone(daemon):
    """1,000 connections of HTTP are idle, 100 of which send a byte of a header by turns."""
    one = daemon("--http", "127.0.0.1:0", "--max-http-connections", "2000")
    with contextlib.ExitStack() as stack:
        held = [stack.enter_context(socket.create_connection(address(one), TIMEOUT_S)) for _ in range(1000)]
        for sock in held[:100]:
            sock.sendall(b"GET /healthz HTTP/1.1\r\nX: ")
        slow = itertools.cycle(held[:100])
        client = stack.enter_context(one.client())
        with Beside(lambda: (next(slow).sendall(b"x"), time.sleep(0.005))):
            for _ in range(1000):
                client.eval("better", "skin1", [1.0])
            assert _serves(one)


def test_an_abandoned_job_ends(daemon):
    one = daemon("--http", "127.0.0.1:0", "--workers", "1")
    x = list(range(16_000))
    sent = good(post(one, "/v1/points", x=x, y=0, z=0, power=1))
    body = json.dumps({"set": sent["set"], "x": x, "y": 1, "z": 1, "tolerance": 0, "model": "better", "evaluator": "f64", **SKIN}).encode()
    with one.client() as client:
        gathered = lambda: client.statistics()["queries_gathered"]
        with socket.create_connection(address(one), TIMEOUT_S) as sock:
            sock.sendall(b"POST /v1/gather HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
                         b"Content-Length: %d\r\n\r\n" % len(body) + body)
            assert eventually(lambda: gathered() > 0)
        assert eventually(lambda: client.statistics()["owed_radii"] == 0) and gathered() < len(x)
    assert _serves(one)


def test_a_running_request_is_answered_when_the_daemon_stops(daemon):
    one = daemon("--http", "127.0.0.1:0")
    path = ("/v1/eval?model=transport&evaluator=f64&sigma_a=0.021&sigma_s=1&eta=1.33&r=1")
    idle = socket.create_connection(address(one), TIMEOUT_S)
    connection = http.client.HTTPConnection(*address(one), timeout=TIMEOUT_S)
    connection.request("GET", path)
    with one.client() as client:
        assert eventually(lambda: client.statistics()["requests_eval"] >= 1)
    one.terminate()
    answer = connection.getresponse()
    assert answer.status == 200 and json.loads(answer.read())["channels"][0]["R"]
    connection.close()
    assert idle.recv(10) == b""
    idle.close()


# ---- noise -------------------------------------------------------------------------------------


NAMES = ["model", "medium", "r", "u", "wanted", "sigma_a", "eta", "deadline_ms", "zero", "x"]
VALUES = ["better", "skin1", "1e999", "-0", "inf", "nan", "1,2,3", "%41", "%", "é", "9" * 400]
PATHS = ["/v1/eval", "/v1/sample", "/v1/invert", "/v1/table", "/v1/fit", "/v1/varying", "/%2f", "*",
         "//"]
HEADERS = [
    "",
    "Host: localhost\r\n",
    "Content-Length: 5\r\n",
    "Content-Length: -1\r\n",
    "Transfer-Encoding: chunked\r\n",
    "X: " + "y" * 40000 + "\r\n",
    "Content-Type: application/json\r\n",
    ": \r\n",
    "Expect: 100-continue\r\n",
]


def noise(dice: random.Random) -> bytes:
    """Returns bytes that resemble an HTTP request more or less."""
    pairs = [f"{dice.choice(NAMES)}={dice.choice(VALUES)}" for _ in range(dice.randrange(6))]
    method = dice.choice(["GET", "POST", "HEAD", "OPTIONS", "x"])
    head = dice.choice(HEADERS) * dice.randrange(3)
    text = f"{method} {dice.choice(PATHS)}?{'&'.join(pairs)} HTTP/1.1\r\n{head}\r\n"
    data = bytearray(text.encode())
    for _ in range(dice.randrange(4)):
        data[dice.randrange(len(data))] = dice.randrange(256)
    return bytes(data[: dice.randrange(1, len(data) + 1)] if dice.random() < 0.3 else data)


def exchange(daemon, messages: list[bytes]) -> list[bytes]:
    """Sends all messages at the same time, over connections of their own. Returns the answers."""
    socks = [socket.create_connection(address(daemon), TIMEOUT_S) for _ in messages]
    answers = [b""] * len(messages)
    for sock, message in zip(socks, messages):
        try:
            sock.sendall(message)
            sock.shutdown(socket.SHUT_WR)
        except OSError:
            pass  # The daemon has refused the message and closed the connection.
    for i, sock in enumerate(socks):
        try:
            while more := sock.recv(65536):
                answers[i] += more
        except ConnectionError:
            pass
        sock.close()
    return answers


def test_noise_is_answered_and_takes_no_memory(daemon):
    """tests/fuzz/http.c has queries and bodies of all kinds."""
    one = daemon("--http", "127.0.0.1:0", "--frame-timeout-ms", "400")
    dice = random.Random(20120101)
    get(one, "/v1/eval?model=better&medium=skin1&r=1")
    before = one.resident_bytes()
    for _ in range(10):
        for answer in exchange(one, [noise(dice) for _ in range(100)]):
            assert answer == b"" or re.match(rb"HTTP/1\.[01] ([124]\d\d|505)", answer), answer
    if not sanitized():
        assert one.resident_bytes() < before + 32 * 2**20


# ---- the OpenAPI document ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def node_modules():
    """Returns the folder in which npm has installed the packages above."""
    return npm_install(BUILD / "node-openapi", NODE_MODULES)


VALIDATE = """
import { readFileSync } from "fs";
import { Validator } from "@seriousme/openapi-schema-validator";
const result = await new Validator().validate(JSON.parse(readFileSync(0, "utf8")));
console.log(result.valid ? "valid" : JSON.stringify(result.errors));
"""

GENERATED = """
import { readFileSync } from "fs";
import { OpenAPIClientAxios } from "openapi-client-axios";
const url = readFileSync(0, "utf8");
const api = new OpenAPIClientAxios({ definition: url + "/v1/openapi.json",
                                     axiosConfigDefaults: { baseURL: url } });
const client = await api.init();
const posted = await client.eval(null, { model: "better", medium: ["skin1"], r: [0.5, 1, 2] });
const got = await client.get_eval({ model: "better", medium: "skin1", r: "0.5,1,2" });
console.log(JSON.stringify([posted.data, got.data]));
"""


def run_node(folder, name: str, script: str, text: str) -> str:
    (folder / name).write_text(script)
    done = finished("node", name, input=text, cwd=folder, env={**os.environ, "NO_PROXY": "*"})
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_document_is_valid(served, node_modules):
    document = get(served, "/v1/openapi.json").text.decode()
    assert run_node(node_modules, "validate.mjs", VALIDATE, document) == "valid\n"


def test_a_client_made_from_the_document_alone(served, node_modules):
    host, port = address(served)
    posted, got = json.loads(
        run_node(node_modules, "generated.mjs", GENERATED, f"http://{host}:{port}")
    )
    with served.client() as client:
        expected = client.eval("better", "skin1", [0.5, 1, 2])
    assert posted == got
    assert [c["R"] for c in posted["channels"]] == expected.R.tolist()


def test_the_document_lists_what_there_is(served):
    document = good(get(served, "/v1/openapi.json"))
    for path, methods in document["paths"].items():
        assert get(served, path).status in (200, 400), path
        assert ("post" in methods) == (ask(served, "POST", path, {}).status == 400), path
    schemas = document["components"]["schemas"]
    requests = [schema for name, schema in schemas.items() if name.endswith("_request")]
    assert requests and not any(schema["additionalProperties"] for schema in requests)
    properties = schemas["eval_request"]["properties"]
    assert properties["model"]["enum"] == models(served)
    assert "tolerance" in properties and "zero" not in properties
