"""What a policy's file holds, looked at before it is unpacked and checked before it is used."""

import io
import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from usarmjx.base.errors import UsageError, one_line

FORMAT = 1
MOST_BYTES = 64_000_000
"""Of a policy's arrays, unpacked."""
USUAL_BYTES, MOST_RATIO = 8_000_000, 100
"""Of arrays that may be packed as small as they are, and how much larger than their file others may be."""
MOST_ARRAYS = 1000
HEADER = 4096
"""Bytes at the start of an array that have its shape; ours have 128."""


def read_arrays(file: Path) -> tuple[Any, dict[str, np.ndarray]]:
    """Return what is said under `about` in a policy's file, and its other arrays.

    No array is read before all shapes are known to be as large as the file says, and no larger than may be.

    Raises:
        UsageError: The file is too large, or no policy.
    """
    try:
        with zipfile.ZipFile(file) as held:
            members = {one.filename.removesuffix(".npy"): one for one in held.infolist()}
            _check_sizes(file, list(members.values()))
            for name, member in members.items():
                _check_header(held, member, name)
            found = {name: _read(held, member) for name, member in members.items()}
            return json.loads(str(found.pop("about"))), found
    except UsageError:
        raise
    except KeyError:
        raise UsageError(f"{file} is no policy of usarmjx: it has no `about`") from None
    except Exception as error:  # zipfile and NumPy raise whatever they run into
        raise UsageError(f"{file} is no policy of usarmjx: {one_line(error)}") from error


def _check_sizes(file: Path, members: Sequence[zipfile.ZipInfo]) -> None:
    if len(members) > MOST_ARRAYS:
        raise UsageError(f"{file} has {len(members)} arrays; a policy has at most {MOST_ARRAYS}")
    packed, unpacked = file.stat().st_size, sum(one.file_size for one in members)
    most = min(MOST_BYTES, max(USUAL_BYTES, MOST_RATIO * packed))
    if unpacked > most:
        raise UsageError(f"{file} has {packed} bytes and becomes {unpacked}; at most {most}")


def _check_header(held: zipfile.ZipFile, member: zipfile.ZipInfo, name: str) -> None:
    """Check that an array is of numbers or a text, and as large as its member is said to be."""
    with held.open(member) as stream:
        head = io.BytesIO(stream.read(HEADER))
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[npy.read_magic(head)]
    shape, _, kind = read(head)
    if kind.kind not in ("f", "U") or (kind.kind == "U") != (name == "about"):
        raise ValueError(f"array {name[:40]!r} is of type {kind}; expected floating-point numbers")
    size = math.prod(shape) * kind.itemsize + head.tell()
    if size != member.file_size:
        raise ValueError(
            f"array {name[:40]!r} of shape {shape} takes {size} bytes, it has {member.file_size}"
        )


def _read(held: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    with held.open(member) as stream:
        array = np.asarray(npy.read_array(stream, allow_pickle=False))
    return array.astype(np.float32) if array.dtype.kind == "f" else array


def check_about(about: Any) -> None:  # noqa: ANN401 - whatever the file has
    """Check that a policy's file says what a policy needs.

    Raises:
        ValueError: Something is missing, or of another kind; names it.
    """
    _check("about", about, dict, about)
    for key, kind in (("task", str), ("overrides", dict), ("period", int | float), ("groups", list)):
        _check(key, about, kind)
    for key in ("layers", "memory"):
        _check_whole(key, about)
    if not (0 < about["period"] < math.inf and about["groups"] and about["layers"]):
        raise ValueError("its period is above 0, and it has groups and layers")
    _check_texts("overrides", [*about["overrides"], *about["overrides"].values()])
    for group in about["groups"]:
        _check("group", group, dict, group)
        if group.keys() != {"name", "agents", "obs_size", "action_size"}:
            raise ValueError(f"a group has {', '.join(sorted(group))[:100]}, not what groups have")
        _check("name", group, str)
        _check("agents", group, list)
        _check_texts("agents", group["agents"])
        _check_whole("obs_size", group)
        _check_whole("action_size", group)


def _check(key: str, held: Mapping[str, Any], kind: Any, value: Any = None) -> None:  # noqa: ANN401
    found = held[key] if value is None else value
    if not isinstance(found, kind) or isinstance(found, bool):
        raise ValueError(f"its {key} is a {type(found).__name__}")


def _check_whole(key: str, held: Mapping[str, Any]) -> None:
    _check(key, held, int)
    if not 0 <= held[key] <= MOST_BYTES:
        raise ValueError(f"its {key} is {held[key]}")


def _check_texts(key: str, found: Sequence[Any]) -> None:
    if not all(isinstance(one, str) for one in found):
        raise ValueError(f"its {key} are texts")


def check_shapes(about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Check that a policy's arrays fit together, so that it can act.

    Raises:
        ValueError: An array has another shape than it must have; names it.
        KeyError: It is not there.
    """
    memory = about["memory"]
    for g, group in enumerate(about["groups"]):
        width = group["obs_size"]
        wanted = {f"mean/{g}": (width,), f"std/{g}": (width,)}
        start = f"weights/{g}/"
        for i in range(about["layers"]):
            out = arrays[f"{start}layer_{i}/bias"].size
            wanted |= {f"{start}layer_{i}/kernel": (width, out), f"{start}layer_{i}/bias": (out,)}
            width = out
        if memory:
            wanted |= {f"{start}gates/kernel": (width, 3 * memory), f"{start}gates/bias": (3 * memory,)}
            wanted |= {f"{start}recurrent": (memory, 3 * memory), f"{start}recurrent_bias": (memory,)}
            width = memory
        out = 2 * group["action_size"]
        wanted |= {f"{start}head/kernel": (width, out), f"{start}head/bias": (out,)}
        for name, shape in wanted.items():
            if arrays[name].shape != shape:
                raise ValueError(f"array {name!r} has the shape {arrays[name].shape}, not {shape}")
            if not np.isfinite(arrays[name]).all():
                raise ValueError(f"array {name!r} has numbers that are not finite")
        extra = [name for name in arrays if name.startswith(start) and name not in wanted]
        if extra:
            raise ValueError(f"array {extra[0][:60]!r} belongs to no layer")
