"""How the programs here draw: pictures in SVG that are the same in every run, and whose texts are texts."""

from __future__ import annotations

from pathlib import Path

import matplotlib  # type: ignore[import]

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # type: ignore[import]  # noqa: E402  (after the choice above)

plt.rcParams.update(
    {
        "svg.fonttype": "none",
        "svg.hashsalt": "dipoled",
        "axes.grid": True,
        "grid.color": "#dddddd",
        "font.size": 9,
        "lines.linewidth": 1.5,
        "legend.frameon": False,
    }
)


def save(figure: plt.Figure, path: Path) -> None:
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
