"""Draws translucent things: a curved body, lit by one lamp with shadow, in measured marble, milk and
skin, by three models side by side, and what two of them differ from the third:

    python3 picture.py [PICTURE]

Rays of the lamp say where light enters: each brings the same power. The light that leaves is
gathered at each pixel (Jensen and Buhler 2002). Transport diverges at r = 0, so the positions where
light is gathered lie ABOVE_MM above the body: no single point stands out. The body is a rabbit of
ellipsoids that merge, with a fine relief. gnuplot adds the labels. It takes minutes, most of them to
find where the rays meet the body. Lengths are in mm.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import dipole
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

SIDE, RAYS = 224, 2000  # on each side of a view, and of the lamp's beam
VIEW_MM = 23.5  # the square that a view shows
DEPTH_MM = 26.0  # the range of heights in which a ray looks for the body
STEP_LEAST_MM = 0.02  # of a ray
ABOVE_MM = 0.02  # transport lacks its cdf there: 2 % of R in marble, 1 to 6 % in skin
DIFFERENCE_MOST = 0.5  # relative differences beyond this have the colour of this
SCALE_HIGH = 12  # the last rows have the scale of differences
MEDIA = ("marble", "wholemilk", "skin1")
MODELS = ("classical", "better", "transport")
COLUMNS = len(MODELS) + 2
WIDTH, HEIGHT = COLUMNS * SIDE, len(MEDIA) * SIDE + SCALE_HIGH

# ---- the body ------------------------------------------------------------------------------------

MELT_MM = 1.1
# Ellipsoids: centre, then half axes.
PARTS: Array = np.array([
    [[0.5, -4.5, 0], [6.2, 5.6, 5.4]], [[-3.6, 2.6, 1.4], [3.7, 3.4, 3.3]],
    [[-4.6, 7.6, -0.2], [0.9, 3.9, 1.4]], [[-1.6, 7.8, -0.6], [0.9, 3.9, 1.4]],
    [[6.4, -6.0, -1.4], [1.9, 1.9, 1.9]], [[-4.2, -8.6, 3.2], [2.6, 1.5, 1.9]],
    [[2.2, -9.0, 3.8], [3.0, 1.5, 2.0]], [[-6.2, 1.8, 3.2], [1.5, 1.3, 1.5]],
])  # fmt: skip


def field(p: Array) -> Array:
    """Returns a function of points that is negative inside, and near the surface about the distance."""
    x, y, z = p.T
    total: Array = np.full(len(p), 1e-300)
    for at, axes in PARTS:
        s = (p - at) / axes
        k0, k1 = np.sqrt((s**2).sum(axis=1)), np.sqrt(((s / axes) ** 2).sum(axis=1))
        total += np.exp(-2 / MELT_MM * k0 * (k0 - 1) / (k1 + 1e-9))
    relief = np.sin(4.1 * x) * np.cos(3.7 * y) + np.sin(3.9 * y) * np.cos(4.3 * z)
    relief += np.sin(4.0 * z) * np.cos(3.8 * x)
    distance: Array = 0.07 * relief - MELT_MM / 2 * np.log(total)
    return distance


def trace(p: Array, w: Array) -> Array:
    """Moves points along -w to the body (sphere tracing, Hart 1996). Returns which of them meet it."""
    gone, step = np.zeros((2, len(p)))
    moving = np.arange(len(p))
    while moving.size:
        f = field(p[moving])
        moving, f = moving[f > 0], f[f > 0]
        step[moving] = np.maximum(f / 3, STEP_LEAST_MM)
        gone[moving] += step[moving]
        p[moving] -= step[moving, None] * w
        moving = moving[gone[moving] <= DEPTH_MM]
    met: Array = np.flatnonzero(gone <= DEPTH_MM)
    half = step[met] / 2
    while np.any(half > 5e-7):
        p[met] += np.where(field(p[met]) > 0, -half, half)[:, None] * w
        half /= 2
    return met


def look(towards: tuple[float, float, float], side: int, above_mm: float) -> tuple[Array, Array]:
    """Returns what the parallel rays of a square meet, which go along -w from the middles of its
    pixels: points [N, 3] on the body or so far above it, and the positions [N] of their pixels."""
    w = np.array(towards) / np.linalg.norm(towards)
    u = np.cross((0, 1, 0), w)
    u /= np.linalg.norm(u)
    x = (np.arange(side) + 0.5 - side / 2) * (VIEW_MM / side)
    points, pixels = [], []
    for row in range(side):
        p = x[:, None] * u - x[row] * np.cross(w, u) + DEPTH_MM / 2 * w
        met = trace(p, w)
        points.append(p[met] + above_mm * w)
        pixels.append(met + row * side)
    return np.concatenate(points), np.concatenate(pixels)


# ---- the picture ---------------------------------------------------------------------------------


def srgb(linear: Array) -> Array:
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def false_colour(difference: Array) -> Array:
    """White for 0, red where the model gives more, blue where it gives less."""
    t = np.minimum(np.abs(difference) / DIFFERENCE_MOST, 1)
    more, strong, weak = difference > 0, 1 - 0.15 * t, 1 - t
    return np.stack([np.where(more, strong, weak), weak, np.where(more, weak, strong)], axis=-1)


def paint(client: dipole.Client, points: dipole.Points, at: Array, pixels: Array) -> Array:
    """Colours all rows: M of all models with one exposure, then the differences from the last model."""
    rgb = np.full((HEIGHT, WIDTH, 3), 16 / 255)
    for row, medium in enumerate(MEDIA):
        M = []
        for model in MODELS:
            print(f"{medium}, {model}", file=sys.stderr)
            M.append(client.gather(model, medium, points, at).M)
        exposure = 0.32 / M[-1].mean()
        cells = [srgb(exposure * one) for one in M]
        cells += [false_colour((one / M[-1] - 1).mean(axis=1)) for one in M[:-1]]
        for column, cell in enumerate(cells):
            y, x = np.divmod(pixels, SIDE)
            rgb[row * SIDE + y, column * SIDE + x] = cell
    scale = np.linspace(-DIFFERENCE_MOST, DIFFERENCE_MOST, (COLUMNS - len(MODELS)) * SIDE)
    rgb[-SCALE_HIGH:, len(MODELS) * SIDE :] = false_colour(scale)
    bytes_of: Array = np.rint(255 * rgb).astype(np.uint8)
    return bytes_of


def write(rgb: Array, file: str) -> None:
    top, left, bottom = 24, 90, 24
    width, height = WIDTH + left, HEIGHT + top + bottom
    labels = [
        f"set label '{model}{against}' at {i * SIDE + SIDE // 2},{HEIGHT + 12} center"
        for i, (model, against) in enumerate(
            [(one, "") for one in MODELS] + [(one, " against transport") for one in MODELS[:-1]]
        )
    ]
    for row, medium in enumerate(MEDIA):
        labels.append(f"set label '{medium}' at -8,{HEIGHT - row * SIDE - SIDE // 2} right")
    for i, how in enumerate(("left", "center", "right")):
        at = len(MODELS) * SIDE + i * (COLUMNS - len(MODELS)) * SIDE / 2
        text = f"{'+' if i == 2 else ''}{100 * (i - 1) * DIFFERENCE_MOST:g} %"
        labels.append(f"set label '{text}' at {at:g},-12 {how}")
    script = f"""\
set terminal pngcairo size {width},{height} font 'sans,11'
set output '{file}'
set lmargin at screen {left / width}
set rmargin at screen 1
set bmargin at screen {bottom / height}
set tmargin at screen {1 - top / height}
unset border
unset tics
set xrange [0:{WIDTH}]
set yrange [0:{HEIGHT}]
{chr(10).join(labels)}
plot '-' binary array=({WIDTH},{HEIGHT}) flipy format='%uchar' using 1:2:3 with rgbimage notitle
"""
    subprocess.run(["gnuplot"], input=script.encode() + rgb.tobytes(), check=True)


def main() -> None:
    lit = look((-0.75, 0.55, 0.6), RAYS, 0)[0]
    at, pixels = look((-0.35, 0.15, 1), SIDE, ABOVE_MM)
    print(f"{len(lit)} points in the light, {len(at)} pixels", file=sys.stderr)
    power_W = np.full((len(lit), 3), (VIEW_MM / RAYS) ** 2)  # 1 W/mm^2 across the beam
    with dipole.Client() as client:
        rgb = paint(client, dipole.Points(lit, power_W), at, pixels)
    write(rgb, sys.argv[1] if len(sys.argv) > 1 else "picture.png")


main()
