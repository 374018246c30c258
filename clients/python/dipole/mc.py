"""Monte Carlo jobs: requests, reports of progress, and tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from . import wire
from .arguments import id_of, layers_of, parameters_of
from .session import Session
from .errors import ArgumentError, DipoleError, ProtocolError
from .exchange import Replies, Request
from .values import Grid, McEnergy, McProgress, McResult, McValue, Media, whole


class _McReplies(Replies[McProgress | McResult]):
    """The reply to an mc request: reports of progress, and at last the result."""

    is_streamed = True

    def can_begin_again(self) -> bool:
        """A job that is requested again begins anew, and ends with the same bits."""
        return True

    def _add(self, payload: bytes) -> None:
        fixed = unpack_fixed(payload)
        self.ended = fixed.state != wire.MC_UNDER_WAY
        self.cut_off = wire.MC_STATES.get(fixed.state) == "stopped"
        self.ready.append(unpack_result(payload) if self.ended else progress_of(fixed))


async def mc(
    session: Session,
    medium: Media,
    edges: Grid,
    *,
    progress: Callable[[McProgress], bool | None] | None = None,
    photons: float | None = None,
    error_total: float = 0.0,
    error_rings: float = 0.0,
    albedos: Iterable[float] = (),
    seed: int = 1,
    parameters: Mapping[str, float | str] | None = None,
) -> McResult:
    """Runs a Monte Carlo job on the daemon and waits for its result.

    medium: one Medium, or one Stack of layers. edges: the edges of the rings; n edges make n - 1 rings. progress: is called a few times a
    second. If it returns False, the job is cancelled, and the result holds the photons walked
    so far. If it raises an exception, such as KeyboardInterrupt, the job is cancelled too.
    options: photons: how many to walk. The default is a million, or the daemon's limit if an
    error is given. error_total, error_rings: the job ends as soon as the relative standard
    error of the total R, or of every ring with light, is at most this; if both are given, both
    must hold. albedos: up to 16, in place of
    the medium's own; one walk gives the results for all of them. seed: 1 by default.
    parameters: a phase function in place of Henyey and Greenstein's, by name, for example
    {"phase": "two-term", "phase_share": 0.95, "phase_g": -0.3}; info.choices["phase"]
    describes them. The medium's g is their mean cosine.
    """
    info = session.info
    medium = await session.media_of(medium)
    if photons is None:
        wishes = error_total or error_rings
        photons = info.limits["max_mc_photons"] if wishes else 1_000_000
    if not isinstance(edges, Grid):
        raise ArgumentError("edges: a Grid, such as Grid(0, 10, 21) for 20 rings up to 10 mm")
    spacing = id_of(info, "spacing", edges.spacing)
    numbers = (photons, error_total, error_rings, albedos, seed)
    payload = pack_request(medium, edges, spacing, *numbers)
    payload += parameters_of(info, parameters)
    job = await session.send(Request("mc", payload, _McReplies))
    cancelled = reporting = False
    try:
        while not isinstance(report := await session.next(job), McResult):
            reporting = True
            stop = progress is not None and progress(report) is False and not cancelled
            reporting = False
            if stop:
                cancelled = True
                await session.cancel([job])
        return report
    except GeneratorExit:
        raise
    except BaseException as error:
        if isinstance(error, DipoleError) and not reporting:  # the daemon's own
            raise
        await session.cancel([job])
        while isinstance(error, (Exception, KeyboardInterrupt)):  # A cancelled task does not wait.
            if isinstance(await session.next(job), McResult):
                break
        raise
    finally:
        session.exchange.drop(job)


def pack_request(
    medium: Media,
    edges: Grid,
    spacing: int,
    photons: float,
    error_total: float,
    error_rings: float,
    albedos: Iterable[float],
    seed: int,
) -> bytes:
    """Packs an mc request. The daemon checks the numbers."""
    layers, listed = layers_of(medium), np.asarray(list(albedos), "<f8")
    fixed = {
        "spacing": spacing,
        "ring_count": whole(edges.count) - 1,
        "radius_start": edges.start_mm,
        "radius_stop": edges.stop_mm,
        "seed": whole(seed),
        "photons": whole(photons),
        "error_total": error_total,
        "error_rings": error_rings,
    }
    return wire.PAYLOADS["mc_request"].pack(fixed, medium=layers.tobytes(), albedo=listed.tobytes())


def unpack_fixed(payload: bytes) -> Any:
    """Unpacks the structure at the start of every mc reply."""
    if len(payload) < wire.MC_REPLY.bytes:
        raise ProtocolError("an mc reply that is too short")
    return wire.MC_REPLY.unpack(payload)


def progress_of(fixed: Any) -> McProgress:
    """Makes a report of a reply to a job that continues."""
    return McProgress(
        number=fixed.number,
        photons=fixed.photons,
        photons_expected=fixed.photons_expected,
        error_total=fixed.error_total,
        error_rings=fixed.error_rings,
        worst_ring_mm=(fixed.worst_from, fixed.worst_to),
    )


def _sides(values: Sequence[float], errors: Sequence[float]) -> tuple[McValue, McValue]:
    return McValue(values[0], errors[0]), McValue(values[1], errors[1])


def _energy(one: Any) -> McEnergy:
    return McEnergy(
        albedo=one.albedo,
        R=McValue(one.reflected, one.reflected_error),
        T=McValue(one.transmitted, one.transmitted_error),
        absorbed=McValue(one.absorbed, one.absorbed_error),
        unfinished=McValue(one.unfinished, one.unfinished_error),
        roulette=McValue(one.roulette, one.roulette_error),
        unscattered=one.unscattered,
        under=_sides(one.under, one.under_error),
        over=_sides(one.over, one.over_error),
        in_layer=tuple(map(McValue, one.in_layer, one.in_layer_error)),
        imbalance=one.imbalance,
    )


def unpack_result(payload: bytes) -> McResult:
    """Makes the result of the last reply of a job."""
    fixed, parts = wire.PAYLOADS["mc_reply"].unpack(payload)
    albedos, sides, rings = fixed.albedo_count, fixed.side_count, fixed.ring_count
    if fixed.state not in wire.MC_STATES:
        raise ProtocolError(f"an mc reply in state {fixed.state}, which is not known here")
    values = parts["rings"].reshape(albedos, sides, 2, rings)
    return McResult(
        state=wire.MC_STATES[fixed.state],
        photons=fixed.photons,
        error_total=fixed.error_total,
        error_rings=fixed.error_rings,
        worst_ring_mm=(fixed.worst_from, fixed.worst_to),
        edges=parts["edges"],
        energies=tuple(_energy(one) for one in parts["energy"]),
        ring_photons=parts["photons"].reshape(sides, rings),
        values=values[:, :, 0],
        errors=values[:, :, 1],
        payload=bytes(payload),
    )
