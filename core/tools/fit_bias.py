"""Draws the bias of coefficients that are fitted with diffusion models: the reason to fit with
transport.

The readings are R of transport without noise, at ten distances from 0.5 to 8 mean free paths
1 / sigma_t', with errors of 2 %. Each model is fitted to them with an absolute scale. Written into
the folder: fit_bias.csv (ratio, model, status, both coefficients over the true ones, reduced
chi-squared) and fit_bias.svg."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "clients" / "python"))

import dipole  # noqa: E402  (needs the path above)
from pictures import plt, save  # noqa: E402

RATIOS = np.geomspace(1e-3, 1, 13)
MODELS = ("transport", "better", "classical", "burley")
AT_MFP = np.geomspace(0.5, 8, 10)
ETA = 1.4


def rows(client: dipole.Client) -> list[tuple[float, str, str, float, float, float]]:
    """Fits each model to the readings of each ratio sigma_a / sigma_s'; sigma_s' is 1 per mm."""
    found = []
    for ratio in RATIOS:
        at = AT_MFP / (1 + ratio)
        medium = dipole.Medium(ratio, 1.0, 0.0, ETA)
        readings = client.eval("transport", [medium], at).R[0]
        for model in MODELS:
            fits = client.fit(model, at, readings, 0.02 * readings, eta=ETA)
            a, s = float(fits.sigma_a) / ratio, float(fits.sigma_s_prime)
            chi = float(fits.sets["reduced_chi_squared"])
            found.append((ratio, model, str(fits.status), a, s, chi))
    return found


def draw(path: Path, found: list[tuple[float, str, str, float, float, float]]) -> None:
    """Draws two panels: the fitted sigma_a and sigma_s' over the true ones."""
    figure, panels = plt.subplots(2, sharex=True, figsize=(9, 7), layout="constrained")
    figure.suptitle("Fitted over true, from readings of transport")
    for axes, column, name in zip(panels, (3, 4), ("sigma_a", "sigma_s (1 - g)")):
        for model in MODELS:
            curve = [row[column] for row in found if row[1] == model]
            axes.loglog(RATIOS, curve, "o-", label=model)
        axes.set(ylabel=name, xlabel="sigma_a / sigma_s (1 - g)")
    panels[0].legend()
    save(figure, path)


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    with dipole.Client(timeout_s=None) as client:
        found = rows(client)
    with open(folder / "fit_bias.csv", "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow("ratio model status sigma_a sigma_s_prime reduced_chi_squared".split())
        for row in found:
            writer.writerow([f"{row[0]:.6g}", *row[1:3], *(f"{x:.6g}" for x in row[3:])])
    draw(folder / "fit_bias.svg", found)


if __name__ == "__main__":
    main()
