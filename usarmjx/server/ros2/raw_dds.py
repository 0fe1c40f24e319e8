"""Serialized messages into writers and out of readers of Cyclone DDS, past its Python binding's classes."""

# The functions below are in the binding's compiled part, which has no types; its methods call them, too.
# pyright: reportPrivateUsage=false, reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false

from collections.abc import Iterator
from typing import Any, TypeAlias

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import Entity, InstanceState, SampleState, ViewState
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

Writer: TypeAlias = DataWriter[IdlStruct]
Reader: TypeAlias = DataReader[IdlStruct]
ANY_STATE = SampleState.Any | ViewState.Any | InstanceState.Any
MOST_TAKEN = 64
"""Most samples that are taken of a reader at once."""


def write_raw(writer: Writer, data: bytes) -> bool:
    """Write a message's CDR; return False if slow readers had no room for it."""
    return ddspy_write(writer._ref, data + bytes(-len(data) % 4)) == 0


def take_raw(reader: Reader) -> Iterator[bytes]:
    """Yield the CDR of messages that have come; none of a reader that has just been deleted."""
    samples: Any = ddspy_take(reader._ref, ANY_STATE, MOST_TAKEN)
    if not isinstance(samples, int):
        yield from (bytes(data) for data, about in samples if about.valid_data)


def delete(entity: Entity) -> None:
    """Delete an entity and all that it has."""
    # The binding deletes an entity when Python forgets it; then a second deletion does nothing.
    entity.__del__()
