"""Builds requests byte by byte, valid and invalid ones, and checks replies."""

from __future__ import annotations

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
    """Makes a frame."""
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


def eval_payload(media=(SKIN,), radii=(0.5, 1.0), parameters=(), **fixed: float) -> bytes:
    """Makes the payload of an eval request with a list of radii. Its counts fit unless `fixed` has
    others. radii: None for a grid. parameters: pairs of id and value, or their bytes."""
    parameter_count = len(parameters)
    if isinstance(parameters, bytes):
        parameter_count //= wire.PARAMETER.bytes
    else:
        parameters = parameters_bytes(parameters)
    fields = {
        "model": BETTER,
        "evaluator": F64,
        "moments": EXACT,
        "wanted": R | ALBEDO | CDF,
        "medium_count": len(media),
        "layer_count": 1,
        "spacing": LIST if radii is not None else LINEAR,
        "parameter_count": parameter_count,
        "radius_count": len(radii) if radii is not None else 2,
        "radius_start": 0.0,
        "radius_stop": 0.0 if radii is not None else 1.0,
    }
    fields.update(fixed)
    evaluator = fields["evaluator"] if fields["evaluator"] in wire.EVALUATOR_TYPES else F64
    listed = b"" if radii is None else radii_bytes(radii, evaluator)
    return wire.EVAL_REQUEST.pack(**fields) + media_bytes(media) + parameters + listed


def sample_payload(media=(SKIN,), u=(0.25, 0.5), parameters=(), **fixed: int) -> bytes:
    """Makes the payload of a sample request with a list of numbers. Its counts fit unless `fixed`
    has others. u: None for numbers by a rule. parameters: pairs of id and value."""
    fields = {
        "model": BETTER,
        "evaluator": F64,
        "moments": EXACT,
        "wanted": RADIUS | PDF,
        "medium_count": len(media),
        "layer_count": 1,
        "draw": wire.DRAW_LIST if u is not None else wire.DRAW_RANDOM,
        "parameter_count": len(parameters),
        "sample_count": len(u) if u is not None else 2,
        "sample_first": 0,
        "seed": 0 if u is not None else 1,
    }
    fields.update(fixed)
    evaluator = fields["evaluator"] if fields["evaluator"] in wire.EVALUATOR_TYPES else F64
    listed = b"" if u is None else radii_bytes(u, evaluator)
    head = wire.SAMPLE_REQUEST.pack(**fields)
    return head + media_bytes(media) + parameters_bytes(parameters) + listed


def invert_payload(albedos=(0.5, 0.9), lengths=(1.0, 2.0), **fixed: float) -> bytes:
    """Makes the payload of an invert request. Its count fits unless `fixed` has another."""
    fields = {
        "model": BETTER,
        "moments": EXACT,
        "given": 1,
        "light": 0,
        "medium_count": len(albedos),
        "specular": 0,
        "g": 0.0,
        "eta": 1.3,
    }
    fields.update(fixed)
    numbers = np.asarray([*albedos, *lengths], "<f8").tobytes()
    return wire.INVERT_REQUEST.pack(**fields) + numbers


def varying_payload(media=((0.032, 0.74), (0.1, 1.0)), numbers=(0.5, 1.0), parameters=(),
                    **fixed: float) -> bytes:
    """Makes the payload of a varying request. Its count fits unless `fixed` has another. media:
    pairs of sigma_a and sigma_s, or of colour and length. numbers: radii or, with numbers=2, u;
    None: neither."""
    fields = {
        "model": BETTER,
        "evaluator": F64,
        "moments": EXACT,
        "wanted": R,
        "coefficients": 0,
        "given": 0,
        "light": 0,
        "specular": 0,
        "numbers": wire.VARYING_RADII if numbers is not None else wire.VARYING_NONE,
        "parameter_count": len(parameters),
        "value_count": len(media),
        "g": 0.0,
        "eta": 1.3,
    }
    fields.update(fixed)
    evaluator = fields["evaluator"] if fields["evaluator"] in wire.EVALUATOR_TYPES else F64
    pairs = np.asarray(media, float).reshape(-1, 2)
    arrays = [pairs[:, 0], pairs[:, 1], *([] if numbers is None else [numbers])]
    listed = b"".join(radii_bytes(array, evaluator) for array in arrays)
    return wire.VARYING_REQUEST.pack(**fields) + parameters_bytes(parameters) + listed


