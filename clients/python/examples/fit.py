"""Fits sigma_a and sigma_s of a medium to six readings of R(r), by least squares:

    python3 fit.py

The program uses the dipoled that $DIPOLED names, or a private one. Lengths are in mm.

The slopes are quantities of their own: d ln R / d ln sigma_a and d ln R / d ln sigma_s come with ln R
in one request. A loop that takes differences of values instead needs a step. In single precision
(evaluators "f32" and "lut") a value changes in steps of 6e-8 of itself: a routine such as
scipy.optimize.least_squares, whose own step is 1.5e-8, would see no slope there, stop at its first
guess and report success. Give it these slopes by its argument jac, or take double precision.
"""

import dipole
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

G, ETA = 0.9, 1.4  # known beforehand
WANTED = ("ln_R", "dlnR_dln_sigma_a", "dlnR_dln_sigma_s")
NOISE = 0.02  # relative standard error of a reading

r = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
readings = np.array([0.0427, 0.0210, 0.0117, 0.00672, 0.00276, 0.00119])  # 1/mm^2


def misfit_of(client: dipole.Client, x: Array) -> tuple[Array, Array]:
    """Returns the misfit [radius] at ln sigma_a, ln sigma_s and its slopes [radius, coefficient]."""
    sigma_a, sigma_s = np.exp(x)
    medium = dipole.Medium(sigma_a, sigma_s, G, ETA)
    found = client.eval("transport", medium, r, wanted=WANTED)
    slopes = np.stack([found.dlnR_dln_sigma_a[0], found.dlnR_dln_sigma_s[0]], axis=1)
    return (found.ln_R[0] - np.log(readings)) / NOISE, slopes / NOISE


with dipole.Client() as client:
    x: Array = np.log(np.array([0.1, 10.0]))  # the first guess
    damping = 1e-2
    misfit, slopes = misfit_of(client, x)
    for _ in range(50):  # Levenberg 1944, Marquardt 1963
        square = slopes.T @ slopes
        step = np.linalg.solve(square + damping * np.diag(np.diag(square)), -slopes.T @ misfit)
        tried, slopes_there = misfit_of(client, x + step)
        if tried @ tried < misfit @ misfit:
            x, misfit, slopes, damping = x + step, tried, slopes_there, damping / 10
        else:
            damping *= 10
        if np.abs(step).max() < 1e-6:
            break

# standard errors of the logarithms, that is relative ones
errors = np.sqrt(np.diag(np.linalg.inv(square)))
for name, value, error in zip(("sigma_a", "sigma_s"), np.exp(x), errors):
    print(f"{name} {value:.4f} 1/mm, +- {error:.1%}")
print(f"chi squared {misfit @ misfit:.1f} for {len(r)} readings and {len(x)} coefficients")
