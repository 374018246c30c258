"""Sends thousands of broken frames to a daemon. Each gets a well-formed answer, and the daemon
goes on and answers correctly. The same seed gives the same frames; $DIPOLED_FUZZ_SEED chooses
another."""

from __future__ import annotations

import os
import random

import numpy as np
import pytest
from dipole import Connection, ConnectionLost, Frame, wire
from frames import (
    EVAL, HELLO, INVERT, LINEAR, LOGARITHMIC, MEDIA, PING, SAMPLE, SKIN, SPECTRALON, STATISTICS,
    assert_daemon_serves, eval_payload, frame, invert_payload, sample_payload,
)
from known import is_last
from lists import DIPOLES, EVALUATORS, MODELS, NOTES, PARAMETERS, needs, some_value
from test_mc import mc_payload
from mixes import ALL_QUANTITIES

SEED = int(os.environ.get("DIPOLED_FUZZ_SEED", "40009"))
OPTIONS = ["--max-frame-bytes", "65536", "--max-media", "16", "--log-level", "info"]
# So that there are answers in parts, and none that takes for ever.
OPTIONS += ["--max-part-bytes", "32768", "--max-radii", "20000"]
OPTIONS += ["--max-mc-photons", "8192", "--max-mc-jobs", "1024"]
BATCH = 50
MC, CANCEL = wire.MESSAGES["mc"], wire.MESSAGES["cancel"]

COUNTS = [0, 1, 2, 7, 8, 255, 10_000, 65535, 2**16, 2**27, 2**31, 2**32 - 1, 2**53, 2**61]
COUNTS += [2**63, 2**64 - 1]
# Between which the values of a quantity are, if not between 0 and infinity.
RANGES = {
    wire.QUANTITY_CDF: (0, 1),
    wire.QUANTITY_SLOPE: (-np.inf, 0),
    wire.QUANTITY_LN_R: (-np.inf, np.inf),
}
REPLIES = {EVAL | wire.REPLY, SAMPLE | wire.REPLY, INVERT | wire.REPLY}  # that come in parts
NUMBERS = [0.0, -0.0, 1.0, -1.0, 5e-324, 1e-300, 1e300, 1e15, 1e-15, np.inf, -np.inf, np.nan]


@pytest.fixture
def rng() -> random.Random:
    """The source of all chance; its seed shows with a failure."""
    print(f"DIPOLED_FUZZ_SEED={SEED}")
    return random.Random(SEED)


def right_request(rng: random.Random) -> tuple[int, bytes]:
    """A message that is right: type and payload."""
    kind = rng.random()
    if kind < 0.08:
        return HELLO, wire.HELLO_REQUEST.pack(version_min=rng.randint(0, 1), version_max=1)
    if kind < 0.16:
        return rng.choice([MEDIA, STATISTICS]), b""
    if kind < 0.22:
        return PING, rng.randbytes(8 * rng.randint(0, 10))
    if kind < 0.26:
        albedos = [rng.random() for _ in range(rng.randint(0, 3))]
        count = rng.randint(1, 8000)
        return MC, mc_payload(photons=count, albedos=albedos)
    if kind < 0.28:
        return CANCEL, wire.CANCEL_REQUEST.pack(job_id=rng.randint(0, BATCH))
    if kind < 0.36:
        return SAMPLE, right_sample(rng)
    if kind < 0.42:
        return INVERT, right_inversion(rng)
    evaluator = rng.choice(list(EVALUATORS.values()))
    # Most tables are of models whose tables are built fast.
    table = evaluator == EVALUATORS["lut"]
    model = rng.choice(list(DIPOLES) if table and rng.random() < 0.8 else list(MODELS))
    given = dict(needs(model))
    if rng.random() < 0.3:  # mostly one that the model does not take
        name = rng.choice(list(PARAMETERS))
        given[name] = some_value(name)
    fixed = {
        "model": MODELS[model],
        "parameters": [(PARAMETERS[name].id, value) for name, value in given.items()],
        "evaluator": evaluator,
        "wanted": rng.randint(1, ALL_QUANTITIES),
    }
    count = 1 if table or model == "transport" else rng.randint(1, 4)
    media = [rng.choice([SKIN, SPECTRALON]) for _ in range(count)]
    if rng.random() < 0.4:
        spacing = rng.choice([LINEAR, LOGARITHMIC])
        count = rng.randint(1, 300 if rng.random() < 0.8 else 20_000)
        grid = {"spacing": spacing, "radius_count": count, "radius_start": 0.1, "radius_stop": 4.0}
        return EVAL, eval_payload(media, None, **grid, **fixed)
    radii = [rng.uniform(0, 9) for _ in range(rng.randint(0, 20))]
    return EVAL, eval_payload(media, radii, **fixed)


