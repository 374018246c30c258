"""The examples of the Python module run as they stand, with and without matplotlib."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from daemons import finished

EXAMPLES = Path(__file__).parents[2] / "clients/python/examples"


def run_example(
    shared, folder: Path, *before: str, name: str = "skin"
) -> subprocess.CompletedProcess[str]:
    """Runs the example. before: statements that are executed first."""
    (folder / "sitecustomize.py").write_text("\n".join(before))
    paths = [str(folder), str(EXAMPLES.parent)]
    environment = {**os.environ, "DIPOLED": shared.url(), "PYTHONPATH": os.pathsep.join(paths)}
    return finished(sys.executable, str(EXAMPLES / f"{name}.py"), str(folder / "skin.png"), env=environment)


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


def test_a_fit_of_six_readings(shared, tmp_path):
    """The readings are those of sigma_a 0.05 and sigma_s 12, with errors of 2 %."""
    result = run_example(shared, tmp_path, name="fit")
    assert result.returncode == 0, result.stderr
    found = re.findall(r"(\w+) ([\d.]+) 1/mm, \+- ([\d.]+)%", result.stdout)
    assert [name for name, _, _ in found] == ["sigma_a", "sigma_s"]
    for (_, value, error), true in zip(found, (0.05, 12)):
        assert 0.5 < float(error) < 3
        assert abs(float(value) / true - 1) < 3 * float(error) / 100
    assert float(re.search(r"chi squared ([\d.]+)", result.stdout)[1]) < 13.3  # 99 % for 4


def test_without_matplotlib(shared, tmp_path):
    hidden = "import sys; sys.modules['matplotlib'] = None"
    result = run_example(shared, tmp_path, hidden)
    assert result.returncode == 0 and "python3-matplotlib" in result.stderr
    check_numbers(shared, result.stdout)
    assert not (tmp_path / "skin.png").exists()


@pytest.mark.skipif(
    importlib.util.find_spec("matplotlib") is None, reason="matplotlib is not installed"
)
def test_with_matplotlib(shared, tmp_path):
    result = run_example(shared, tmp_path)
    assert result.returncode == 0, result.stderr
    check_numbers(shared, result.stdout)
    assert (tmp_path / "skin.png").read_bytes().startswith(b"\x89PNG")
