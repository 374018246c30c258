"""Reads R of a medium at up to 50 distances with pymodbus:

    profile.py HOST:PORT [MODEL] [sigma_a=0.032] [sigma_s=0.74] [g=0] [eta=1.3] [r=0.1,0.2,...]

DEVICE,BAUD in place of HOST:PORT names a serial line. MODEL is an id of the list of models in
REGISTERS.md. sigma_a and sigma_s are in 1/mm, r in mm; the medium is skin where it is not given.

One request writes the medium and the distances and commits them. The values are read when the job
is done, which takes a while with the models whose tables have to be prepared, such as 29."""

import struct

from unit import DEFAULTS, Unit, arguments, numbers, refuse

USUAL = {"sigma_a": "0.032", "sigma_s": "0.74", "g": "0", "eta": "1.3"}
RADII_MM, RADII_MOST = "0.1,0.2,0.5,1,1.5,2,3,4,6,8", 50
BETTER, F32, EXACT, LIST = 2, 2, 1, 1

where, *words = arguments(__doc__, 1, 7)
given: dict[str, str] = {}
for word in words:
    name, _, value = word.rpartition("=")  # the model has no name
    if name in given or name not in ("", "r", *USUAL):
        refuse(f"{word}: {name or 'the model'} is unknown, or given twice", __doc__)
    given[name] = value
model = given.get("", str(BETTER))
if not model.isdecimal() or not 0 < int(model) < 65536:
    refuse(f"{model}: give the id of a model, a number such as {BETTER}", __doc__)
medium = [numbers(given.get(name, usual), 1, __doc__)[0] for name, usual in USUAL.items()]
radii_mm = numbers(given.get("r", RADII_MM), RADII_MOST, __doc__)
unit = Unit(where)
unit.write(DEFAULTS, "H", 1)  # other masters may have written anything
token = unit.token()
# The fields of registers 100 and up: commit, model, evaluator, moments, tolerance (0: none),
# sigma_a, sigma_s, g, eta, spacing, number of distances, start and stop of a grid (unused here),
# distances.
unit.write(
    100, f"4H5f2H2f{len(radii_mm)}f",
    token, int(model), F32, EXACT, 0, *medium, LIST, len(radii_mm), 0, 0, *radii_mm,
)  # fmt: skip
unit.wait(token)
taken, _, error = struct.unpack(">2H4xf", unit.read(306, 6))
for r, R in zip(radii_mm, unit.floats(312, len(radii_mm))):
    print(f"{r:g} mm: {R:.9g} 1/mm^2")
print(f"model {taken}, model error {error:.2g} against radiative transport")