def right_sample(rng: random.Random) -> bytes:
    """The payload of a sample request; most are of models that draw fast."""
    model = rng.choice(list(DIPOLES) if rng.random() < 0.8 else ["burley", "single", "skin-red"])
    fixed = {
        "model": MODELS[model],
        "evaluator": rng.choice(list(EVALUATORS.values())),
        "wanted": rng.randint(1, ALL_QUANTITIES),
    }
    media = [rng.choice([SKIN, SPECTRALON]) for _ in range(rng.randint(1, 4))]
    if rng.random() < 0.5:
        return sample_payload(media, [rng.random() for _ in range(rng.randint(0, 20))], **fixed)
    draw = rng.choice([wire.DRAW_REGULAR, wire.DRAW_STRATIFIED, wire.DRAW_RANDOM])
    count = rng.randint(1, 300 if rng.random() < 0.9 else 5000)
    seed = 0 if draw == wire.DRAW_REGULAR else rng.getrandbits(64)
    return sample_payload(media, None, draw=draw, sample_count=count, seed=seed, **fixed)


def right_inversion(rng: random.Random) -> bytes:
    """The payload of an invert request; what it asks for need not exist."""
    count = rng.randint(1, 30 if rng.random() < 0.9 else 2000)
    albedos = [rng.choice([rng.random(), 0.0, 1.0]) for _ in range(count)]
    lengths = [10 ** rng.uniform(-4, 4) for _ in range(count)]
    fixed = {"model": MODELS[rng.choice(list(DIPOLES))], "given": rng.randint(1, 3)}
    return invert_payload(albedos, lengths, g=rng.uniform(-0.9, 0.9), **fixed)


def mutate(rng: random.Random, data: bytes, low: int = 0) -> bytes:
    """Some bytes of data changed, from an offset on: bits, counts, numbers."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        if len(changed) - low < 8:
            break
        if rng.random() < 0.3:
            changed[rng.randrange(low, len(changed))] ^= 1 << rng.randrange(8)
            continue
        width = rng.choice([2, 4, 8, 8])
        at = low + width * rng.randrange((min(len(changed), low + 160) - low) // width)
        if width == 8 and rng.random() < 0.5:
            value = np.float64(rng.choice(NUMBERS)).tobytes()
        else:
            count = (rng.choice(COUNTS) + rng.randint(-2, 2)) % 2 ** (8 * width)
            value = count.to_bytes(width, "little")
        changed[at : at + width] = value
    return bytes(changed)


def resize(rng: random.Random, payload: bytes) -> bytes:
    """A payload made longer or shorter, by whole words or by any number of bytes."""
    step = 1 if rng.random() < 0.2 else 8
    length = len(payload) + step * rng.randint(-6, 6)
    return (payload + rng.randbytes(48))[: max(0, length)]


def broken_request(rng: random.Random) -> tuple[int, bytes]:
    """A frame whose header holds, so that the stream goes on after it: type and payload."""
    type, payload = right_request(rng)
    if rng.random() < 0.8:
        payload = mutate(rng, payload)
    if rng.random() < 0.25:
        payload = resize(rng, payload)
    if rng.random() < 0.05:
        type = rng.getrandbits(16)
    return type, payload


def assert_well_formed(reply: Frame) -> None:
    """A reply of a known type that holds what it says, or an error that says what is wrong."""
    if reply.type == wire.TYPE_ERROR:
        assert len(reply.payload) == wire.ERROR.bytes
        error = wire.ERROR.unpack(reply.payload)
        assert wire.STATUSES[error.status] not in ("ok", "busy", "shutting-down")
        assert error.field and error.allowed
        return
    assert reply.type & wire.REPLY and reply.type & ~wire.REPLY in wire.MESSAGES.values()
    if reply.type in (EVAL | wire.REPLY, SAMPLE | wire.REPLY):
        assert_well_formed_eval(reply.payload, reply.type == SAMPLE | wire.REPLY)
    elif reply.type == INVERT | wire.REPLY:
        assert_well_formed_inversion(reply.payload)


def assert_well_formed_inversion(payload: bytes) -> None:
    """Each medium is there, whole, or is counted as missing."""
    fixed = wire.INVERT_REPLY.unpack(payload)
    assert fixed.part < fixed.part_count
    assert fixed.part_count == 1 or len(payload) <= 32768
    arrays = np.frombuffer(payload, "<f8", -1, wire.INVERT_REPLY.bytes).reshape(3, -1)
    assert arrays.shape[1] == fixed.medium_count
    missing = np.isnan(arrays[0])
    assert np.all(np.isnan(arrays[:, missing])) and np.all(arrays[:, ~missing] >= 0)
    assert np.count_nonzero(missing) == fixed.missing_count


def assert_well_formed_eval(payload: bytes, drawn: bool) -> None:
    """The arrays are there, and no value is NaN or out of its quantity's range."""
    fixed = wire.EVAL_REPLY.unpack(payload)
    assert fixed.part < fixed.part_count
    assert fixed.part_count == 1 or len(payload) <= 32768
    value_type = np.dtype(wire.EVALUATOR_TYPES[fixed.evaluator])
    per_channel = [q for q in (wire.DRAWN if drawn else wire.ELEMENTWISE) if fixed.wanted & q]
    radii = bool(fixed.wanted & wire.QUANTITY_RADIUS) and not drawn
    quantities = [wire.QUANTITY_RADIUS] * radii + per_channel * fixed.channel_count
    start = wire.EVAL_REPLY.bytes + fixed.channel_count * wire.CHANNEL.bytes
    row_bytes = wire.padded(fixed.radius_count * value_type.itemsize)
    assert len(payload) == start + len(quantities) * row_bytes
    channels = np.frombuffer(payload[wire.EVAL_REPLY.bytes : start], "<f8").reshape(-1, 4)
    if fixed.wanted & wire.QUANTITY_ALBEDO:
        # A published model may give out more than went in, and then says so.
        said = bool(fixed.notes & NOTES["albedo-above-1"])
        albedo, numerical_error = channels[:, 0], channels[:, 1]
        assert np.all((albedo >= 0) & (said | (albedo <= 1 + numerical_error)))
    for row, quantity in enumerate(quantities):
        values = np.frombuffer(payload, value_type, fixed.radius_count, start + row * row_bytes)
        least, most = RANGES.get(quantity, (0, np.inf))
        assert np.all((values >= least) & (values <= most)), (quantity, fixed)


