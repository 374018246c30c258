"""`dipole mc`: its table for people and for programs, its progress, and Ctrl-C."""

import re
import signal

import pytest
from command_line import FAILED, Terminal

MEDIUM = ["--sigma-a", "0.1", "--sigma-s", "0.9", "--eta", "1.3"]
ENDLESS = ["--sigma-a", "1e-4", "--sigma-s", "10", "--g", "0.9", "--photons", "1e10"]


def test_progress_and_ctrl_c():
    run = Terminal("mc", *ENDLESS, on=[2])
    run.read_until(lambda seen: re.search(r"worst ring .* mm: ", seen))
    least, most = re.search(r"worst ring (\S+) to (\S+) mm: ", run.seen).groups()
    assert float(most) - float(least) == pytest.approx(0.5)  # 20 rings up to 10 mm
    assert "photons" in run.seen and " left" in run.seen and run.seen.startswith("\r[")
    run.process.send_signal(signal.SIGINT)
    run.read_until(lambda seen: "cancelled after" in seen)
    status, output = run.end()
    assert status == FAILED
    assert "CANCELLED: this is what had been walked by then" in output
    assert "R_total" in output


@pytest.mark.parametrize("photons", ["1", "2e6"])
def test_no_bar_is_left_behind(photons):
    run = Terminal("mc", *MEDIUM, "--photons", photons, on=[2])
    status, output = run.end()
    assert status == 0 and "R_total" in output
    assert run.seen == "" or run.seen.endswith("\r\033[K")
