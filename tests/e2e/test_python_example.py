"""The example of the Python module runs as it stands, with and without matplotlib."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "clients/python/examples/skin.py"


def run_example(shared, folder: Path, *before: str) -> subprocess.CompletedProcess[str]:
    """Runs the example. before: statements that are executed first."""
    (folder / "sitecustomize.py").write_text("\n".join(before))
    paths = [str(folder), str(EXAMPLE.parents[1])]
    environment = {**os.environ, "DIPOLED": shared.url(), "PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.run(
        [sys.executable, str(EXAMPLE), str(folder / "skin.png")],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def check_numbers(shared, output: str) -> None:
    with shared.client() as client:
        skin = client.media()["skin1"]
        nearest = client.eval("better", skin[0], [0.15]).R[0, 0]
    first = next(line for line in output.splitlines() if line.split()[:1] == ["0.150"])
    assert first.split()[-1] == f"{nearest:.4g}"
    assert "within 1 %: transport by lut" in output
    assert "(40, 50) media" in output


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
