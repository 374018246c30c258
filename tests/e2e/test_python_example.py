"""The examples of the Python module run as they stand."""

import os
import re
import subprocess
import sys
from pathlib import Path

from daemons import finished

EXAMPLES = Path(__file__).parents[2] / "clients/python/examples"


def run_example(shared, name: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "DIPOLED": shared.url(), "PYTHONPATH": str(EXAMPLES.parent)}
    return finished(sys.executable, str(EXAMPLES / f"{name}.py"), env=environment)


def check_numbers(shared, output: str) -> None:
    with shared.client() as client:
        skin = client.media()["skin1"]
        nearest = client.eval("better", skin[0], [0.15]).R[0, 0]
    first = next(line for line in output.splitlines() if line.split()[:1] == ["0.150"])
    assert first.split()[-1] == f"{nearest:.4g}"
    assert re.search(r"within 1 %: transport by (f32|lut), at most [\d.e-]+ off", output)
    assert "(40, 50) media" in output
    deviations = [float(number) for number in re.findall(r" ([+-][\d.]+) errors", output)]
    assert len(deviations) == 4 and max(map(abs, deviations)) < 4.5


def test_a_fit_of_six_readings(shared):
    """The readings are those of sigma_a 0.05 and sigma_s 12, with errors of 2 %."""
    result = run_example(shared, "fit")
    assert result.returncode == 0, result.stderr
    found = re.findall(r"(\w+) ([\d.]+) 1/mm, \+- ([\d.]+)%", result.stdout)
    assert [name for name, _, _ in found] == ["sigma_a", "sigma_s"]
    for (_, value, error), true in zip(found, (0.05, 12)):
        assert 0.5 < float(error) < 3
        assert abs(float(value) / true - 1) < 3 * float(error) / 100
    assert float(re.search(r"chi squared ([\d.]+)", result.stdout)[1]) < 13.3  # 99 % for 4


def test_skin(shared):
    result = run_example(shared, "skin")
    assert result.returncode == 0, result.stderr
    check_numbers(shared, result.stdout)
