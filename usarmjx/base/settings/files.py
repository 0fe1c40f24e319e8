"""Values of YAML, JSON and TOML files with their positions, so that errors name file and line.

The type guards are for data of unknown type: the container is known afterwards, its elements are Any.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard, cast

from usarmjx.base.errors import SpecError, UsageError

MAX_FILE_BYTES = 16_000_000
"""Largest size of a file [bytes]."""
MAX_QUOTED = 100
"""Largest length of a quoted value, and of the names that lead to it, in errors [characters]."""
Plain = dict[str, "FileValue"] | list["FileValue"] | str | int | float | bool | None


@dataclass(frozen=True, eq=False)
class FileValue:
    """A value of a file.

    Attributes:
        data: The value; the items of a list or a mapping are values in turn.
        path: The file.
        line: Its first line, from 1; 0: unknown.
        name: Names that lead to it, as shapes[3].size; empty: the whole file.
        refusal: Class of the errors at this place.
    """

    data: Plain
    path: Path
    line: int
    name: str = ""
    refusal: type[UsageError] = SpecError

    @property
    def place(self) -> str:
        """File and line."""
        return f"{self.path}:{self.line}" if self.line else str(self.path)

    def error(self, text: str) -> UsageError:
        """Return an error at this place."""
        name = f"{self.name}: " if self.name else ""
        return self.refusal(f"{self.place}: {name}{text}")

    def mapping(self) -> dict[str, "FileValue"]:
        """Return the keys and their values.

        Raises:
            UsageError: It is something else.
        """
        if isinstance(self.data, dict):
            return self.data
        raise self.error(f"{self.shown} is not a mapping of keys to values")

    def items(self) -> list["FileValue"]:
        """Return the items of a list.

        Raises:
            UsageError: It is something else.
        """
        if isinstance(self.data, list):
            return self.data
        raise self.error(f"{self.shown} is not a list")

    def plain(self) -> Any:  # noqa: ANN401 - any data
        """Return the data without the lines that it is on."""
        if isinstance(self.data, dict):
            return {key: item.plain() for key, item in self.data.items()}
        return [item.plain() for item in self.data] if isinstance(self.data, list) else self.data

    @property
    def shown(self) -> str:
        """The value as refusals quote it."""
        return shown(self.data)


def shown(data: object) -> str:
    """Return a value as refusals quote it: on one line, and not all of a long one."""
    if isinstance(data, dict):
        return "a mapping"
    if isinstance(data, list) and any(isinstance(item, FileValue) for item in data):  # type: ignore - of any type
        return f"a list of {len(data)}"  # type: ignore - of any type
    if isinstance(data, str):
        return repr(str(data)) if len(data) <= MAX_QUOTED else repr(f"{data[:MAX_QUOTED]}...")
    text = "nothing" if data is None else " ".join(repr(cast(object, data)).split())
    return text if len(text) <= MAX_QUOTED else f"{text[:MAX_QUOTED]}..."


def read_bytes(path: Path, most: int = MAX_FILE_BYTES, refusal: type[UsageError] = SpecError) -> bytes:
    """Return the content of a file.

    Raises:
        UsageError: It is not there, cannot be read, or has more bytes than `most`.
    """
    try:
        size = path.stat().st_size
        if size > most:
            raise refusal(f"{path}: {size} bytes are too many; at most {most}")
        # A read of a pipe or a device could wait for ever.
        if not path.is_file():
            raise refusal(f"{path}: cannot be read: it is no plain file")
        with path.open("rb") as file:
            # No more than that: the file may have grown since.
            return file.read(most)
    except OSError as error:
        raise refusal(f"{path}: cannot be read: {error.strerror or error}") from error


def first_line(error: Exception) -> str:
    """Return the first line of a library's error."""
    # Refusals are one line, messages of parsers may be several.
    return str(error).splitlines()[0]


def joined(name: str, more: str) -> str:
    """Return the names that lead to a value, cut short: each value keeps its own."""
    # At the top of a file no name comes before the dot.
    whole = (name + more).lstrip(".")
    return whole if len(whole) <= MAX_QUOTED else "..." + whole[3 - MAX_QUOTED :]


def is_mapping(value: object) -> TypeGuard[Mapping[Any, Any]]:
    """Return whether data is a mapping."""
    return isinstance(value, Mapping)


def is_list(value: object) -> TypeGuard[list[Any]]:
    """Return whether data is a list."""
    return isinstance(value, list)


def is_tuple(value: object) -> TypeGuard[tuple[Any, ...]]:
    """Return whether data is a tuple."""
    return isinstance(value, tuple)
