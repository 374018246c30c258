"""Monte Carlo: what a job is asked, what it tells while it runs, and its table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from . import packing, wire
from .errors import ProtocolError
from .values import Grid, Info, Medium

REFLECTED, TRANSMITTED = 0, 1  # sides: where light enters, and the other one of a slab


class McProgress(NamedTuple):
    """How far a job is."""

    number: int  # of this report: 1, 2, 3, ...
    photons: int  # walked
    photons_expected: int  # what it will take in all, as far as is known
    error_total: float  # relative standard error of R, the largest of all albedos
    error_rings: float  # that of the worst ring with light; inf: not known yet
    worst_ring_mm: tuple[float, float]  # its edges; (0, 0): there is none


class McValue(NamedTuple):
    """A share of the power that entered, and its standard error."""

    value: float
    error: float


class McEnergy(NamedTuple):
    """Where the power went, for one albedo; shares of the power that entered. Pairs are by side."""

    albedo: float
    R: McValue  # leaves where light enters: unscattered, under, rings and over
    T: McValue  # leaves on the other side of a slab, likewise
    absorbed: McValue
    unfinished: McValue  # was still inside when its walk was given up
    roulette: McValue  # what roulette has added less what it has taken
    unscattered: tuple[float, float]  # at r = 0, in no ring; exact
    under: tuple[McValue, McValue]  # within the inner edge of the first ring
    over: tuple[McValue, McValue]  # beyond the outer edge of the last ring
    imbalance: float  # R + T + absorbed + unfinished - roulette - 1: 0 but for rounding


@dataclass(frozen=True)
class McResult:
    """The table of a job, for K albedos, N rings and S sides (1 for a half space, 2 for a slab).

    Values are means over their ring, in 1/mm^2 per unit of power that entered.
    """

    state: str  # why it ended: "photons", "errors", "cancelled" or "stopped"
    photons: int  # walked
    error_total: float  # as in McProgress
    error_rings: float
    worst_ring_mm: tuple[float, float]
    edges: np.ndarray  # [N + 1] mm
    energies: tuple[McEnergy, ...]  # [K]
    ring_photons: np.ndarray  # [S, N] that left there, whatever their weight
    values: np.ndarray  # [K, S, N]
    errors: np.ndarray  # [K, S, N] standard errors
    payload: bytes  # as received: the same request gives the same bytes unless ended early

    @property
    def R(self) -> np.ndarray:
        """What leaves where light enters, [K, N] 1/mm^2."""
        return self.values[:, REFLECTED]

    @property
    def R_error(self) -> np.ndarray:
        """Standard errors of R, [K, N] 1/mm^2."""
        return self.errors[:, REFLECTED]


def request(
    info: Info,
    medium: Medium | Sequence[float],
    edges: Grid,
    photons: int | None = None,
    error_total: float = 0.0,
    error_rings: float = 0.0,
    thickness: float | None = None,
    albedos: Iterable[float] = (),
    seed: int = 1,
) -> bytes:
    """The payload of a request, see Client.mc()."""
    if photons is None:
        wishes = error_total or error_rings
        photons = info.limits["max_mc_photons"] if wishes else 1_000_000
    spacing = packing.id_of(info, "spacing", edges.spacing)
    return pack_request(
        medium, edges, spacing, photons, error_total, error_rings, thickness, albedos, seed
    )


def pack_request(
    medium: Medium | Sequence[float],
    edges: Grid,
    spacing: int,
    photons: int,
    error_total: float,
    error_rings: float,
    thickness: float | None,
    albedos: Iterable[float],
    seed: int,
) -> bytes:
    """The same of numbers alone, which are the daemon's to judge."""
    listed = np.asarray(list(albedos), "<f8")
    fixed = wire.MC_REQUEST.pack(
        spacing=spacing,
        albedo_count=len(listed),
        ring_count=edges.count - 1,
        radius_start=edges.start_mm,
        radius_stop=edges.stop_mm,
        thickness=math.inf if thickness is None else thickness,
        seed=seed,
        photons=photons,
        error_total=error_total,
        error_rings=error_rings,
    )
    return fixed + wire.MEDIUM.pack(**Medium(*medium)._asdict()) + listed.tobytes()


def unpack_fixed(payload: bytes) -> Any:
    """The part that all replies start with."""
    if len(payload) < wire.MC_REPLY.bytes:
        raise ProtocolError("an mc reply that is too short")
    return wire.MC_REPLY.unpack(payload)


def is_last(payload: bytes) -> bool:
    """Whether a reply is the last one of its job."""
    return unpack_fixed(payload).state != wire.MC_UNDER_WAY


def progress_of(fixed: Any) -> McProgress:
    """What a reply that is not the last one says."""
    return McProgress(
        number=fixed.number,
        photons=fixed.photons,
        photons_expected=fixed.photons_expected,
        error_total=fixed.error_total,
        error_rings=fixed.error_rings,
        worst_ring_mm=(fixed.worst_from, fixed.worst_to),
    )


def _energy(payload: bytes, offset: int) -> McEnergy:
    one = wire.MC_ENERGY.unpack(payload, offset)
    return McEnergy(
        albedo=one.albedo,
        R=McValue(one.reflected, one.reflected_error),
        T=McValue(one.transmitted, one.transmitted_error),
        absorbed=McValue(one.absorbed, one.absorbed_error),
        unfinished=McValue(one.unfinished, one.unfinished_error),
        roulette=McValue(one.roulette, one.roulette_error),
        unscattered=one.unscattered,
        under=tuple(map(McValue, one.under, one.under_error)),
        over=tuple(map(McValue, one.over, one.over_error)),
        imbalance=one.imbalance,
    )


def unpack_result(payload: bytes) -> McResult:
    """The table that the last reply of a job carries."""
    fixed = unpack_fixed(payload)
    albedos, sides, rings = fixed.albedo_count, fixed.side_count, fixed.ring_count
    energies_at = wire.MC_REPLY.bytes + 8 * (rings + 1)
    photons_at = energies_at + albedos * wire.MC_ENERGY.bytes
    values_at = photons_at + 8 * sides * rings
    if len(payload) != values_at + 8 * albedos * sides * 2 * rings:
        raise ProtocolError("an mc reply whose size does not fit its counts")
    if fixed.state not in wire.MC_STATES:
        raise ProtocolError(f"an mc reply in state {fixed.state}, which is not known here")
    photons = np.frombuffer(payload, "<u8", sides * rings, photons_at)
    values = np.frombuffer(payload, "<f8", -1, values_at).reshape(albedos, sides, 2, rings)
    return McResult(
        state=wire.MC_STATES[fixed.state],
        photons=fixed.photons,
        error_total=fixed.error_total,
        error_rings=fixed.error_rings,
        worst_ring_mm=(fixed.worst_from, fixed.worst_to),
        edges=np.frombuffer(payload, "<f8", rings + 1, wire.MC_REPLY.bytes),
        energies=tuple(
            _energy(payload, energies_at + i * wire.MC_ENERGY.bytes) for i in range(albedos)
        ),
        ring_photons=photons.reshape(sides, rings),
        values=values[:, :, 0],
        errors=values[:, :, 1],
        payload=bytes(payload),
    )
