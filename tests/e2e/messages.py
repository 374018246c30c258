"""What each message of the protocol brings to the matrix in test_messages.py: a request with a known
answer, which is the example of PROTOCOL.md, requests that take long or are answered in parts, the
roles that they need, and the calls of the Python client."""

import random
import re
from typing import Any, NamedTuple

import dipole
import numpy as np
from daemons import REPOSITORY, Daemon
from dipole import Connection, Frame, Grid, Medium, wire
from dipole.mc import pack_request
from frames import (
    ALBEDO, BETTER, CDF, CLASSICAL, EVAL, F32, F64, INVERT, RADIUS, READINGS, SAMPLE, SKIN, R, ask,
    eval_payload, fit_payload, frame, gather_payload, invert_payload, points_payload, receive_reply, sample_payload,
    varying_payload,
)
from lists import MODELS

MC = wire.MESSAGES["mc"]
GATHER = wire.MESSAGES["gather"]
POINTS = wire.MESSAGES["points"]
LUT = 3


def read_examples(document: str) -> dict[str, bytes]:
    """Reads the frames in blocks ```hex NAME: digits, and comments from # to the end of the line."""
    text = (REPOSITORY / "proto" / document).read_text()
    return {
        name: bytes.fromhex(re.sub(r"#.*", "", body))
        for name, body in re.findall(r"^```hex ([\w-]+)\n(.*?)^```", text, re.M | re.S)
    }


EXAMPLES = read_examples("PROTOCOL.md")
SAMPLES = {name: EXAMPLES[f"{name}-request"][wire.HEADER.bytes :] for name in wire.MESSAGES}

# The roles without which certificates are refused, by message; others need none.
ROLES = {
    **dict.fromkeys(["eval", "offers", "sample", "invert", "varying", "tissue"], "evaluate"),
    **dict.fromkeys(["table", "mc", "fit", "fit_layers", "fit_tissue", "points", "gather"], "compute"),
    "statistics": "observe",
}

# ---- requests ------------------------------------------------------------------------------------

# Options of daemons that answer large requests in parts: with parts of some values, and of many.
SMALL = ("--max-frame-bytes", "65536", "--max-part-bytes", "16384")
PARTS = ("--max-frame-bytes", "1048576", "--max-part-bytes", "65536")
GRID = {"radii": None, "radius_stop": 20.0}
POINTS_SENT = dipole.Points(np.random.default_rng(1).uniform(-10, 10, (1200, 3)), np.ones((1200, 4)))
FOUR = [SKIN] * 4
PLACES = np.random.default_rng(2).uniform(-12, 12, (300_000, 3))
NOISE = np.random.default_rng(3).normal(1, 0.02, (4000, len(READINGS)))
COLOURS = np.linspace(0.001, 0.999, 1_000_000)
FEW = COLOURS[::450] - 0.001  # the first absorbs nothing

# Requests that fit into a frame of SMALL, though their answers do not.
PARTED = {
    "eval": eval_payload([SKIN] * 2, **GRID, radius_count=5000, wanted=R | RADIUS),
    "sample": sample_payload([SKIN], None, sample_count=20_000),
    "invert": invert_payload(COLOURS[::300], np.ones(3334)),
    "fit": fit_payload(READINGS * NOISE[:500], residuals=1),
    "varying": varying_payload(np.full((2500, 2), (0.1, 1.0)), np.ones(2500), wanted=R | CDF | ALBEDO, coefficients=1),
    "gather": gather_payload(POINTS_SENT, FOUR, PLACES[:2500]),
}

# Work for a second at least, or an answer of gigabytes.
LONG = {
    "eval": eval_payload(radii=None, radius_count=2**31, wanted=R),
    "sample": sample_payload([SKIN], None, sample_count=60_000, model=MODELS["beam+single"], wanted=RADIUS),
    "invert": invert_payload(COLOURS[::25], np.ones(40_000), eta=1.37, errors=2),
    "fit": fit_payload(READINGS * NOISE[:4000]),
    "varying": varying_payload(np.full((2_000_000, 2), (0.1, 1.0)), np.ones(2_000_000), wanted=199),
    "gather": gather_payload(POINTS_SENT, FOUR, PLACES, tolerance=0.0, model=MODELS["extended"]),
    "mc": pack_request(
        medium=Medium(1e-4, 10.0, 0.9, 1.4), edges=Grid(0.0, 5.0, 11), spacing=2, photons=10**10, seed=1,
        error_total=0.0, error_rings=0.0, albedos=(),
    ),
}  # fmt: skip


