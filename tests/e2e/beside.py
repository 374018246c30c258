"""What goes on beside a test: calls on threads of their own, and loads of `dipole bench`."""

import json
import threading
from collections.abc import Callable

import command_line
import dipole
from daemons import Daemon, eventually


class Beside(threading.Thread):
    """Calls act() again and again until the end of the with block, which raises what act() has
    raised. done: how often it has returned."""

    def __init__(self, act: Callable[[], object]):
        super().__init__()
        self.act, self.done = act, 0
        self.ended = threading.Event()
        self.failure: BaseException | None = None

    def run(self) -> None:
        try:
            while not self.ended.is_set():
                self.act()
                self.done += 1
        except BaseException as failure:  # the test's own thread raises it
            self.failure = failure

    def __enter__(self) -> "Beside":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        self.join()
        if self.failure is not None:
            raise self.failure


class Bench(Beside):
    """`dipole bench`, which compares each answer with the first one, again and again. answered: how
    many answers there were."""

    def __init__(self, url: str, *options: str, **env: str):
        super().__init__(self.measure)
        patience = "--retry-ms=240000", "--timeout-ms=240000"
        self.command = ("bench", "--connect", url, "--format", "json", *patience, *options)
        self.env, self.answered = env, 0

    def measure(self) -> None:
        """Lets it end once."""
        measured = json.loads(command_line.dipole(*self.command, env=self.env).stdout)
        self.answered += sum(one["requests"] for one in measured["rows"])

    def reached(self, daemons: list[Daemon]) -> int:
        """Waits until one of these daemons has answered many requests. Returns which one."""

        def are_many(daemon: Daemon) -> bool:
            with dipole.Client(daemon.urls[0]) as client:
                return client.statistics()["requests_eval"] > 1000

        assert eventually(lambda: self.failure or any(map(are_many, daemons)))
        return next((i for i, one in enumerate(daemons) if are_many(one)), 0)
