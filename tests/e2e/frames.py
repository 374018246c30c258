"""Builds requests byte by byte, valid and invalid ones, and checks replies."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from dipole import Connection, ConnectionLost, Frame, Points, wire

SKIN = (0.032, 0.74, 0.0, 1.3)  # skin1, red
SPECTRALON = (0.0, 11.6, 0.0, 1.3)  # no absorption: the better dipole's albedo is exactly 1

CLASSICAL, BETTER = 1, 2
F64, F32 = 1, 2
EXACT, FIT = 1, 2
R, ALBEDO, CDF, RADIUS, PDF = 1, 2, 4, 8, 64
LIST, LINEAR, LOGARITHMIC = 1, 2, 3

PING = wire.MESSAGES["ping"]
HELLO = wire.MESSAGES["hello"]
EVAL = wire.MESSAGES["eval"]
MEDIA = wire.MESSAGES["media"]
STATISTICS = wire.MESSAGES["statistics"]
SAMPLE = wire.MESSAGES["sample"]
INVERT = wire.MESSAGES["invert"]
FIT_REQUEST = wire.MESSAGES["fit"]
VARYING = wire.MESSAGES["varying"]


def header(**changes: int) -> bytes:
    """Makes a valid header, with some fields changed."""
    fields = {
        "magic": wire.MAGIC,
        "version": wire.VERSION,
        "type": PING,
        "request_id": 1,
        "payload_bytes": 0,
        "deadline_ms": 0,
    }
    return wire.HEADER.pack(**{**fields, **changes})


def frame(type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0) -> bytes:
    fields = {"request_id": request_id, "deadline_ms": deadline_ms}
    return header(type=type, payload_bytes=len(payload), **fields) + payload


def media_bytes(media) -> bytes:
    """Makes medium structures, of half spaces where there are four numbers."""
    rows = [media] if len(media) and np.isscalar(media[0]) else media
    return b"".join(np.asarray([*row, 0.0][:5], "<f8").tobytes() for row in rows)


def radii_bytes(radii, evaluator: int = F64) -> bytes:
    """Makes a list of radii with its padding."""
    listed = np.asarray(radii, wire.EVALUATOR_TYPES[evaluator]).tobytes()
    return listed + bytes(wire.padded(len(listed)) - len(listed))


def parameters_bytes(parameters) -> bytes:
    """Makes parameter structures from pairs of id and value."""
    return b"".join(wire.PARAMETER.pack(parameter=id, value=value) for id, value in parameters)


# What requests say unless a test says otherwise. Other fields are 0, and counts are those of the lists.
USUAL = {
    "model": BETTER, "evaluator": F64, "moments": EXACT, "layer_count": 1, "g": 0.0, "eta": 1.3,
    "given": 1, "axis": 1, "scale": 1, "unknowns": 1, "haemoglobin": 1,
}  # fmt: skip


def packed(structure: wire.Structure, fields, *lists: bytes) -> bytes:
    """Makes a payload of a fixed part and lists."""
    usual = {name: USUAL.get(name, 0) for name in structure.names}
    return structure.pack(**usual | fields) + b"".join(lists)


def f64_bytes(*arrays) -> bytes:
    """Makes lists of f64."""
    return b"".join(np.asarray(array, "<f8").tobytes() for array in arrays)


def numbers_bytes(numbers, fields) -> bytes:
    """Makes a list of radii or the like for the evaluator that the fields name, if there is one."""
    evaluator = fields.get("evaluator", F64)
    listed = [] if numbers is None else numbers
    return radii_bytes(listed, evaluator if evaluator in wire.EVALUATOR_TYPES else F64)


def eval_payload(media=(SKIN,), radii=(0.5, 1.0), parameters=(), **fixed: float) -> bytes:
    """Makes an eval request. radii: None for a grid. parameters: pairs of id and value, or their
    bytes."""
    listed = parameters if isinstance(parameters, bytes) else parameters_bytes(parameters)
    counts = {"medium_count": len(media), "parameter_count": len(listed) // wire.PARAMETER.bytes}
    if radii is None:
        counts |= {"spacing": LINEAR, "radius_count": 2, "radius_stop": 1.0}
    else:
        counts |= {"spacing": LIST, "radius_count": len(radii)}
    fields = {"wanted": R | ALBEDO | CDF} | counts | fixed
    return packed(wire.EVAL_REQUEST, fields, media_bytes(media), listed, numbers_bytes(radii, fixed))


def sample_payload(media=(SKIN,), u=(0.25, 0.5), parameters=(), **fixed: int) -> bytes:
    """Makes a sample request. u: None for numbers by a rule."""
    counts = {"medium_count": len(media), "parameter_count": len(parameters)}
    if u is None:
        counts |= {"draw": wire.DRAW_RANDOM, "sample_count": 2, "seed": 1}
    else:
        counts |= {"draw": wire.DRAW_LIST, "sample_count": len(u)}
    fields = {"wanted": RADIUS | PDF} | counts | fixed
    lists = media_bytes(media), parameters_bytes(parameters), numbers_bytes(u, fixed)
    return packed(wire.SAMPLE_REQUEST, fields, *lists)


def invert_payload(albedos=(0.5, 0.9), lengths=(1.0, 2.0), **fixed: float) -> bytes:
    fields = {"medium_count": len(albedos)} | fixed
    return packed(wire.INVERT_REQUEST, fields, f64_bytes(albedos, lengths))


def varying_payload(media=((0.032, 0.74), (0.1, 1.0)), numbers=(0.5, 1.0), parameters=(),
                    **fixed: float) -> bytes:
    """Makes a varying request. media: pairs of sigma_a and sigma_s, or of colour and length.
    numbers: radii or, with numbers=2, u; None: neither."""
    kind = wire.VARYING_NONE if numbers is None else wire.VARYING_RADII
    counts = {"parameter_count": len(parameters), "value_count": len(media)}
    fields = {"wanted": R, "given": 0, "numbers": kind} | counts | fixed
    pairs = np.asarray(media, float).reshape(-1, 2)
    lists = [numbers_bytes(array, fixed) for array in (pairs[:, 0], pairs[:, 1], numbers)]
    return packed(wire.VARYING_REQUEST, fields, parameters_bytes(parameters), *lists)


def table_payload(medium=SKIN, parameters=(), **fixed: int) -> bytes:
    fields = {"parameter_count": len(parameters)} | fixed
    return packed(wire.TABLE_REQUEST, fields, media_bytes([medium]), parameters_bytes(parameters))


def mc_payload(medium=(0.1, 0.9, 0.3, 1.3), albedos=(), parameters=(), **fixed: float) -> bytes:
    """Makes an mc request of two batches of photons and ten rings."""
    walk = {"spacing": LINEAR, "ring_count": 10, "radius_stop": 5.0, "seed": 1, "photons": 8192}
    lists = media_bytes([medium]), f64_bytes(albedos), parameters_bytes(parameters)
    return packed(wire.MC_REQUEST, walk | {"albedo_count": len(albedos)} | fixed, *lists)


def points_payload(points: Points, first: int = 0, count: int | None = None, **fixed) -> bytes:
    """Makes the payload of a part of a set."""
    count = len(points) - first if count is None else count
    part = slice(first, first + count)
    counts = {"point_count": len(points), "point_first": first, "part_points": count}
    fields = {"set": words(points.name), "channel_count": points.channels} | counts | fixed
    lists = points.xyz[part].tobytes(), points.power[part].tobytes()
    zeros = bytes(wire.padded(len(lists[1])) - len(lists[1]))
    return packed(wire.POINTS_REQUEST, fields, *lists, zeros)


def gather_payload(points: Points, media=(SKIN,), queries=((0.0, 0.0, 1.0),), parameters=(), **fixed) -> bytes:
    """Makes a gather request."""
    counts = {"medium_count": len(media), "query_count": len(queries), "parameter_count": len(parameters)}
    fields = {"set": words(points.name), "tolerance": 1e-3} | counts | fixed
    return packed(wire.GATHER_REQUEST, fields, media_bytes(media), parameters_bytes(parameters), f64_bytes(queries))


def words(name: bytes) -> tuple[int, ...]:
    """Returns the name of a set of points as the fields `set` have it."""
    return tuple(np.frombuffer(name, "<u8").tolist())


READINGS = (0.0234, 0.00787, 0.00159)  # of sigma_a 0.03, sigma_s' 1.2 and eta 1.4 at 1, 2, 4 mm


def fit_payload(
    values=(READINGS,), errors=((5e-4, 2e-4, 3e-5),), at=(1.0, 2.0, 4.0), parameters=(),
    reference=None, discs=None, **fixed: float,
) -> bytes:
    """Makes a fit request: readings of several sets under the better dipole."""
    head = {"set_count": len(values)}
    head |= {name: fixed.pop(name) for name in wire.FIT_REQUEST.names if name in fixed}
    scale = 1 if reference is None else wire.SCALE_REFERENCE
    counts = {"reading_count": len(at), "parameter_count": len(parameters)}
    design = packed(wire.FIT_DESIGN, {"scale": scale, "eta": 1.4} | counts | fixed)
    lists = parameters_bytes(parameters), media_bytes([] if reference is None else reference)
    places = f64_bytes(at, discs or np.zeros((2, len(at))))
    sets = f64_bytes(values, np.broadcast_to(errors, np.shape(values)))
    return packed(wire.FIT_REQUEST, head, design, *lists, places, sets)


def fit_layers_payload(
    media=(SKIN,), at=(3.0,), values=(2.7e-3,), errors=(1e-5,), **fixed: int
) -> bytes:
    """Makes a fit of layers, of sigma_a_1."""
    fields = {"layer_count": len(media), "reading_count": len(at)} | fixed
    lists = media_bytes(media), f64_bytes(at, values, errors)
    return packed(wire.FIT_LAYERS_REQUEST, fields, *lists)


def tissue_payload(properties=((32, 1.0), (33, 1.0), (3, 0.7)), wavelengths=(650.0, 850.0), **fixed: int) -> bytes:
    """Makes a tissue request, of water that scatters."""
    fields = {"property_count": len(properties), "wavelength_count": len(wavelengths)} | fixed
    return packed(wire.TISSUE_REQUEST, fields, parameters_bytes(properties), f64_bytes(wavelengths))


def fit_tissue_payload(
    sought=((1, 0.0, 0.0), (2, 0.0, 0.0)), properties=((32, 2.0), (33, 1.0)),
    wavelengths=(690.0, 830.0), at=(5.0,), values=((2e-4, 2e-4),), errors=((1e-5, 1e-5),),
    discs=None, mhz=(0.0,), quantity=(0.0,), **fixed: float,
) -> bytes:
    """Makes a fit of a tissue under the better dipole: haemoglobin by default."""
    counts = {
        "set_count": len(values), "property_count": len(properties), "sought_count": len(sought),
        "wavelength_count": len(wavelengths), "place_count": len(at),
    }  # fmt: skip
    listed = b"".join(wire.SOUGHT.pack(property=id, low=low, high=high) for id, low, high in sought)
    places = at, discs or np.zeros((2, len(at))), *np.broadcast_arrays(mhz, quantity, at)[:2]
    lists = parameters_bytes(properties), listed, f64_bytes(*places, wavelengths, values, errors)
    return packed(wire.FIT_TISSUE_REQUEST, counts | fixed, *lists)


def receive_reply(connection: Connection) -> Frame:
    """Receives the next frame but those that say that work goes on, every 5 s on a busy machine."""
    while (one := connection.receive_frame())[::2] == (PING | wire.REPLY, b""):
        pass
    return one


def ask(connection: Connection, type: int, payload: bytes = b"", request_id: int = 77) -> Frame:
    """Sends one request and waits for one frame."""
    connection.send_bytes(frame(type, request_id, payload))
    return connection.receive_frame() if type == PING else receive_reply(connection)


def assert_error(
    reply: Frame, status: str, field: str, allowed: str, index: int = 0, request_id: int = 77
) -> None:
    """Checks that the reply is an error that names status, field and position, and says what is
    allowed."""
    assert reply.type == wire.TYPE_ERROR, f"a reply of type {reply.type:#x}, not an error"
    assert reply.request_id == request_id
    assert len(reply.payload) == wire.ERROR.bytes
    error = wire.ERROR.unpack(reply.payload)
    assert (wire.STATUSES[error.status], error.field) == (status, field), error
    assert error.allowed and allowed in error.allowed and len(error.allowed) < 80, error  # not cut
    assert error.index == index, error
    assert error.zero == 0
    assert (error.retry_after_ms > 0) == (status == "busy"), error


def head_bytes(channels: int, quantities: int) -> int:
    """Returns the size of an eval reply before its radii and arrays."""
    return wire.EVAL_REPLY.bytes + channels * (8 + quantities * wire.QUANTITY_ERROR.bytes)


def assert_serves(connection: Connection) -> None:
    """Sends a ping and an eval of an albedo over the connection, and checks both answers."""
    echo = ask(connection, PING, b"answered", request_id=901)
    assert echo == Frame(PING | wire.REPLY, 901, b"answered")
    payload = eval_payload([SPECTRALON], [], wanted=ALBEDO)
    reply = ask(connection, EVAL, payload, request_id=902)
    assert (reply.type, reply.request_id) == (EVAL | wire.REPLY, 902)
    assert struct.unpack_from("<d", reply.payload, wire.EVAL_REPLY.bytes) == (1.0,)


def assert_refused(connection: Connection, type: int, payload: bytes, *error) -> str:
    """Checks that the daemon answers the request with this error and goes on serving the
    connection. Returns what the error says is allowed."""
    reply = ask(connection, type, payload)
    assert_error(reply, *error)
    assert_serves(connection)
    return wire.ERROR.unpack(reply.payload).allowed


def statistics(connection: Connection) -> dict[str, int]:
    """Reads the daemon's statistics over this connection."""
    return read_statistics(ask(connection, STATISTICS).payload)