def send_points(connection: Connection, message: str = "gather") -> None:
    """Sends the points that a gather of SAMPLES, PARTED or LONG needs."""
    if message == "gather":
        for payload in (SAMPLES["points"], points_payload(POINTS_SENT)):
            assert ask(connection, POINTS, payload).type == POINTS | wire.REPLY


# ---- answers -------------------------------------------------------------------------------------


def reply_structure(message: str) -> wire.Structure:
    """Returns the fixed part of the replies to a message."""
    own = {"sample": "eval_reply", "media": "list_reply", "statistics": "list_reply"}
    return wire.STRUCTURES[own.get(message, f"{message}_reply")]


MESSAGE_OF = {type | wire.REPLY: name for name, type in wire.MESSAGES.items()}
STREAMED = [
    name for name in wire.MESSAGES if name != "ping" and reply_structure(name).fields[0].name == "part"
]


def is_last(reply: Frame) -> bool:
    """Returns whether no further frame belongs to the same answer."""
    message = MESSAGE_OF.get(reply.type)
    if message == "mc":
        return wire.MC_REPLY.unpack(reply.payload).state != wire.MC_UNDER_WAY
    if message in STREAMED:
        part = wire.PART.unpack(reply.payload)
        return part.part + 1 == part.part_count
    return True


REPLIES = {kind | wire.REPLY: wire.STRUCTURES.get(f"{name}_reply") for name, kind in wire.MESSAGES.items()}


def receive_answer(connection: Connection) -> tuple[Frame, tuple[bytes, ...]]:
    """Receives the next answer. Returns its first frame, and the payloads of all its parts without
    reports of progress, nor of work that goes on, which may take 5 s on a busy machine."""
    frames: list[Frame] = []
    while not frames or not is_last(frames[-1]):
        frames.append(receive_reply(connection))
        assert frames[-1][:2] == frames[0][:2], frames[-1][:2]
    for one in frames if REPLIES.get(frames[0].type) else ():
        fixed = REPLIES[one.type].unpack(one.payload)._asdict()
        assert not any(np.less(value, 0).any() for name, value in fixed.items() if "error" in name), fixed
    is_job = frames[0].type == MC | wire.REPLY
    return frames[0], tuple(one.payload for one in (frames[-1:] if is_job else frames))


class Known(NamedTuple):
    """A request and its only correct answer: the payloads of all its frames."""

    type: int
    payload: bytes
    answer: tuple[bytes, ...]

    def frame(self, request_id: int) -> bytes:
        """Makes the frame of the request."""
        return frame(self.type, request_id, self.payload)


def assert_answer(known: Known, first: Frame, parts: tuple[bytes, ...]) -> None:
    """Checks that an answer is the known one, bit for bit."""
    assert first.type == known.type | wire.REPLY, f"{first.type:#x}: {refusal(first)}"
    assert parts == known.answer, "an answer with other bits"


def refusal(reply: Frame) -> str:
    """Returns the name of the status of an error frame, or "" for any other frame."""
    if reply.type != wire.TYPE_ERROR:
        return ""
    return wire.STATUSES[wire.ERROR.unpack(reply.payload).status]


def known_answers(daemon: Daemon, requests: list[tuple[int, bytes]]) -> list[Known]:
    """Sends requests to a daemon, one at a time, and returns them with their answers."""
    with daemon.connect() as connection:
        send_points(connection)
        answers = []
        for type, payload in requests:
            connection.send_bytes(frame(type, 1, payload))
            first, parts = receive_answer(connection)
            assert first.type == type | wire.REPLY, refusal(first)
            answers.append(Known(type, payload, parts))
        return answers


