"""How many frames an hour a small farm makes: `make farm-day`.

    farm_day.py [--seconds 40]

A frame is what the examples in clients/python/examples ask of a daemon (evaluations, media that vary,
light gathered on the rabbit, whose picture and lamp are smaller here), a texture and samples for a
tile. It is recorded once from these programs; then eight clients, each a process, make the same calls
again and again of three daemons behind HAProxy, with points that are new in each frame. Everything
runs on this machine, clients included. Figures are printed as those of build/bench are.

At home means the classical dipole (Jensen et al. 2001) in numpy, in single precision, on one core: a
value for each that the daemons computed, and for light gathered one for each pair."""

import argparse
import contextlib
import io
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parent / "e2e")]

import dipole
import numpy as np
from plan import KINDS
from test_balancer import balanced

EXAMPLES = Path(__file__).resolve().parents[1] / "clients/python/examples"
CLIENTS = 8
CALLS = ("eval", "values", "varying", "sample", "gather")
TILES, SAMPLES = 64, 65536

Call = tuple[str, tuple[Any, ...], dict[str, Any]]


# ---- recording -----------------------------------------------------------------------------------


class Frame:
    """Calls in their order, and how many values they compute, in gathers and elsewhere."""

    def __init__(self) -> None:
        self.calls: list[Call] = []
        self.values = {"gathers": 0, "others": 0}

    def keep(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """Returns the call, which keeps itself, too."""

        def kept(*arguments: Any, **options: Any) -> Any:
            self.calls.append((name, arguments, options))
            found = call(*arguments, **options)
            if name == "gather":
                self.values["gathers"] += len(arguments[2]) * found.M.size
            else:
                arrays = found.quantities.values() if hasattr(found, "quantities") else [found.values]
                self.values["others"] += max(np.size(one) for one in arrays)
            return found

        return kept


def record(address: str) -> Frame:
    frame, real = Frame(), dipole.Client

    def recording() -> dipole.Client:
        client = real(address)
        for name in CALLS:
            setattr(client, name, frame.keep(name, getattr(client, name)))
        return client

    picture = (EXAMPLES / "picture.py").read_text()
    for old, new in ("= 224, 2000", "= 64, 256"), ("    write(", "    return; write("):
        assert old in picture, old
        picture = picture.replace(old, new)
    skin = (EXAMPLES / "skin.py").read_text().split("# %% The last cell")[0]
    dipole.Client = recording
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(sys.stdout):
        for program in (EXAMPLES / "fit.py").read_text(), skin, picture:
            exec(compile(program, "example", "exec"), {})
    with recording() as client:
        for number in range(TILES):
            KINDS["tile"](client, number)
        KINDS["texture"](client, 0)
        client.sample("transport", "skin1", draw=dipole.Draw(SAMPLES), evaluator="lut")
    dipole.Client = real
    return frame


# ---- replaying -----------------------------------------------------------------------------------


def replay(client: dipole.Client, frame: Frame, number: int) -> None:
    """Makes all calls of a frame. Its points have powers that no other frame's have."""
    made: dict[int, dipole.Points] = {}
    for name, arguments, options in frame.calls:
        if name == "gather":
            model, medium, points, *rest = arguments
            brighter = dipole.Points(points.xyz, points.power * (1 + 1e-6 * number))
            points = made.setdefault(id(points), brighter)
            arguments = (model, medium, points, *rest)
        getattr(client, name)(*arguments, **options)


def client_of_farm(address: str, frame: Frame, which: int, end_s: float, counted: Any) -> None:
    number = 0
    with dipole.Client(address) as client:
        while time.monotonic() < end_s:
            number += 1
            replay(client, frame, which * 10000 + number)
            with counted.get_lock():
                counted.value += 1


def farm_frames_per_s(frame: Frame, seconds: float) -> float:
    with tempfile.TemporaryDirectory() as folder, balanced(Path(folder)) as farm:
        counted = multiprocessing.Value("q", 0)
        start_s = time.monotonic()
        how = (farm.address, frame)
        clients = [
            multiprocessing.Process(target=client_of_farm, args=(*how, which, start_s + seconds, counted))
            for which in range(CLIENTS)
        ]
        for one in clients:
            one.start()
        while any(one.is_alive() for one in clients):
            clients[0].join(1)
            passed = min(1.0, (time.monotonic() - start_s) / seconds)
            show(f"{passed:4.0%} {counted.value} frames by {CLIENTS} clients")
        assert all(one.exitcode == 0 for one in clients), "a client failed"
        return counted.value / (time.monotonic() - start_s)


def home_values_per_s() -> float:
    """Returns how many values of R the classical dipole takes a second, in numpy."""
    sigma_a, sigma_s, eta = 0.032, 0.74, 1.3
    internal = -1.440 / eta**2 + 0.710 / eta + 0.668 + 0.0636 * eta
    sigma_t = sigma_a + sigma_s
    mu, z1 = np.float32(np.sqrt(3 * sigma_a * sigma_t)), np.float32(1 / sigma_t)
    z2 = np.float32(1 / sigma_t * (1 + 4 / 3 * (1 + internal) / (1 - internal)))
    scale, r = np.float32(sigma_s / sigma_t / (4 * np.pi)), np.linspace(0.01, 10, 4096, dtype="f4")
    times = []
    for _ in range(200):
        start_s = time.perf_counter()
        R, squares = np.zeros_like(r), r * r
        for z in z1, z2:
            d = np.sqrt(squares + z * z)
            R += z * (1 + mu * d) * np.exp(-mu * d) / (d * d * d)
        R *= scale
        times.append(time.perf_counter() - start_s)
    return len(r) / float(np.median(times))


def show(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("--seconds", type=float, default=40.0, help="for which clients begin frames")
    seconds = options.parse_args().seconds
    show("recording a frame")
    with tempfile.TemporaryDirectory() as folder, balanced(Path(folder)) as farm:
        frame = record(farm.address)
    per_s, home_per_s = farm_frames_per_s(frame, seconds), home_values_per_s()
    show("")
    home_s = {kind: count / home_per_s for kind, count in frame.values.items()}
    for name, value, unit in (
        ("calls", len(frame.calls), "a frame"),
        *((f"values.{kind}", count, "a frame") for kind, count in frame.values.items()),
        ("farm", 3600 * per_s, "frames/h"),
        ("home.value", 1e9 / home_per_s, "ns"),
        *((f"home.{kind}", taken_s, "s a frame") for kind, taken_s in home_s.items()),
        ("home", 3600 / sum(home_s.values()), "frames/h"),
    ):
        print(f"farm_day.{name}\t{value:.6g}\t{unit}")


if __name__ == "__main__":
    main()
