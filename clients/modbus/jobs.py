"""Runs one of the longer jobs of a unit with pymodbus, shows how far it is, and cancels it when the
user presses Ctrl-C:

    jobs.py HOST:PORT sample    ten radii, distributed as the light that leaves skin
    jobs.py HOST:PORT invert    the coefficients of three media of known albedo and mean free path
    jobs.py HOST:PORT mc        R of skin by Monte Carlo in five rings, with standard errors
    jobs.py HOST:PORT fit [[g=0] eta=X MM,READING,ERROR...]
                                the coefficients of a medium from readings of R at some distances,
                                with their standard errors; eta is the medium's refractive index
                                inside over outside

DEVICE,BAUD in place of HOST:PORT names a serial line."""

import sys

from unit import DEFAULTS, Unit

REGULAR, FREE_PATH, LOGARITHMIC = 2, 1, 3
TRANSPORT = 29
READINGS = ["1,.02292,.00046", "2,.00781,.00016", "3,.00343,.00007", "5,.000775,.000016"]
SKIN = 0.032, 0.74, 0, 1.3  # sigma_a, sigma_s (1/mm), g, eta


def run(unit: Unit, commit: int, status: int, progress: int, error_text: int) -> None:
    """Commits a job, whose register `cancel` follows `commit`, and waits until it is done.
    progress: 0 if the job has no such register."""
    token = unit.token(status)

    def show() -> None:
        place = int.from_bytes(unit.read(status + 6, 1), "big")
        before = f", {place} before it" if place else ""
        done = f"{unit.floats(progress, 1)[0]:4.0%}" if progress else "wait"
        print(f"\r{done}{before} ", end="", file=sys.stderr, flush=True)

    unit.write(commit, "H", token)
    try:
        unit.wait(token, status, error_text, show)
    except KeyboardInterrupt:
        unit.write(commit + 1, "H", 1)  # cancel
        sys.exit("\ncancelled")
    print("\r" + 30 * " " + "\r", end="", file=sys.stderr)


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


def fit(unit: Unit, *given: str) -> None:
    """An instrument writes its places once, and then its readings each time."""
    given = given or ("eta=1.4", *READINGS)
    known = {name: float(value) for name, _, value in (one.partition("=") for one in given) if value}
    readings = [one for one in given if "=" not in one]
    if "eta" not in known:
        sys.exit("give eta=X: a wrong eta gives wrong coefficients that fit as well")
    g_from = "" if "g" in known else " (default)"
    at, values, errors = zip(*(map(float, one.split(",")) for one in readings))
    unit.write(101, "H", TRANSPORT)
    unit.write(110, "2f", known.get("g", 0), known["eta"])
    unit.write(8015, f"H{len(at)}f", len(at), *at)  # reading_count, at
    pairs = [number for pair in zip(values, errors) for number in pair]
    unit.write(8204, f"{len(pairs)}f", *pairs)
    run(unit, 8200, 8320, 0, 8420)
    a, s, a_error, s_error, _, chi_squared = unit.floats(8328, 6)
    print(f"sigma_a {a:.6g} +- {a_error:.2g}, sigma_s' {s:.6g} +- {s_error:.2g} 1/mm")
    (model_error,), (g, eta) = unit.floats(8356, 1), unit.floats(8410, 2)
    print(f"with g {g:.6g}{g_from}, eta {eta:.6g}")
    print(f"chi-squared {chi_squared:.4g} of {len(at)} readings, model error {model_error:.2g}")


def main(where: str, job: str, *more: str) -> None:
    unit = Unit(where)
    unit.write(DEFAULTS, "H", 1)  # other masters may have written anything
    unit.write(106, "4f", *SKIN)
    if job == "fit":
        fit(unit, *more)
    else:
        {"sample": sample, "invert": invert, "mc": mc}[job](unit)


main(*sys.argv[1:])
