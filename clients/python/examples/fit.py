"""Fits sigma_a and sigma_s of a medium to six readings of R(r), by least squares:

    python3 fit.py

The program asks the dipoled that $DIPOLED names, or a private one. Lengths are in mm.

A fit needs values in double precision (evaluator "f64", the default if a model is named). In single
precision a value changes in steps of 6e-8 of itself, and those of a table in steps of its tolerance.
The step of the differences has to be far above that: STEP suits double precision. A routine such as
scipy.optimize.least_squares, whose own step is 1.5e-8, would see no slope in single precision, stop
at its first guess and report success; diff_step=1e-3 gives it the step that is taken here.
"""

import dipole
import numpy as np

G, ETA = 0.9, 1.4  # known beforehand
STEP = 1e-3  # of the logarithms of sigma_a and sigma_s
NOISE = 0.02  # relative standard error of a reading

r = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
readings = np.array([0.0427, 0.0210, 0.0117, 0.00672, 0.00276, 0.00119])  # 1/mm^2


def ln_R(client: dipole.Client, logarithms: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """Returns ln R [medium, radius] for rows of ln sigma_a, ln sigma_s, in a single request."""
    sigma = np.exp(np.atleast_2d(logarithms))
    known = np.broadcast_to([G, ETA], sigma.shape)
    media = np.hstack([sigma, known])
    # With this tolerance the daemon looks transport up; else it would solve it anew for each medium.
    return client.eval("transport", media, r, wanted="ln_R", tolerance=1e-3).ln_R


with dipole.Client() as client:
    x = np.log([0.1, 10.0])  # the first guess
    damping = 1e-2
    misfit = (ln_R(client, x)[0] - np.log(readings)) / NOISE
    for _ in range(50):  # Levenberg 1944, Marquardt 1963
        ends = ln_R(client, x + STEP * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
        slopes = (ends[0::2] - ends[1::2]).T / (2 * STEP * NOISE)  # [radius, coefficient]
        square = slopes.T @ slopes
        step = np.linalg.solve(square + damping * np.diag(np.diag(square)), -slopes.T @ misfit)
        tried = (ln_R(client, x + step)[0] - np.log(readings)) / NOISE
        if tried @ tried < misfit @ misfit:
            x, misfit, damping = x + step, tried, damping / 10
        else:
            damping *= 10
        if np.abs(step).max() < 1e-6:
            break

errors = np.sqrt(np.diag(np.linalg.inv(square)))  # of the logarithms: they are relative
for name, value, error in zip(("sigma_a", "sigma_s"), np.exp(x), errors):
    print(f"{name} {value:.4f} 1/mm, +- {error:.1%}")
print(f"chi squared {misfit @ misfit:.1f} for {len(r)} readings and {len(x)} coefficients")