def table_payload(medium=SKIN, parameters=(), **fixed: int) -> bytes:
    """Makes the payload of a table request. Its count fits unless `fixed` has another."""
    fields = {"model": BETTER, "moments": EXACT, "parameter_count": len(parameters)}
    fields |= {"layer_count": 1, **fixed}
    return wire.TABLE_REQUEST.pack(**fields) + media_bytes([medium]) + parameters_bytes(parameters)


def mc_payload(medium=(0.1, 0.9, 0.3, 1.3), albedos=(), parameters=(), **fixed: float) -> bytes:
    """Makes the payload of an mc request of two batches of photons and ten rings. Its counts fit
    unless `fixed` has others."""
    fields = {
        "spacing": LINEAR,
        "albedo_count": len(albedos),
        "ring_count": 10,
        "radius_start": 0.0,
        "radius_stop": 5.0,
        "layer_count": 1,
        "seed": 1,
        "photons": 8192,
        "error_total": 0.0,
        "error_rings": 0.0,
        **fixed,
    }
    listed = media_bytes([medium]) + np.asarray(albedos, "<f8").tobytes()
    return wire.MC_REQUEST.pack(**fields) + listed + parameters_bytes(parameters)


def points_payload(points: Points, first: int = 0, count: int | None = None, **fixed) -> bytes:
    """Makes the payload of a part of a set. Its fields fit unless `fixed` has others."""
    count = len(points) - first if count is None else count
    power = points.power[first : first + count].tobytes()
    fields = {
        "set": words(points.name),
        "channel_count": points.channels,
        "point_count": len(points),
        "point_first": first,
        "part_points": count,
        **fixed,
    }
    zeros = bytes(wire.padded(len(power)) - len(power))
    listed = points.xyz[first : first + count].tobytes()
    return wire.POINTS_REQUEST.pack(**fields) + listed + power + zeros


def gather_payload(points: Points, media=(SKIN,), queries=((0.0, 0.0, 1.0),), **fixed) -> bytes:
    """Makes the payload of a gather request. Its fields fit unless `fixed` has others."""
    listed = np.asarray(queries, "<f8")
    fields = {
        "model": BETTER,
        "evaluator": F64,
        "moments": EXACT,
        "parameter_count": 0,
        "medium_count": len(media),
        "layer_count": 1,
        "set": words(points.name),
        "query_count": len(listed),
        "tolerance": 1e-3,
        **fixed,
    }
    return wire.GATHER_REQUEST.pack(**fields) + media_bytes(media) + listed.tobytes()


def words(name: bytes) -> tuple[int, ...]:
    """Returns the name of a set of points as the fields `set` have it."""
    return tuple(np.frombuffer(name, "<u8").tolist())


READINGS = (0.0234, 0.00787, 0.00159)  # of sigma_a 0.03, sigma_s' 1.2 and eta 1.4 at 1, 2, 4 mm


