"""Recorded kernel launches of MuJoCo Warp's steps on a CPU, replayed by Warp's C++ code.

Python spends some 80 us on each of the 150 to 300 launches of a step, most of them on arguments that do not
change. A recording holds these, so it costs a hundredth. On GPUs CUDA graphs do the same.
"""

import dataclasses
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from importlib import import_module
from typing import Any, cast

MOST_RECORDINGS = 4
"""Recordings that are kept of a function: XLA alternates between few sets of buffers."""


class LaunchReplay:
    """A function whose kernel launches are recorded once for each set of arrays, and replayed.

    Warp calls functions of JAX programs one at a time, so no other launches get into a recording.

    Args:
        function: Launches kernels on a model and its data, whatever their values; returns nothing.
    """

    def __init__(self, function: Callable[[Any, Any], None]) -> None:
        self.function = function
        self._recordings: OrderedDict[Hashable, Any] = OrderedDict()  # None: met once, not recorded

    def run(self, model: object, data: object, count: int) -> None:
        """Call the function some times. Its first call with some arrays is a plain one, to load kernels."""
        warp = import_module("warp")
        key = tuple(_identity(model)) + tuple(_identity(data))
        if key not in self._recordings:
            self._recordings[key] = None
            self.function(model, data)
            count -= 1
        self._recordings.move_to_end(key)
        while len(self._recordings) > MOST_RECORDINGS:
            self._recordings.popitem(last=False)
        if count and self._recordings[key] is None:
            with warp.ScopedCapture("cpu") as capture:
                self.function(model, data)
            self._recordings[key] = capture.graph
        for _ in range(count):
            warp.capture_launch(self._recordings[key])


def _identity(value: Any) -> Iterator[Hashable]:  # noqa: ANN401 - of any field
    """Yield what a recording depends on: addresses and shapes of arrays, and all other values."""
    if hasattr(value, "ptr"):
        yield value.ptr
        yield value.shape
        yield value.strides
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _identity(getattr(value, field.name))
    elif isinstance(value, tuple | list):
        for one in cast("Sequence[object]", value):
            yield from _identity(one)
    else:
        yield value
