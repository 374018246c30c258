"""Client.fit(), fit_layers() and fit_tissue(): find media, layers and what a tissue is made of from
readings of their reflectance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from . import wire
from .arguments import id_of, ids_of, layers_of, media_array, name_of, parameters_of
from .errors import ArgumentError, naming
from .exchange import Joined, pieces, together
from .message import call
from .session import Session
from .values import Array, Estimate, Fits, LayersFit, Media, TissueFits

_REQUEST_BYTES = 16 << 20  # most bytes of a request; larger images need several
OUTSTANDING = 2  # number of requests under way at a time


def _arrays(values: Any, errors: Any) -> tuple[Array, Array]:
    with naming("values, errors"):
        readings = np.asarray(values, "<f8")
        spread = np.broadcast_to(np.asarray(errors, "<f8"), readings.shape)
    if readings.ndim == 0:
        raise ArgumentError("values: an array [..., N] of the readings at N places")
    return readings, spread


def _places(count: int, **given: Any) -> dict[str, bytes]:
    """Returns what is given for each of the places of a set."""
    found = {}
    for name, one in given.items():
        with naming(f"{name}: one number, or an array [{count}]"):
            found[name] = np.broadcast_to(np.asarray(one, "<f8"), (count,)).tobytes()
    return found


async def fit(
    session: Session,
    model: str | int,
    at: Any,
    values: Any,
    errors: Any,
    *,
    axis: str | int = "r",
    scale: str | int = "absolute",
    reference: Media | None = None,
    source: Any = 0.0,
    detector: Any = 0.0,
    g: float | None = None,
    eta: float | None = None,
    thickness: float = 0.0,
    moments: str | int = "exact",
    parameters: Mapping[str, float | str] | None = None,
    residuals: bool = False,
    deadline_ms: int = 0,
) -> Fits:
    """Finds the sigma_a and sigma_s' under a model that make readings most likely.

    at: [N] distances in mm or, with axis="f", spatial frequencies in 1/mm. values: [..., N]
    readings there, such as an image [H, W, N]: R in 1/mm^2, or R(f). errors: their standard
    errors, of a shape that broadcasts. A reading may be negative by noise. One that is not finite,
    or whose error is 0, gives its set the status "refused"; the others are fitted.

    options: scale: "absolute"; "free" if all readings of a set have an unknown factor. In its
    place, reference names the Medium whose readings, by the same instrument, the values were
    divided by. source, detector: diameters of the discs that emit and detect the light, mm, one
    for all readings or [N]; the detector sees light of all angles, unless parameters has
    {"detector_na": NA / the index outside}. residuals: whether they are wanted. eta, which has
    to be given, g=0.0 and thickness=0.0 (mm, of slabs) hold for all sets. Beyond two mean free
    paths readings hardly depend on
    g: a wrong one is "fitted", too. Repeat the call with g -+ 0.05 to see how much sigma_a
    and sigma_s_prime change; for 0.1 it is about twice that. moments, parameters, deadline_ms:
    as of a Query; large images are sent in several requests, and the deadline holds for each.
    """
    info = session.info
    if eta is None:
        raise ArgumentError("eta: give the refractive index inside over outside: it has no default")
    readings, spread = _arrays(values, errors)
    count = readings.shape[-1]
    scale = "reference" if reference is not None else scale
    design = {
        **ids_of(info, model=model, moments=moments, axis=axis, scale=scale),
        "g": float(g or 0.0),
        "eta": float(eta),
        "thickness": float(thickness),
    }
    medium = b""
    if design["scale"] == wire.SCALE_REFERENCE:
        if reference is None:
            raise ArgumentError("reference: the medium whose readings the values were divided by")
        known = media_array(reference)
        if known.size != 5:
            raise ArgumentError("reference: one Medium")
        medium = known.tobytes()
    lists = _places(count, at=at, source=source, detector=detector)
    lists |= {"parameter": parameters_of(info, parameters), "reference": medium}
    fixed = {"residuals": int(residuals)}
    same = {"reading_count": count if residuals else 0}
    found = await _fit_sets(
        session, "fit", [fixed, design], lists, readings, spread, count, same, deadline_ms
    )
    return Fits(
        sets=together(found, "sets").reshape(readings.shape[:-1]),
        residuals=together(found, "residuals").reshape(readings.shape) if residuals else None,
        status_names={choice.id: name for name, choice in info.choices["fit_status"].items()},
        g=float(g or 0.0),
        eta=float(eta),
        g_is_default=g is None,
    )


async def _fit_sets(
    session: Session,
    message: str,
    fixed: list[dict[str, Any]],
    lists: dict[str, bytes],
    readings: Array,
    spread: Array,
    count: int,
    same: Mapping[str, Any],
    deadline_ms: int,
) -> list[Joined]:
    """Sends the sets of `count` readings each in several requests. fixed, lists: what all share."""
    each = max(1, _REQUEST_BYTES // (16 * max(count, 1)))
    sets = {"values": readings.reshape(-1, count), "errors": spread.reshape(-1, count)}

    def pack(first: int, end: int) -> bytes:
        some = {name: one[first:end].tobytes() for name, one in sets.items()}
        start = {"set_count": end - first, **fixed[0]}
        return wire.PAYLOADS[f"{message}_request"].pack(start, *fixed[1:], **lists, **some)

    found: list[Joined] = []
    total = range(0, len(sets["values"]), each)
    await session.each(pieces(message, total, pack, same, deadline_ms), found.append, OUTSTANDING)
    return found


async def fit_layers(
    session: Session,
    layers: Media,
    unknowns: Iterable[str],
    at: Any,
    values: Any,
    errors: Any,
    *,
    scale: str | int = "absolute",
    deadline_ms: int = 0,
) -> LayersFit:
    """Finds coefficients and thicknesses of the two upper layers of a stack under transport.

    layers: one medium, as of eval(); what it says of the unknowns has no meaning. unknowns: names
    of info.choices["unknown"], such as ["sigma_a_1", "sigma_a_2", "thickness_1"]. at, values,
    errors: [N] distances in mm, readings of R there in 1/mm^2, and their standard errors. scale:
    "absolute"; "free" if the readings have an unknown factor. It takes 5 to 30 s of a processor.
    An unknown that the readings do not determine has the value NaN."""
    info = session.info
    stack = layers_of(layers)
    readings, spread = _arrays(values, errors)
    lists = {"at": at, "values": readings.reshape(-1), "errors": spread.reshape(-1)}
    given = {"scale": scale, "unknowns": unknowns, "medium": stack, **lists}
    found = await call(session, "fit_layers", given, deadline_ms=deadline_ms)
    found["estimates"] = {
        name_of(info, "unknown", int(one["unknown"])): Estimate(
            name_of(info, "fit_status", int(one["status"])),
            float(one["value"]),
            float(one["error"]),
        )
        for one in found["estimates"]
    }
    return LayersFit(*(found[name] for name in LayersFit._fields))


async def fit_tissue(
    session: Session,
    sought: Iterable[str] | Mapping[str, tuple[float, float] | None],
    wavelengths_nm: Any,
    at: Any,
    values: Any,
    errors: Any,
    name: str | int | None = None,
    properties: Mapping[str, float] | None = None,
    *,
    model: str | int = "transport",
    axis: str | int = "r",
    scale: str | int = "absolute",
    haemoglobin: str | int = "prahl",
    source: Any = 0.0,
    detector: Any = 0.0,
    mhz: Any = 0.0,
    quantity: str | Iterable[str] = "R",
    detector_na: float = 0.0,
    residuals: bool = False,
    deadline_ms: int = 0,
) -> TissueFits:
    """Finds amounts of chromophores, a_per_mm and b of a tissue from readings at wavelengths.

    sought: names of info.choices["property"], such as ["hbo2_uM", "hb_uM", "a_per_mm", "b"], or a
    mapping to limits (low, high), None for the usual ones. wavelengths_nm: [W]. at: [P] distances
    in mm or, with axis="f", spatial frequencies in 1/mm. values: [..., W, P] readings there, such
    as of images [row, column, W, P]; a reading that is not finite, or whose error is 0, gives its
    set the status "refused". errors: their standard errors, of a shape that broadcasts. name, properties, haemoglobin: as of tissue(): what
    is not sought, with g=0.9 and eta=1.4 unless they are given, and where the search starts. scale,
    source, detector, residuals: as of fit(); readings over those of a known medium, times R of that
    medium, have no unknown scale. mhz: modulation of the light, one number or [P]; quantity: what
    is read, one name or [P]: "R", its amplitude, "phase" in degrees, or "modulation"."""
    info = session.info
    sought = [sought] if isinstance(sought, str) else sought
    limits = sought if isinstance(sought, Mapping) else dict.fromkeys(sought)
    with naming("wavelengths_nm: one number, or an array [W]"):
        wavelengths = np.asarray(wavelengths_nm, "<f8").reshape(-1)
    with naming("at: one number, or an array [P]"):
        places = np.asarray(at, "<f8").reshape(-1)
    readings, spread = _arrays(values, errors)
    if readings.shape[-2:] != (wavelengths.size, places.size):
        raise ArgumentError(
            f"values: an array [..., {wavelengths.size}, {places.size}] for these wavelengths and places"
        )
    with naming("sought: names, or a mapping of names to (low, high) or None"):
        packed = [
            wire.SOUGHT.pack(property=id_of(info, "property", one), low=low, high=high)
            for one, (low, high) in ((one, pair or (0, 0)) for one, pair in limits.items())
        ]
    ids = ids_of(info, model=model, axis=axis, scale=scale, haemoglobin=haemoglobin, tissue=0 if name is None else name)
    fixed = {**ids, "residuals": int(residuals), "detector_na": float(detector_na)}
    read = [quantity] if isinstance(quantity, str) else quantity
    reads = [0 if one == "R" else id_of(info, "quantity", one) for one in read]
    given = {"at": places, "source": source, "detector": detector, "mhz": mhz}
    lists = _places(places.size, **given, quantity=reads[0] if len(reads) == 1 else reads)
    lists |= {"sought": b"".join(packed), "wavelength": wavelengths.tobytes()}
    lists["property"] = parameters_of(info, properties, kind="property")
    count, size = wavelengths.size * places.size, len(packed)
    same = {
        "reading_count": count if residuals else 0,
        "sought_count": size,
        "haemoglobin": ids["haemoglobin"],
    }
    found = await _fit_sets(
        session, "fit_tissue", [fixed], lists, readings, spread, count, same, deadline_ms
    )
    shape = readings.shape[:-2]
    estimates = together(found, "estimates").reshape(*shape, size)
    kinds = estimates["property"].reshape(-1, size)[:1].ravel().tolist()
    return TissueFits(
        together(found, "sets").reshape(shape),
        {name_of(info, "property", kind): estimates[..., k] for k, kind in enumerate(kinds)},
        together(found, "covariance").reshape(*shape, size, size),
        together(found, "residuals").reshape(readings.shape) if residuals else None,
        {choice.id: one for one, choice in info.choices["fit_status"].items()},
        name_of(info, "haemoglobin", ids["haemoglobin"]),
        *found[0].replies[0][-2:],
    )
