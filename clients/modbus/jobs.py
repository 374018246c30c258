"""Runs one of the longer jobs of a unit with pymodbus, shows how far it is, and cancels it when the
user presses Ctrl-C:

    jobs.py HOST:PORT sample    ten radii, distributed as the light that leaves skin
    jobs.py HOST:PORT invert    the coefficients of three media of known albedo and mean free path
    jobs.py HOST:PORT mc        R of skin by Monte Carlo in five rings, with standard errors
    jobs.py HOST:PORT fit [g=0] [scale=absolute] [eta=X MM,READING,ERROR...]
                                the coefficients of a medium from readings of R at some distances,
                                with their standard errors; eta is the medium's refractive index
                                inside over outside; scale=free: R times an unknown factor

DEVICE,BAUD in place of HOST:PORT names a serial line."""

from __future__ import annotations

import sys

from unit import DEFAULTS, Unit, arguments, numbers, refuse

REGULAR, FREE_PATH, LOGARITHMIC = 2, 1, 3
TRANSPORT = 29
READINGS = ["1,.02292,.00046", "2,.00781,.00016", "3,.00343,.00007", "5,.000775,.000016"]
SCALES = {"absolute": 1, "free": 2}
FIT = {"g": "0", "eta": "1.4", "scale": "absolute"}  # defaults of a fit; eta is that of READINGS
READINGS_MOST = 25
SKIN = 0.032, 0.74, 0, 1.3  # sigma_a, sigma_s (1/mm), g, eta


def run(unit: Unit, commit: int, status: int, progress: int, error_text: int) -> None:
    """Commits a job, whose register `cancel` follows `commit`, and waits until it is done.
    progress: 0 if the job has no such register."""
    token = unit.token(status)

    def show() -> None:
        done = f"{unit.floats(progress, 1)[0]:4.0%}" if progress else "wait"
        print(f"\r{done} ", end="", file=sys.stderr, flush=True)

    unit.write(commit, "H", token)
    try:
        unit.wait(token, status, error_text, show)
    except KeyboardInterrupt:
        unit.write(commit + 1, "H", 1)  # cancel
        sys.exit("cancelled")
    finally:
        print("\r" + 30 * " " + "\r", end="", file=sys.stderr, flush=True)


def sample(unit: Unit) -> None:
    unit.write(4304, "2H", REGULAR, 10)  # draw, sample_count
    run(unit, 4300, 4420, 4428, 4640)
    for i, r in enumerate(unit.floats(4440, 10)):
        print(f"{(i + 0.5) / 10:.0%} of the light within {r:.6g} mm")


def invert(unit: Unit) -> None:
    albedos, lengths_mm = [0.44, 0.22, 0.13], [1.3, 0.95, 0.67]
    unit.write(4704, "2H3f", FREE_PATH, 3, *albedos)  # given, medium_count
    unit.write(4806, "3f", *lengths_mm)
    run(unit, 4700, 4920, 4928, 5240)
    for albedo, a, s in zip(albedos, unit.floats(4940, 3), unit.floats(5040, 3)):
        print(f"albedo {albedo:g}: sigma_a {a:.6g}, sigma_s {s:.6g} 1/mm")


def mc(unit: Unit) -> None:
    unit.write(116, "2f", 0.1, 10)  # radius_start, radius_stop
    unit.write(5302, "2HfI", 5, LOGARITHMIC, 1e6, 1)  # ring_count, spacing, photons, seed
    run(unit, 5300, 5320, 5328, 5868)
    edges = unit.floats(5366, 6)
    rings = zip(edges, edges[1:], unit.floats(5468, 5), unit.floats(5568, 5))
    for start, stop, R, error in rings:
        print(f"{start:.3g} to {stop:.3g} mm: {R:.4g} +- {error:.2g} 1/mm^2")


def read_fit(given: list[str]) -> tuple[dict[str, str], list[list[float]]]:
    """Returns what is given by name, and the readings: mm, reading and error of each."""
    named: dict[str, str] = {}
    for name, value in (one.split("=", 1) for one in given if "=" in one):
        if name in named:
            refuse(f"{name}= is given twice", __doc__)
        if name not in FIT:
            refuse(f"{name}= is unknown; fit takes {'=, '.join(FIT)}=", __doc__)
        if name == "scale" and value not in SCALES:
            refuse(f"scale={value} is unknown; it is {' or '.join(SCALES)}", __doc__)
        if name != "scale":
            numbers(value, 1, __doc__)
        named[name] = value
    own = [one for one in given if "=" not in one]
    if own and "eta" not in named:
        refuse("give eta=X: a wrong eta gives wrong coefficients that fit as well", __doc__)
    readings = [numbers(one, 3, __doc__) for one in own or READINGS]
    if any(len(reading) < 3 for reading in readings):
        refuse(f"{' '.join(own)}: give MM,READING,ERROR of each", __doc__)
    least = 3 if named.get("scale") == "free" else 2
    if not least <= len(readings) <= READINGS_MOST:
        refuse(f"{len(readings)} readings: give {least} to {READINGS_MOST}", __doc__)
    return named, readings


def fit(unit: Unit, named: dict[str, str], readings: list[list[float]]) -> None:
    """An instrument writes its places once, and then its readings each time."""
    known = FIT | named
    at = [mm for mm, _, _ in readings]
    unit.write(101, "H", TRANSPORT)
    unit.write(110, "2f", float(known["g"]), float(known["eta"]))
    unit.write(8001, "H", SCALES[known["scale"]])
    unit.write(8015, f"H{len(at)}f", len(at), *at)  # reading_count, at
    pairs = [number for _, value, error in readings for number in (value, error)]
    unit.write(8204, f"{len(pairs)}f", *pairs)
    run(unit, 8200, 8320, 0, 8420)
    a, s, a_error, s_error, _, chi_squared, _, factor, factor_error = unit.floats(8328, 9)
    print(f"sigma_a {a:.6g} +- {a_error:.2g}, sigma_s' {s:.6g} +- {s_error:.2g} 1/mm")
    if known["scale"] == "free":
        print(f"factor {factor:.6g} +- {factor_error:.2g}")
    (model_error,), (g, eta) = unit.floats(8356, 1), unit.floats(8410, 2)
    g_from, scale_from = ("" if name in named else " (default)" for name in ("g", "scale"))
    print(f"with g {g:.6g}{g_from}, eta {eta:.6g}, scale {known['scale']}{scale_from}")
    print(f"chi-squared {chi_squared:.4g} of {len(at)} readings, model error {model_error:.2g}")


def main() -> None:
    jobs = {"sample": sample, "invert": invert, "mc": mc}
    where, job, *more = arguments(__doc__, 2, 2 + len(FIT) + READINGS_MOST)
    if job not in (*jobs, "fit"):
        refuse(f"{job} is unknown; a job is {', '.join(jobs)} or fit", __doc__)
    if job != "fit" and more:
        refuse(f"{more[0]}: {job} takes nothing more", __doc__)
    named, readings = read_fit(more)
    unit = Unit(where)
    unit.write(DEFAULTS, "H", 1)  # other masters may have written anything
    unit.write(106, "4f", *SKIN)
    if job == "fit":
        fit(unit, named, readings)
    else:
        jobs[job](unit)


main()