def receive_answers(connection: Connection, count: int) -> list[Frame]:
    """The frames until so many answers have come to their end."""
    frames = []
    while count > 0:
        frames.append(connection.receive_frame())
        count -= is_last(frames[-1]) and not is_progress(frames[-1])
    return frames


def is_progress(reply: Frame) -> bool:
    """Whether more replies to the same mc request follow."""
    if reply.type != MC | wire.REPLY:
        return False
    return wire.MC_REPLY.unpack(reply.payload).state == wire.MC_UNDER_WAY


def assert_parts_follow_each_other(replies: list[Frame]) -> int:
    """An answer's parts are all there, in their order; how many answers have more than one."""
    begun: dict[int, int] = {}
    for reply in replies:
        if reply.type in REPLIES:
            inverted = reply.type == INVERT | wire.REPLY
            fixed = (wire.INVERT_REPLY if inverted else wire.EVAL_REPLY).unpack(reply.payload)
            assert fixed.part == begun.get(reply.request_id, 0)
            begun[reply.request_id] = fixed.part + 1
    return sum(parts > 1 for parts in begun.values())


def test_broken_payloads(daemon, rng):
    one = daemon(*OPTIONS)
    outcomes = {True: 0, False: 0}
    in_parts = 0
    with one.connect() as connection:
        for batch in range(80):
            requests = [broken_request(rng) for _ in range(BATCH)]
            data = [frame(type, i, payload) for i, (type, payload) in enumerate(requests)]
            connection.send_bytes(b"".join(data))
            replies = receive_answers(connection, len(requests))
            assert sorted({reply.request_id for reply in replies}) == list(range(BATCH)), batch
            in_parts += assert_parts_follow_each_other(replies)
            for reply in replies:
                assert_well_formed(reply)
                outcomes[reply.type == wire.TYPE_ERROR] += 1
            if batch % 10 == 0:
                assert_daemon_serves(one)
    assert min(outcomes.values()) > 500 and in_parts > 10, (outcomes, in_parts)
    assert_daemon_serves(one)


def read_to_the_end(connection: Connection) -> list[Frame]:
    """All frames until the daemon closes."""
    frames = []
    try:
        while not connection.receive_eof():
            frames.append(connection.receive_frame())
    except ConnectionLost:
        pass  # in the middle of nothing: receive_frame() had no byte
    return frames


def test_broken_streams(daemon, rng):
    """Headers and lengths broken too: whatever the daemon makes of it, it says so and closes."""
    one = daemon(*OPTIONS)
    before = 0
    for i in range(400):
        requests = [right_request(rng) for _ in range(2)]
        stream = mutate(rng, b"".join(frame(type, 7, payload) for type, payload in requests))
        if rng.random() < 0.3:
            stream = stream[: rng.randrange(len(stream))]
        with one.connect(rng.choice(["unix", "tcp"])) as connection:
            connection.send_bytes(stream)
            if rng.random() < 0.1:
                continue  # gone without a word
            connection.half_close()
            for reply in read_to_the_end(connection):
                assert_well_formed(reply)
                before += 1
        if i % 50 == 0:
            assert_daemon_serves(one)
    assert before > 400
    assert_daemon_serves(one)


def test_noise(daemon, rng):
    one = daemon(*OPTIONS)
    for _ in range(60):
        with one.connect(rng.choice(["unix", "tcp"])) as connection:
            connection.send_bytes(rng.randbytes(rng.choice([1, 23, 24, 100, 70_000])))
            connection.half_close()
            frames = read_to_the_end(connection)
            assert len(frames) == 1 and frames[0].type == wire.TYPE_ERROR
            error = wire.ERROR.unpack(frames[0].payload)
            assert wire.STATUSES[error.status] in ("bad-magic", "truncated")
    assert_daemon_serves(one)
