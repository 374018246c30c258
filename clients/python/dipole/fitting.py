"""Client.fit(), fit_layers() and fit_tissue(): find media, layers and what a tissue is made of from
readings of their reflectance."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from . import wire
from .arguments import id_of, layers_of, media_array, name_of, parameters_list
from .errors import ArgumentError, naming
from .exchange import InParts, Joined, Once, Request
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


def _place(name: str, given: Any, readings: int) -> Array:
    with naming(f"{name}: one number, or an array [{readings}]"):
        return np.ascontiguousarray(np.broadcast_to(np.asarray(given, "<f8"), (readings,)))


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
    scale_id = id_of(info, "scale", "reference" if reference is not None else scale)
    listed = parameters_list(info, parameters)
    design = {
        "model": id_of(info, "model", model),
        "moments": id_of(info, "moments", moments),
        "axis": id_of(info, "axis", axis),
        "scale": scale_id,
        "reading_count": count,
        "parameter_count": len(listed),
        "g": float(g or 0.0),
        "eta": float(eta),
        "thickness": float(thickness),
    }
    medium = b""
    if scale_id == wire.SCALE_REFERENCE:
        if reference is None:
            raise ArgumentError("reference: the medium whose readings the values were divided by")
        known = media_array(reference)
        if known.size != 5:
            raise ArgumentError("reference: one Medium")
        medium = known.tobytes()
    given = {"at": at, "source": source, "detector": detector}
    head = {name: _place(name, one, count).tobytes() for name, one in given.items()}
    head |= {"parameter": b"".join(listed), "reference": medium}
    lists = (readings.reshape(-1, count), spread.reshape(-1, count))
    pieces: list[Joined] = []
    requests = _requests(design, head, *lists, residuals, deadline_ms)
    await session.each(requests, pieces.append, OUTSTANDING)
    sets, remainders = (
        np.concatenate([piece.arrays[name] for piece in pieces]) for name in ("sets", "residuals")
    )
    sets.setflags(write=False)
    shape = readings.shape[:-1]
    names = {choice.id: name for name, choice in info.choices["fit_status"].items()}
    return Fits(
        sets=sets.reshape(shape),
        residuals=remainders.reshape(readings.shape) if residuals else None,
        status_names=names,
        g=float(g or 0.0),
        eta=float(eta),
        g_is_default=g is None,
    )


def _requests(
    design: dict[str, Any],
    head: dict[str, bytes],
    values: Array,
    errors: Array,
    wants_residuals: bool,
    deadline_ms: int,
) -> Iterator[Request[Joined]]:
    """Yields the requests for all sets, one after the other. design, head: what they
    share. values, errors: [sets, readings]."""
    total, readings = values.shape

    def fits(reply: Any) -> bool:
        listed = readings if wants_residuals else 0
        return bool(reply.reading_count == listed and 0 < reply.count >= reply.fitted_count)

    each = max(1, _REQUEST_BYTES // (16 * max(readings, 1)))
    for first in range(0, max(total, 1), each):
        end = min(first + each, total)
        fixed = {"set_count": end - first, "residuals": int(wants_residuals)}
        arrays = {"values": values[first:end].tobytes(), "errors": errors[first:end].tobytes()}

        def replies(count: int = end - first) -> InParts[Joined]:
            return InParts("fit_reply", count, fits, lambda whole: whole)

        payload = wire.PAYLOADS["fit_request"].pack(fixed, design, **head, **arrays)
        yield Request("fit", payload, replies, deadline_ms)


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
    places = _place("at", at, readings.size)
    fixed = {
        "scale": id_of(info, "scale", scale),
        "unknowns": sum({id_of(info, "unknown", name) for name in unknowns}),
        "layer_count": len(stack),
        "reading_count": readings.size,
    }
    arrays = {"at": places, "values": readings, "errors": spread}
    lists = {name: one.tobytes() for name, one in arrays.items()}
    payload = wire.PAYLOADS["fit_layers_request"].pack(fixed, medium=stack.tobytes(), **lists)

    def read(reply: bytes) -> LayersFit:
        found, parts = wire.PAYLOADS["fit_layers_reply"].unpack(reply)
        estimates = {
            name_of(info, "unknown", int(one["unknown"])): Estimate(
                name_of(info, "fit_status", int(one["status"])),
                float(one["value"]),
                float(one["error"]),
            )
            for one in parts["estimates"]
        }
        return LayersFit(
            name_of(info, "fit_status", found.status),
            estimates,
            *(found.factor, found.factor_error, found.chi_squared, found.reduced_chi_squared),
            found.numerical_error,
            parts["residuals"],
        )

    return await session.call(Request("fit_layers", payload, lambda: Once(read), deadline_ms))


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
    detector_na: float = 0.0,
    residuals: bool = False,
    deadline_ms: int = 0,
) -> TissueFits:
    """Finds amounts of chromophores, a_per_mm and b of a tissue from readings at wavelengths.

    sought: names of info.choices["property"], such as ["hbo2_uM", "hb_uM", "a_per_mm", "b"], or a
    mapping to limits (low, high), None for the usual ones. wavelengths_nm: [W]. at: [P] distances
    in mm or, with axis="f", spatial frequencies in 1/mm. values: [..., W, P] readings there; a
    reading that is not finite, or whose error is 0, gives its set the status "refused". errors: their
    standard errors, of a shape that broadcasts. name, properties, haemoglobin: as of tissue(): what
    is not sought, with g=0.9 and eta=1.4 unless they are given, and where the search starts. scale,
    source, detector, residuals: as of fit(); readings over those of a known medium, times R of that
    medium, have no unknown scale."""
    info = session.info
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
    listed = parameters_list(info, properties, kind="property")
    with naming("sought: names, or a mapping of names to (low, high) or None"):
        packed = [
            wire.SOUGHT.pack(property=id_of(info, "property", one), low=low, high=high)
            for one, (low, high) in ((one, pair or (0, 0)) for one, pair in limits.items())
        ]
    head = {
        "model": id_of(info, "model", model),
        "axis": id_of(info, "axis", axis),
        "scale": id_of(info, "scale", scale),
        "residuals": int(residuals),
        "tissue": 0 if name is None else id_of(info, "tissue", name),
        "haemoglobin": id_of(info, "haemoglobin", haemoglobin),
        "property_count": len(listed),
        "sought_count": len(packed),
        "wavelength_count": wavelengths.size,
        "place_count": places.size,
        "detector_na": float(detector_na),
    }
    given = {"at": places, "source": source, "detector": detector}
    lists = {one: _place(one, array, places.size).tobytes() for one, array in given.items()}
    lists |= {"property": b"".join(listed), "sought": b"".join(packed)}
    lists["wavelength"] = wavelengths.tobytes()
    count, size = wavelengths.size * places.size, len(packed)
    sets = (readings.reshape(-1, count), spread.reshape(-1, count))
    pieces: list[Joined] = []
    expected = (count if residuals else 0, size, head["haemoglobin"])

    def fits(reply: Any) -> bool:
        found = (reply.reading_count, reply.sought_count, reply.haemoglobin)
        return bool(found == expected and 0 < reply.count >= reply.fitted_count)

    def requests() -> Iterator[Request[Joined]]:
        each = max(1, _REQUEST_BYTES // (16 * max(count, 1)))
        for first in range(0, max(len(sets[0]), 1), each):
            some = [one[first : first + each] for one in sets]
            fixed = head | {"set_count": len(some[0])}
            arrays = {"values": some[0].tobytes(), "errors": some[1].tobytes()}

            def replies(total: int = len(some[0])) -> InParts[Joined]:
                return InParts("fit_tissue_reply", total, fits, lambda whole: whole)

            payload = wire.PAYLOADS["fit_tissue_request"].pack(fixed, **lists, **arrays)
            yield Request("fit_tissue", payload, replies, deadline_ms)

    await session.each(requests(), pieces.append, OUTSTANDING)
    shape = readings.shape[:-2]
    found = {
        one: np.concatenate([piece.arrays[one].reshape(-1) for piece in pieces])
        for one in ("sets", "estimates", "covariance", "residuals")
    }
    estimates = found["estimates"].reshape(*shape, size)
    return TissueFits(
        found["sets"].reshape(shape),
        {
            name_of(info, "property", int(found["estimates"]["property"][k])): estimates[..., k]
            for k in range(size if estimates.size else 0)
        },
        found["covariance"].reshape(*shape, size, size),
        found["residuals"].reshape(readings.shape) if residuals else None,
        {choice.id: one for one, choice in info.choices["fit_status"].items()},
        name_of(info, "haemoglobin", int(head["haemoglobin"])),
        *pieces[0].replies[0][-2:],
    )
