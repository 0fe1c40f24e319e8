"""Recorded kernel launches of MuJoCo Warp's steps on a CPU, replayed by Warp's C++ code.

Python spends some 80 us on each of the 150 to 300 launches of a step, most of them on arguments that do not
change. A recording holds these, so a launch costs a hundredth. On GPUs CUDA graphs do the same.
"""

import copy
import ctypes
import dataclasses
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, cast

MOST_RECORDINGS = 4
"""Recordings that are kept of a function, those used last: each has a copy of all worlds' data."""


@dataclass
class Recording:
    """Recorded launches on arrays of their own, into which and out of which each call copies.

    Attributes:
        model: Copy of the model, with arrays of its own.
        data: Likewise.
        copies: Addresses of these arrays in the order of `_arrays`, and their sizes [bytes].
        graph: The launches.
    """

    model: Any
    data: Any
    copies: list[tuple[int, int]]
    graph: Any = None


class LaunchReplay:
    """A function whose kernel launches are recorded once for each kind of arguments, and replayed.

    Arrays of JAX are at other addresses in each call, but a recording holds addresses: it works on copies.
    Warp calls functions of JAX programs one at a time, so no other launches get into a recording.

    Args:
        function: Launches kernels on a model, which it does not change, and its data, whatever their values.
    """

    def __init__(self, function: Callable[[Any, Any], None]) -> None:
        self.function = function
        self._recordings: OrderedDict[Hashable, Recording] = OrderedDict()

    def run(self, model: object, data: object, count: int) -> None:
        """Call the function some times. The first call with a kind of arguments is plain, to load kernels."""
        warp = import_module("warp")
        found = _Arguments()
        found.visit(model)
        constant = len(found.arrays)
        found.visit(data)
        recording = self._recordings.get(key := tuple(found.key))
        if recording is None:
            self.function(model, data)
            count -= 1
            recording = self._recordings[key] = _own_copies(model, data, found.arrays)
            with warp.ScopedCapture("cpu") as capture:
                self.function(recording.model, recording.data)
            recording.graph = capture.graph
        self._recordings.move_to_end(key)
        while len(self._recordings) > MOST_RECORDINGS:
            self._recordings.popitem(last=False)
        if not count:
            return
        for array, (address, size) in zip(found.arrays, recording.copies, strict=True):
            ctypes.memmove(address, array.ptr, size)
        for _ in range(count):
            warp.capture_launch(recording.graph)
        for array, (address, size) in zip(found.arrays[constant:], recording.copies[constant:], strict=True):
            ctypes.memmove(array.ptr, address, size)


@dataclass
class _Arguments:
    """The arrays of a function's arguments, without empty ones, and what else a recording depends on."""

    arrays: list[Any] = field(default_factory=list[Any])
    key: list[Hashable] = field(default_factory=list[Hashable])

    def visit(self, value: Any) -> None:  # noqa: ANN401 - of any field
        """Add what a value has."""
        if _is_array(value):
            self.key += (value.dtype, value.shape, value.strides, value.ptr is None)
            if value.ptr is not None:
                self.arrays.append(value)
        elif dataclasses.is_dataclass(value):
            for one in dataclasses.fields(value):
                self.visit(getattr(value, one.name))
        elif isinstance(value, tuple | list):
            for one in cast("Sequence[object]", value):
                self.visit(one)
        else:
            self.key.append(value)


def _is_array(value: object) -> bool:
    return hasattr(value, "ptr") and hasattr(value, "strides")


def _span(array: Any) -> int:  # noqa: ANN401 - Warp's
    """Return the memory from an array's first to its last number [bytes]; a stride may be 0."""
    item = import_module("warp").types.type_size_in_bytes(array.dtype)
    return (
        sum((length - 1) * stride for length, stride in zip(array.shape, array.strides, strict=True)) + item
    )


def _own_copies(model: object, data: object, arrays: list[Any]) -> Recording:
    """Return a recording without launches; fields that share an array share its copy."""
    warp, made = import_module("warp"), dict[tuple[Any, ...], Any]()

    def own(value: Any) -> Any:  # noqa: ANN401 - of any field
        if _is_array(value):
            if value.ptr is None:
                return value
            key = value.ptr, value.dtype, value.shape, value.strides
            if key not in made:
                memory = warp.empty(_span(value), dtype=warp.uint8, device="cpu")
                form = {"dtype": value.dtype, "shape": value.shape, "strides": value.strides}
                made[key] = warp.array(ptr=memory.ptr, device="cpu", **form)
                made[key].memory = memory  # kept as long as the array
            return made[key]
        if dataclasses.is_dataclass(value):
            changed = copy.copy(value)
            for one in dataclasses.fields(value):
                before = getattr(value, one.name)
                if (now := own(before)) is not before:
                    object.__setattr__(changed, one.name, now)  # some are frozen
            return changed
        if isinstance(value, tuple | list):
            parts = [own(one) for one in cast("Sequence[object]", value)]
            return parts if isinstance(value, list) else tuple(parts)
        return value

    mine = Recording(own(model), own(data), [])
    mine.copies = [(own(array).ptr, _span(array)) for array in arrays]
    return mine
