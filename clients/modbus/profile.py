"""Reads R of skin at ten distances with pymodbus: profile.py HOST:PORT [MODEL], or profile.py
DEVICE,BAUD [MODEL] for a serial line. MODEL is an id of the list of models in REGISTERS.md.

One request writes the medium and the distances and commits them. The values are read when the job
is done, which takes a while with the models whose tables have to be prepared, such as 29."""

import struct

from unit import DEFAULTS, Unit, arguments, refuse

RADII_MM = [0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8]
BETTER, F32, EXACT, LIST = 2, 2, 1, 1

where, model = (*arguments(__doc__, 1, 2), str(BETTER))[:2]
if not model.isdecimal() or not 0 < int(model) < 65536:
    refuse(f"{model}: give the id of a model, a number such as {BETTER}", __doc__)
unit = Unit(where)
unit.write(DEFAULTS, "H", 1)  # other masters may have written anything
token = unit.token()
# The fields of registers 100 and up: commit, model, evaluator, moments, tolerance (0: none),
# sigma_a, sigma_s, g, eta, spacing, number of distances, start and stop of a grid (unused here),
# distances.
unit.write(
    100, f"4H5f2H2f{len(RADII_MM)}f",
    token, int(model), F32, EXACT, 0, 0.032, 0.74, 0, 1.3, LIST, len(RADII_MM), 0, 0, *RADII_MM,
)  # fmt: skip
unit.wait(token)
taken, _, error = struct.unpack(">2H4xf", unit.read(306, 6))
for r, R in zip(RADII_MM, unit.floats(312, len(RADII_MM))):
    print(f"{r:g} mm: {R:.9g} 1/mm^2")
print(f"model {taken}, model error {error:.2g} against radiative transport")