def read_statistics(payload: bytes) -> dict[str, int]:
    """Reads the numbers in a statistics reply, by name."""
    count = wire.LIST_REPLY.unpack(payload).count
    offsets = (wire.LIST_REPLY.bytes + i * wire.VALUE.bytes for i in range(count))
    return dict(wire.VALUE.unpack(payload, offset) for offset in offsets)


def assert_closed(connection: Connection) -> None:
    """Checks that the daemon sends nothing more and closes the connection."""
    assert connection.receive_eof(), "the daemon went on instead of closing"


def serves(daemon, scheme: str = "unix") -> bool:
    """Returns whether the daemon accepts a new connection and answers on it."""
    try:
        with daemon.connect(scheme) as fresh:
            return ask(fresh, PING).type == PING | wire.REPLY
    except ConnectionLost:
        return False


def assert_daemon_serves(daemon) -> None:
    """Checks that the daemon answers on a new connection."""
    with daemon.connect() as fresh:
        assert_serves(fresh)


def changed_choices(type: int, payload: bytes, change: Callable[[Any], Any]) -> list[bytes]:
    """Returns a reply to hello with each choice changed, at least one of them, or another reply as it
    is."""
    if type != HELLO | wire.REPLY:
        return [payload]
    data = bytearray(payload)
    for i in range(wire.HELLO_REPLY.unpack(payload).choice_count):
        at = wire.HELLO_REPLY.bytes + i * wire.CHOICE.bytes
        choice = change(wire.CHOICE.unpack(payload, at))
        data[at : at + wire.CHOICE.bytes] = wire.CHOICE.pack(**choice._asdict())
    assert data != payload
    return [bytes(data)]
