"""Makes core/transport/reference.csv, R(r) and the albedo of 64 media with Henyey and Greenstein's
phase function: reference.py FILE. They are those of the model transport with a tolerance of 1e-4,
each with the error that is stated, and of Monte Carlo beside it. core/transport/REFERENCE.md says
more. Lengths are in reduced mean free paths."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "clients" / "python"))

import dipole  # noqa: E402  (needs the path above)

# sigma_a / sigma_s' and g
PAIRS = [
    (0.01, -0.5), (0.3, -0.5), (0.001, 0), (0.1, 0), (0.03, 0.3), (1, 0.3), (0.1, 0.5), (0.01, 0.7),
    (0.3, 0.7), (0.001, 0.8), (0.1, 0.8), (0.001, 0.9), (0.03, 0.9), (1, 0.9), (0.01, 0.95),
    (0.3, 0.95),
]  # fmt: skip
ETAS = (1, 1.33, 1.4, 2)
RADII = (0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 2, 3, 5, 7, 10, 14, 20)
# Rings of a tenth of a decade, in the middle of which the radii of whole tenths lie.
EDGES = dipole.Grid(10**-2.05, 10**1.35, 35, "logarithmic")
TOLERANCE = 1e-4
PHOTONS = 1 << 20
PHOTONS_LEAST = 100  # a ring with fewer photons has no value
RATIO_SLOW = 0.01  # photons take long with little absorption: up to this, a quarter of them

HEAD = (
    "sigma_a_over_sigma_s_prime,g,eta,quantity,r_in_mfp_prime,value,relative_error_bound,"
    "mc_value,mc_relative_standard_error"
)


def ring_means(
    client: dipole.Client, model: str, medium: dipole.Medium, edges: np.ndarray, **how: Any
) -> np.ndarray:
    """The means of R over narrow rings, as Monte Carlo gives them, by Gauss's rule. how: of Client.eval()."""
    x, weight = np.polynomial.legendre.leggauss(8)
    half = np.diff(edges)[:, None] / 2
    r = edges[:-1, None] + half * (1 + x)
    R = client.eval(model, medium, r.ravel(), **how).R[0].reshape(r.shape)
    return 2 * (half * r * R) @ weight / np.diff(edges**2)


def rows(client: dipole.Client, ratio: float, g: float, eta: float, seed: int) -> Iterator[str]:
    medium = dipole.Medium(ratio / (1 + ratio), 1 / ((1 + ratio) * (1 - g)), g, eta)

    def solved(r: list[float], quantity: str) -> tuple[float, float]:
        answer = client.eval("transport", medium, r, wanted=quantity, tolerance=TOLERANCE)
        error = float(np.max(answer.numerical_error(r or [0.0], quantity)))
        return float(getattr(answer, quantity).flat[0]), error

    def row(quantity: str, r: str, by_solver: tuple[float, float], by_walk: str) -> str:
        value, error = by_solver
        return f"{ratio:g},{g:g},{eta:g},{quantity},{r},{value:.9e},{error:.2e},{by_walk}"

    photons = PHOTONS if ratio > RATIO_SLOW else PHOTONS // 4
    walked = client.mc(medium, EDGES, photons=photons, seed=seed)
    total = walked.energies[0].R
    by_walk = f"{total.value:.5e},{total.error / total.value:.1e}"
    yield row("total", "", solved([], "albedo"), by_walk)
    means = ring_means(client, "transport", medium, walked.edges, tolerance=TOLERANCE)
    for r in RADII:
        by_solver = solved([r], "R")
        i = int(np.searchsorted(walked.edges, r, side="right")) - 1
        by_walk = ","
        if walked.ring_photons[0][i] >= PHOTONS_LEAST:
            value = walked.R[0][i] * by_solver[0] / means[i]  # converts the mean over the ring to the value at r
            by_walk = f"{value:.5e},{walked.R_error[0][i] / walked.R[0][i]:.1e}"
        yield row("R", f"{r:g}", by_solver, by_walk)


def main() -> None:
    media = [(*pair, eta) for pair in PAIRS for eta in ETAS]
    with dipole.Client(timeout_s=None) as client:
        made = [row for i, medium in enumerate(media) for row in rows(client, *medium, 17 + i)]
    Path(sys.argv[1]).write_text("\n".join([HEAD, *made, ""]))


if __name__ == "__main__":
    main()
