"""Evaluates skin. An editor or a notebook can run this file cell by cell (# %%); or run all of it:

    python3 skin.py

The program uses the dipoled that $DIPOLED names, or a private one. Lengths are in mm.
"""

# %% The daemon knows measured media, each with a red, a green and a blue channel.
import dipole
import numpy as np

client = dipole.Client()
skin = client.media()["skin1"]
print(f"{client.info.software} at {client.info.address}")
for colour, medium in zip(("red", "green", "blue"), skin):
    print(f"  skin1, {colour}: {medium}")

# %% R is how much light leaves at a distance r: by the exact solution, and by two models. Its shape
# is [channel, radius]. Each result says how far its values may be off.
r = np.geomspace(0.15, 10, 60)
exact = client.eval("transport", skin, r, evaluator="lut")
models = {name: client.eval(name, skin, r) for name in ("classical", "better")}
print("\nred, mm    transport" + "".join(f"{name:>12}" for name in models))
for i in range(0, len(r), 12):
    row = [exact.R[0, i], *(result.R[0, i] for result in models.values())]
    print(f"{r[i]:7.3f}" + "".join(f"{value:12.4g}" for value in row))
for name, result in models.items():
    off = np.abs(result.R / exact.R - 1).max(axis=1)
    print(f"{name}: up to {off[0]:.0%} off in red; quoted: up to {result.model_error[0]:.0%}")

# %% A tolerance in place of a model takes the cheapest model that is measured to keep it.
chosen = client.eval(None, skin, r, tolerance=0.01)
off = (chosen.model_error[:, None] + chosen.numerical_error()).max()
print(f"\nwithin 1 %: {chosen.model} by {chosen.evaluator}, at most {off:.1g} off")

# %% Monte Carlo gives means over rings. A model's are the light between the edges over the area.
walked = client.mc(skin[0], dipole.Grid(0.2, 10, 11, "logarithmic"), photons=300_000)
light = client.eval("transport", skin[0], walked.edges, wanted=["cdf", "albedo"])
means = light.albedo[0] * np.diff(light.cdf[0]) / (np.pi * np.diff(walked.edges**2))
deviation = (walked.R[0] - means) / walked.R_error[0]  # in standard errors
print("\nred, rings of mm     Monte Carlo   transport   apart by")
for i in range(0, len(deviation), 3):
    ring = f"{walked.edges[i]:.3f} to {walked.edges[i + 1]:.3f}"
    print(f"{ring:16} {walked.R[0, i]:15.4g} {means[i]:11.4g} {deviation[i]:+8.1f} errors")

# %% values() broadcasts media and radii: the fraction of light within 1 mm, for 40 x 50 media.
sigma_a = np.geomspace(0.01, 1, 40)[:, None]
sigma_s = np.geomspace(0.3, 10, 50)[None, :]
within = client.values("better", dipole.Medium(sigma_a, sigma_s), 1.0, "cdf").values
print(f"\nenergy within 1 mm: {within.min():.0%} to {within.max():.0%} of {within.shape} media")

client.close()
