"""The Python side of `build/bench clients`. For each line on standard input, which names an
evaluator, it evaluates a million radii for each of three channels and prints the time in
nanoseconds."""

import sys
import time

import numpy as np

sys.path.insert(0, "clients/python")
import dipole  # noqa: E402


def main(address: str, count: int, start_mm: float, step_mm: float) -> None:
    with dipole.Client(address) as client:
        media = client.media()["skin1"]
        r = start_mm + step_mm * np.arange(count)
        radii = {"f64": r, "f32": r.astype(np.float32)}
        for line in sys.stdin:
            name = line.strip()
            start_ns = time.perf_counter_ns()
            result = client.eval("better", media, radii[name], evaluator=name, wanted=["R"])
            took_ns = time.perf_counter_ns() - start_ns
            print(took_ns, float(result.R[2, -1]).hex(), flush=True)


main(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
