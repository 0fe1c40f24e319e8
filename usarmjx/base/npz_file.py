"""NumPy's `.npz` files within limits: sizes and shapes agree with the file before any array is read."""

import io
import math
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from usarmjx.base.errors import UsageError

HEADER = 4096
"""Bytes at the start of an array that have its shape; ours have 128."""
HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
"""Readers of headers by the version of the format."""


@dataclass(frozen=True)
class NpzLimits:
    """Limits of a file.

    Attributes:
        noun: Kind of the file, for messages, as `policy`.
        most: Most bytes of all arrays, unpacked.
        usual: Bytes that the arrays may take however small the file is.
        ratio: Largest ratio of their size to that of the file beyond.
        arrays: Most arrays.
    """

    noun: str
    most: float = math.inf
    usual: int = 1_000_000
    ratio: float = 1.0
    arrays: int = 1_000


def read_npz(file: Path, limits: NpzLimits, kinds: Callable[[str], str]) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name.

    Args:
        file: The file.
        limits: Its limits.
        kinds: Returns NumPy's letters of the kinds that an array of a name may have: i, u, f and so on.

    Raises:
        UsageError: It is larger than its limits.
        Exception: It is no such file; zipfile and NumPy raise whatever they run into.
    """
    with zipfile.ZipFile(file) as held:
        # NumPy adds the suffix to the name of each array.
        members = {one.filename.removesuffix(".npy"): one for one in held.infolist()}
        _check_sizes(file, held.infolist(), limits)
        # Headers before arrays: a shape can ask for more memory than the file has bytes.
        for name, member in members.items():
            _check_header(held, member, name, kinds(name))
        return {name: _read(held, member) for name, member in members.items()}


def _check_sizes(file: Path, members: Sequence[zipfile.ZipInfo], limits: NpzLimits) -> None:
    if len(members) > limits.arrays:
        raise UsageError(f"{file} has {len(members)} arrays; a {limits.noun} has at most {limits.arrays}")
    # Sizes from the directory, before anything is unpacked: a small file may hold gigabytes of zeros.
    packed, unpacked = file.stat().st_size, sum(one.file_size for one in members)
    most = min(limits.most, max(limits.usual, limits.ratio * packed))
    if unpacked > most:
        raise UsageError(f"{file} has {packed} bytes and becomes {unpacked}; at most {most:.0f}")


def _check_header(held: zipfile.ZipFile, member: zipfile.ZipInfo, name: str, kinds: str) -> None:
    """Check the type of an array, and that its shape agrees with the size of its member."""
    with held.open(member) as stream:
        head = io.BytesIO(stream.read(HEADER))
    shape, _, kind = HEADERS[npy.read_magic(head)](head)
    if kind.kind not in kinds:
        raise ValueError(f"array {name[:40]!r} is of type {kind}; expected {_words(kinds)}")
    # The reader of the header leaves the stream at the first byte of the array.
    size = math.prod(shape) * kind.itemsize + head.tell()
    if size != member.file_size:
        raise ValueError(
            f"array {name[:40]!r} of shape {shape} takes {size} bytes, it has {member.file_size}"
        )


def _words(kinds: str) -> str:
    return {"f": "floating-point numbers", "U": "a text"}.get(kinds, "numbers")


def _read(held: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray[Any, Any]:
    with held.open(member) as stream:
        # Pickled objects would run code of whoever wrote the file.
        return np.asarray(npy.read_array(stream, allow_pickle=False))
