# SPDX-License-Identifier: BSD-3-Clause
"""Messages packed by protobuf, as Foxglove's libraries write them: their fields as in JSON."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from ndtree._lazy import needs
from ndtree.logs.core.failures import one_line

#: How Google calls its time, and its fields.
_TIME, _DURATION = "google.protobuf.Timestamp", "google.protobuf.Duration"


def fields_of(data: bytes, type: str, schema: bytes) -> dict[str, Any]:
    """Fields of a message by their names, those of messages in it, too.

    `data`: The message.
    `type`: Its name in the schema.
    `schema`: A FileDescriptorSet, as MCAP files have it.
    Raises ImportError if the library is not there; ValueError if the schema or the message is damaged.
    """
    try:
        return _fields(_decoder(type, schema)(data))
    except ImportError:
        raise
    except Exception as error:  # A library at the mercy of foreign bytes.
        raise ValueError(f"no whole {type} packed by protobuf ({one_line(error)})") from None


@lru_cache(maxsize=64)
def _decoder(type: str, schema: bytes) -> Callable[[bytes], Any]:
    with needs("messages packed by protobuf need mcap-protobuf-support", "ros"):
        from mcap.records import Schema
        from mcap_protobuf.decoder import DecoderFactory
    decoder = DecoderFactory().decoder_for(
        "protobuf", Schema(id=1, data=schema, encoding="protobuf", name=type)
    )
    if decoder is None:
        raise ValueError("no schema of protobuf")
    return decoder  # type: ignore[no-any-return]


def _fields(message: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            found[field.name] = value
        elif _is_list(field):
            found[field.name] = [_value(one) for one in value]
        elif message.HasField(field.name):
            found[field.name] = _value(value)
    return found


def _value(message: Any) -> dict[str, Any]:
    if message.DESCRIPTOR.full_name in (_TIME, _DURATION):
        return {"sec": message.seconds, "nsec": message.nanos}
    return _fields(message)


def _is_list(field: Any) -> bool:
    repeated = getattr(field, "is_repeated", None)  # Older libraries have a label.
    return bool(field.label == field.LABEL_REPEATED if repeated is None else repeated)
