"""Eight threads have many outstanding requests through libdipole. Each request gets its own,
correct answer, also with several daemons of which one after the other is killed."""

import itertools
import os
import re
import subprocess

from daemons import BUILD, Daemon, finished, sanitized

PROGRAM = str(BUILD / "soak-load")
TIMEOUT_S = 300.0


def check_output(output: str, errors: str, status: int, requests: int) -> None:
    assert status == 0, errors
    assert errors == ""
    assert re.search(rf"^answered={requests} ", output, re.M), output


def test_each_answer_is_matched(daemon):
    """The number of requests is in $PIPELINE_REQUESTS; `make check-pipeline` sets a large one."""
    usual = 20_000 if sanitized() else 200_000
    requests = int(os.environ.get("PIPELINE_REQUESTS") or usual)
    command = [PROGRAM, daemon().url(), "1", "short", str(requests)]
    run = finished(*command, timeout=TIMEOUT_S + requests / 1000)
    print(run.stdout)
    check_output(run.stdout, run.stderr, run.returncode, requests)


def test_with_daemons_that_are_killed_in_turn(tmp_path):
    requests = 100_000 if sanitized() else 2_000_000
    urls = [f"unix:{tmp_path}/{name}" for name in "ab"]
    daemons = [Daemon(listen=[url]) for url in urls]
    kills = 0
    command = [PROGRAM, ",".join(urls), "1", "short", str(requests)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    try:
        with subprocess.Popen(command, **pipes) as program:
            try:
                for which in itertools.cycle([0, 1]):
                    if program.poll() is not None:
                        break
                    daemons[which].kill()
                    daemons[which] = Daemon(listen=[urls[which]])
                    kills += 1
                check_output(*program.communicate(timeout=TIMEOUT_S), program.returncode, requests)
            finally:
                program.kill()
    finally:
        for daemon in daemons:
            daemon.close()
    assert kills >= 2