def fit_payload(
    values=(READINGS,), errors=((5e-4, 2e-4, 3e-5),), at=(1.0, 2.0, 4.0), parameters=(),
    reference=None, discs=None, **fixed: float,
) -> bytes:
    """Makes the payload of a fit request: readings of several sets under the better dipole. Counts
    fit unless `fixed` has others."""
    head = {"set_count": len(values), "residuals": 0}
    design = {
        "model": BETTER,
        "moments": EXACT,
        "axis": 1,
        "scale": 1 if reference is None else wire.SCALE_REFERENCE,
        "reading_count": len(at),
        "parameter_count": len(parameters),
        "g": 0.0,
        "eta": 1.4,
        "thickness": 0.0,
    }
    head.update({name: value for name, value in fixed.items() if name in (*head, "zero")})
    design.update({name: value for name, value in fixed.items() if name in design})
    places = np.asarray([at, *(discs or np.zeros((2, len(at))))], "<f8")
    sets = np.asarray([values, np.broadcast_to(errors, np.shape(values))], "<f8")
    return b"".join([
        wire.FIT_REQUEST.pack(**head), wire.FIT_DESIGN.pack(**design),
        parameters_bytes(parameters), media_bytes([] if reference is None else reference),
        places.tobytes(), sets.tobytes(),
    ])  # fmt: skip


def fit_layers_payload(
    media=(SKIN,), at=(3.0,), values=(2.7e-3,), errors=(1e-5,), **fixed: int
) -> bytes:
    """Makes the payload of a fit of layers, of sigma_a_1. Counts fit unless `fixed` has others."""
    fields = {"scale": 1, "unknowns": 1, "layer_count": len(media), "reading_count": len(at)}
    arrays = np.concatenate([at, values, errors]).astype("<f8")
    return wire.FIT_LAYERS_REQUEST.pack(**fields | fixed) + media_bytes(media) + arrays.tobytes()


def tissue_payload(properties=((32, 1.0), (33, 1.0), (3, 0.7)), wavelengths=(650.0, 850.0), **fixed: int) -> bytes:
    """Makes the payload of a tissue request, of water that scatters. Counts fit unless `fixed` has others."""
    fields = {"tissue": 0, "haemoglobin": 1, "property_count": len(properties), "wavelength_count": len(wavelengths)}
    lists = parameters_bytes(properties) + np.asarray(wavelengths, "<f8").tobytes()
    return wire.TISSUE_REQUEST.pack(**fields | fixed) + lists


def fit_tissue_payload(
    sought=((1, 0.0, 0.0), (2, 0.0, 0.0)), properties=((32, 2.0), (33, 1.0)),
    wavelengths=(690.0, 830.0), at=(5.0,), values=((2e-4, 2e-4),), errors=((1e-5, 1e-5),),
    discs=None, mhz=(0.0,), quantity=(0.0,), **fixed: float,
) -> bytes:
    """Makes the payload of a fit of a tissue under the better dipole: haemoglobin by default. Counts fit
    unless `fixed` has others."""
    fields = {
        "set_count": len(values), "model": BETTER, "axis": 1, "scale": 1, "residuals": 0, "tissue": 0,
        "haemoglobin": 1, "property_count": len(properties), "sought_count": len(sought),
        "wavelength_count": len(wavelengths), "place_count": len(at), "detector_na": 0.0,
    }  # fmt: skip
    listed = [wire.SOUGHT.pack(property=id, low=low, high=high) for id, low, high in sought]
    places = np.asarray([at, *(discs or np.zeros((2, len(at)))), *np.broadcast_arrays(mhz, quantity, at)[:2]], "<f8").tobytes()
    arrays = [np.asarray(one, "<f8").tobytes() for one in (wavelengths, values, errors)]
    lists = [parameters_bytes(properties), *listed, places, *arrays]
    return b"".join([wire.FIT_TISSUE_REQUEST.pack(**fields | fixed), *lists])


def ask(connection: Connection, type: int, payload: bytes = b"", request_id: int = 77) -> Frame:
    """Sends one request and waits for one frame."""
    connection.send_bytes(frame(type, request_id, payload))
    return connection.receive_frame()


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
    assert error.allowed and allowed in error.allowed, error
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


def assert_refused(connection: Connection, type: int, payload: bytes, *error) -> None:
    """Checks that the daemon answers the request with this error and goes on serving the
    connection."""
    assert_error(ask(connection, type, payload), *error)
    assert_serves(connection)


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
