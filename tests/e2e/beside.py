"""What goes on beside a test: calls on threads of their own, and soak-load."""

import os
import subprocess
import threading
from collections.abc import Callable

from daemons import BUILD, eventually

PATIENCE_S = 300.0


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


class SoakLoad:
    """A running soak-load, see tests/soak/load.c. answered: how many answers it has checked."""

    def __init__(self, url: str, seed: int, kind: str = "evals", ca: str = ""):
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        command = [str(BUILD / "soak-load"), url, str(seed), kind]
        env = os.environ | ({"DIPOLED_CA": ca} if ca else {})
        self.process = subprocess.Popen(command, **pipes, env=env, text=True)
        self.answered = 0
        self._last_line = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self._last_line = line.strip()
            if line.startswith("answered="):
                self.answered = int(line.split()[0].removeprefix("answered="))

    def goes_on(self) -> None:
        """Waits until it knows all answers, and has checked some more of them."""
        before = self.answered
        assert eventually(lambda: self.process.poll() is not None or self.answered > before, PATIENCE_S)
        assert self.process.poll() is None, self.process.stderr.read()

    def end(self) -> dict[str, int]:
        """Ends it, and checks that it found no fault. Returns its counts."""
        self.process.stdin.close()
        status = self.process.wait(PATIENCE_S)
        self._reader.join()
        assert status == 0, self.process.stderr.read()
        return {k: int(v) for k, v in (pair.split("=") for pair in self._last_line.split())}

    def kill(self) -> None:
        """Kills it."""
        self.process.kill()
        self.process.wait()
