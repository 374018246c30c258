"""Many different eval requests, the same in every run, for tests that compare answers."""

from __future__ import annotations

import random

import numpy as np
from frames import F32, F64, LINEAR, LOGARITHMIC, eval_payload
from lists import (
    DERIVATIVES, DIPOLES, MODELS, MOMENTS, PARAMETERS, QUANTITIES, Moments, everywhere,
    has_derivatives, needs, takes_media,
)

ALL_QUANTITIES = sum(QUANTITIES.values()) - QUANTITIES["model_errors"]  # which solves media
# Only the cheapest models are evaluated at this many radii: such requests do not test the models.
MANY_RADII = 2000
# Preparing one medium of this model takes a third of a second, so its requests have one medium
# each.
SLOW = "transport"
EDGE_RADII = [0.0, -0.0, 5e-324, 1e-300, 1e-45, 1e30, 1e300, np.inf]


def random_medium(rng: random.Random, moments: Moments) -> tuple[float, float, float, float]:
    """Returns a medium of the domain, mostly from its middle."""
    wide = rng.random() < 0.25
    decades = 14 if wide else 2
    sigma_a = 0.0 if rng.random() < 0.1 else 10 ** rng.uniform(-decades, decades)
    sigma_s = 0.0 if sigma_a > 0 and rng.random() < 0.05 else 10 ** rng.uniform(-decades, decades)
    g = 0.0 if rng.random() < 0.3 else rng.uniform(-0.99, 0.99)
    eta_range = (moments.eta_min, moments.eta_max) if wide else (0.7, 2.0)
    return sigma_a, sigma_s, g, rng.uniform(*eta_range)


def random_radii(rng: random.Random, count: int) -> np.ndarray:
    """Returns radii over ten decades, with the ends of the domain among them."""
    radii = 10 ** np.random.default_rng(rng.getrandbits(32)).uniform(-6, 4, count)
    for i in range(0, count, 7):
        radii[i] = rng.choice(EDGE_RADII)
    return radii


def random_parameters(rng: random.Random, model: str) -> dict[str, float]:
    """Returns the parameters that the model needs and, now and then, angles."""
    given = dict(needs(model))
    if rng.random() < 0.3:
        given |= {"cos_in": rng.random(), "cos_out": rng.random()}
    return given


def tame_payload(
    rng: random.Random, parameters, count: int, medium_count: int, **fields
) -> bytes:
    """Makes a request that any model can answer."""
    media = [
        (rng.uniform(0.01, 0.2), rng.uniform(0.8, 1.2), 0.0, rng.uniform(1.2, 1.5))
        for _ in range(medium_count)
    ]
    radii = np.random.default_rng(rng.getrandbits(32)).uniform(0.5, 4.0, count)
    return eval_payload(media, radii, parameters, **fields)


def random_payload(rng: random.Random, count: int) -> bytes:
    """Makes the payload of a valid eval request with this number of radii. If the model does not
    take the random medium or radii, the request has ordinary ones."""
    moments = rng.choice(list(MOMENTS.values()))
    model = rng.choice(list(MODELS if count < MANY_RADII else DIPOLES))
    fields = {
        "model": MODELS[model],
        "evaluator": rng.choice([F64, F32]),
        "moments": moments.id,
        "wanted": rng.randint(1, ALL_QUANTITIES),
    }
    if not has_derivatives(model) or model == SLOW:  # those of solutions take long
        fields["wanted"] = fields["wanted"] & ~DERIVATIVES or QUANTITIES["R"]
    given = random_parameters(rng, model)
    parameters = [(PARAMETERS[name].id, value) for name, value in given.items()]
    media = [random_medium(rng, moments) for _ in range(1 if model == SLOW else rng.randint(1, 4))]
    if model not in everywhere() or not takes_media(model, media, moments.id, given):
        return tame_payload(rng, parameters, count, len(media), **fields)
    if count == 0 or rng.random() < 0.6:
        with np.errstate(over="ignore"):
            radii = random_radii(rng, count)
            if fields["evaluator"] == F32:
                radii = radii.astype(np.float32)
        return eval_payload(media, radii, parameters, **fields)
    return eval_payload(
        media,
        None,
        parameters,
        spacing=rng.choice([LINEAR, LOGARITHMIC]),
        radius_count=count,
        radius_start=rng.uniform(1e-3, 1.0),
        radius_stop=rng.uniform(1.0, 50.0),
        **fields,
    )


def broad_mix(seed: int, sizes: dict[int, int] | None = None) -> list[bytes]:
    """Makes payloads: short lists of every length, and as many of each longer size as `sizes`
    says."""
    rng = random.Random(seed)
    payloads = [random_payload(rng, length) for length in range(68) for _ in range(3)]
    for size, times in (sizes or {}).items():
        payloads += [random_payload(rng, size) for _ in range(times)]
    return payloads
