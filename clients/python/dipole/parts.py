"""The parts of a large answer, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from .values import Result

if TYPE_CHECKING:
    from .client import Client


class Parts(Iterator[Result]):
    """The parts of an answer, as Client.eval_parts() gives them. Other calls of the client may be
    made between two parts; they wait until the rest has come, which is kept. Left before its end it
    is to be closed, or used in a with statement: what still comes is then thrown away."""

    def __init__(self, client: Client, request_id: int):
        self._client = client
        self._request_id = request_id
        self._open = True

    def __next__(self) -> Result:
        if not self._open:
            raise StopIteration
        try:
            part = self._client._next_part(self._request_id)
        except BaseException:
            self.close()
            raise
        if part is None:
            self.close()
            raise StopIteration
        return part

    def __enter__(self) -> Parts:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """No more parts are wanted. Closing twice is fine."""
        if self._open:
            self._open = False
            self._client._drop(self._request_id)
