"""Client.call(): any message whose reply is one frame, by the names of PROTOCOL.md."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from . import wire
from .arguments import ids_of, media_array, names_of_ids, parameters_of
from .errors import ArgumentError, ProtocolError, naming
from .exchange import Once, Request
from .values import Info

if TYPE_CHECKING:
    from .session import Session


async def call(
    session: Session, message: str, given: Mapping[str, Any] | None = None, *, deadline_ms: int = 0
) -> dict[str, Any]:
    """Sends the message of this name, whose reply is one frame, and returns the fields and arrays of
    the reply by their names in PROTOCOL.md.

    given: fields and arrays of the request by name. Names of info.choices stand for ids, and a list
    of them for a sum; parameters and properties are mappings by name. What is not given has its
    default, or is counted."""
    info, left = session.info, dict(given or {})
    request, reply = (
        wire.PAYLOADS.get(f"{message}_{way}", wire.NOTHING) for way in ("request", "reply")
    )
    if message == "mc" or reply is wire.NOTHING or "part_count" in reply.names:
        raise ArgumentError(f"{message}: no message with a reply of one frame")
    fields = [field for field in request.fields if field.name in left or field.usual]
    fixed = ids_of(info, **{field.name: left.pop(field.name, field.usual) for field in fields})
    parts = {
        part.name: _elements(info, part, fixed.get("evaluator", 1), left.pop(part.name))
        for part in request.parts
        if part.name in left
    }
    if left:
        raise ArgumentError(f"{message}: has no {', '.join(left)}")
    for part in request.parts:
        fixed.pop(part.counted_by if part.name in parts else None, None)
    payload = request.pack(*[fixed][: len(request.structures)], **parts)
    sent = request.structures[0].unpack(payload)._asdict() if request.structures else {}

    def read(data: bytes) -> dict[str, Any]:
        found, arrays = reply.unpack(data)
        if any(sent[name] != getattr(found, name) for name in {*sent} & {*reply.names}):
            raise ProtocolError(f"a {reply.name} that does not reply to the request")
        return names_of_ids(info, found) | arrays

    return await session.call(Request(message, payload, lambda: Once(read), deadline_ms))


def _elements(info: Info, part: wire.Part, evaluator_id: int, value: Any) -> bytes:
    """Returns the bytes of a part of a request."""
    if part.element == "parameter":
        return parameters_of(info, value, kind=part.name)
    with naming(f"{part.name}: an array"):
        array = media_array(value) if part.element == "medium" else np.asarray(value, part.dtype(evaluator_id))
    return bytes(array.tobytes())