def short_requests(count: int, seed: int = 7) -> list[tuple[int, bytes]]:
    """Makes different eval requests of a few radii each, for several models, media and
    precisions."""
    rng = random.Random(seed)
    requests = []
    for i in range(count):
        medium = (rng.uniform(0.01, 0.1), rng.uniform(0.5, 2.0), 0.0, 1.3)
        payload = eval_payload(
            [medium, SKIN][: 1 + i % 2],
            [rng.uniform(0.1, 5.0) for _ in range(1 + i % 16)],
            model=(BETTER, CLASSICAL)[i % 2],
            evaluator=(F64, F32)[i // 2 % 2],
            wanted=R | ALBEDO | CDF,
        )
        requests.append((EVAL, payload))
    return requests


def every_kind() -> list[tuple[int, bytes]]:
    """Makes requests of each kind that is answered in order and always the same, by a daemon that
    has no points, some of them in parts."""
    small = ("media", "ping", "offers", "table", "sample", "invert", "fit", "varying")
    return [
        *short_requests(12),
        *((wire.MESSAGES[name], SAMPLES[name]) for name in small),
        (EVAL, eval_payload([SKIN] * 3, **GRID, radius_count=5000, wanted=R | RADIUS)),
        (EVAL, eval_payload([SKIN], **GRID, radius_count=300, evaluator=LUT, wanted=R)),
        (EVAL, eval_payload([SKIN], **GRID, radius_count=400_000, evaluator=F32, wanted=R)),
        (SAMPLE, sample_payload([SKIN], None, sample_count=200_000, evaluator=LUT)),
        (INVERT, invert_payload([i / 3000 for i in range(1, 3000)], [1.0] * 2999)),
    ]


# ---- the Python client ---------------------------------------------------------------------------

THREE = [Medium(0.032, 0.74), Medium(0.17, 0.88), Medium(0.48, 1.01)]
RADII = np.linspace(0.5, 3, 6)
# By the name of a call: its arguments and options.
CALLS: dict[str, tuple[list[Any], dict[str, Any]]] = {
    "eval": (["better", THREE, [0.5, 1.0]], {"wanted": ["R", "cdf", "albedo"]}),
    "values": (["better", Medium(np.linspace(0.01, 1, 5)[:, None], 1.0), np.linspace(0, 3, 4)],
               {"quantity": "cdf", "evaluator": "f32"}),
    "media": ([], {}),
    "offers": ([SKIN, [1.0]], {"tolerance": 0.02}),
    "table": (["better", SKIN], {"tolerance": 1e-3}),
    "surface": (["transport", 0.3, 1.4], {"tolerance": 1e-2}),
    "sample": (["better", "skin1"], {"draw": dipole.Draw(100)}),
    "invert": (["better", [0.2, 0.8], 1.5], {}),
    "fit": (["better", RADII, np.exp(-RADII), 0.01 * np.exp(-RADII)], {"eta": 1.4}),
    "fit_tissue": ([["hbo2_uM"], [800.0], [5.0], [[2e-4]], 1e-5],
                   {"properties": {"a_per_mm": 2, "b": 1}, "model": "better"}),
    "fit_layers": ([(0, 0.74, 0, 1.3), ["sigma_a_1"], [3.0], [2.7e-3], [1e-5]], {}),
    "tissue": ([[650, 850], "liver", {"hbo2_uM": 100.0}], {"haemoglobin": "ucl"}),
    "varying": (["better"], {"sigma_a": [0.1, 0.2], "sigma_s": 1.0, "r": [[0.5], [1.0]]}),
    "gather": (["better", FOUR, POINTS_SENT, np.ones((30, 3))], {}),
    "mc": ([SKIN, Grid(0, 4, 5)], {"photons": 20000, "seed": 3}),
}  # fmt: skip
# The same for answers in parts.
PARTED_CALLS: dict[str, tuple[list[Any], dict[str, Any]]] = {
    "eval": (["better", THREE], {"grid": Grid(0.0, 5.0, 5001), "wanted": ["R", "albedo", "r"]}),
    "sample": (["better", "skin1"], {"draw": dipole.Draw(5000, "stratified", seed=5), "evaluator": "f32"}),
    "invert": (["better", COLOURS[::300], 1.5], {"g": 0.3, "given": "diffuse-mean-free-path"}),
    "fit": (["better", [1.0, 2.0, 4.0], READINGS * NOISE[:500], 0.02 * np.array(READINGS)],
            {"eta": 1.4, "residuals": True}),
    "fit_tissue": ([["hbo2_uM", "a_per_mm"], [690.0, 830.0], [3.0, 6.0],
                    2e-4 * np.random.default_rng(4).uniform(0.5, 1, (500, 2, 2)), 1e-5],
                   {"properties": {"b": 1}, "model": "better", "residuals": True}),
    "varying": (["better"], {"sigma_a": FEW, "sigma_s": 1.0, "r": 0.5, "evaluator": "f64",
                             "wanted": ["R", "albedo", "cdf"], "coefficients": ["sigma_a"]}),
    "gather": (["better", FOUR, POINTS_SENT, PLACES[:2500]], {}),
}  # fmt: skip


# ---- the command line, which is libdipole --------------------------------------------------------


def csv_of(header: str, rows) -> bytes:
    """Makes a CSV file."""
    lines = [header, *(",".join(map(str, row)) for row in np.asarray(rows).tolist()), ""]
    return "\n".join(lines).encode()


# The files that commands read, by name.
FILES = {
    "colours.pfm": b"Pf\n95 80\n-1.0\n" + COLOURS[:760_000:100].astype("<f4").tobytes(),
    "readings.csv": csv_of("sample,r,R,error", [
        (i, r, R * noise, 0.02 * R) for i, one in enumerate(NOISE[:500]) for r, R, noise in zip((1, 2, 4), READINGS, one)
    ]),
    "reading.csv": csv_of("r,R,error", [(3, 2.7e-3, 1e-5)]),
    "images.csv": csv_of("wavelength_nm,f,image,relative_error", [(nm, 0.1, f"{nm}.image.pfm", 0.01) for nm in (650, 850)]),
    **{f"{nm}.image.pfm": b"Pf\n2000 1\n-1.0\n" + np.full(2000, 0.3, "<f4").tobytes() for nm in (650, 850)},
    "points.csv": csv_of("x,y,z,power", np.hstack([POINTS_SENT.xyz, POINTS_SENT.power[:, :1]])),
    "places.csv": csv_of("x,y,z", PLACES[:2500]),
}
BETTER_SKIN = ("--model", "better", "--medium", "skin1", "--channel", "red", "--format", "csv")
# By message: a command, whose answer comes in parts as far as there are any. `dipole invert` asks for
# one medium at a time.
COMMANDS = {
    "eval": ["eval", *BETTER_SKIN, "--count", "5000"],
    "sample": ["sample", *BETTER_SKIN, "--count", "5000"],
    "fit": ["fit", "--model", "better", "--eta", "1.4", "--format", "csv", "readings.csv"],
    "fit_layers": ["fit", "--layer", "x,0.74,0,1.3", "--format", "csv", "reading.csv"],
    "fit_tissue": ["fit", "--unknown", "hbo2", "--tissue", "a=1,b=1", "--model", "better", "--maps", "media.pfm", "images.csv"],
    "tissue": ["tissue", "--tissue", "liver", "--wavelengths", "650,850", "--format", "csv"],
    "varying": ["texture", "--model", "better", "--mean-free-path", "1", "colours.pfm", "media.pfm"],
    "gather": ["gather", *BETTER_SKIN, "points.csv", "places.csv"],
    "mc": ["mc", "--medium", "skin1", "--channel", "red", "--photons", "20000", "--format", "csv"],
    "table": ["table", *BETTER_SKIN],
    "media": ["media"],
    "statistics": ["info"],
    "hello": ["media"],
}


def call(client: dipole.Client, name: str, calls=None) -> Any:
    """Makes a call of CALLS or of others."""
    arguments, options = (calls or CALLS)[name]
    return getattr(client, name)(*arguments, **options)


def assert_same(found: Any, expected: Any) -> None:
    """Compares all that two answers hold."""
    assert type(found) is type(expected)
    if isinstance(found, dict):
        assert found.keys() == expected.keys()
        for name in found:
            assert_same(found[name], expected[name])
    elif isinstance(found, (dipole.Table, dipole.Surface)):
        assert found.data == expected.data
    elif isinstance(found, list):
        for one, other in zip(found, expected, strict=True):
            assert_same(one, other)
    elif hasattr(found, "__dict__"):
        assert_same(vars(found), vars(expected))
    elif isinstance(found, np.ndarray):
        assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
        assert found.tobytes() == expected.tobytes()
    else:
        np.testing.assert_equal(found, expected)
