"""Eight connections have many outstanding requests through libdipole. Each request gets its own,
correct answer, also with several daemons of which one after the other is killed."""

import os

from beside import Bench
from daemons import Daemon, sanitized

MANY = ("--connections", "8", "--in-flight", "256")


def test_each_answer_is_matched(daemon):
    """The least number of requests is in $PIPELINE_REQUESTS; `make check-pipeline` sets a large one."""
    load = Bench(daemon().url(), *MANY)
    while load.answered < int(os.environ.get("PIPELINE_REQUESTS") or 1):
        load.measure()
    print(f"pipeline: {load.answered} answers")


def test_with_daemons_that_are_killed_in_turn(tmp_path):
    urls = [f"unix:{tmp_path}/{name}" for name in "ab"]
    daemons = [Daemon(listen=[url]) for url in urls]
    try:
        with Bench(",".join(urls), *MANY, "--seconds", "0.2") as load:
            for _ in range(4 if sanitized() else 30):
                which = load.reached(daemons)
                daemons[which].kill()
                daemons[which] = Daemon(listen=[urls[which]])
    finally:
        for one in daemons:
            one.close()
