"""Branches of a step of MuJoCo Warp: launches beside each other on a GPU.

Some kernels have few threads that take long: a hundred iterations of a collider or of an island's solver.
They leave most of a GPU idle, so what does not need their results runs beside them, on other streams. A CUDA
graph that captures these has branches. On a CPU, all launches are one after another.
"""

from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from usarmjx.base.warp_functions import with_globals
from usarmjx.engines.warp_near_boxes import near_collider

warp: Any = import_module("warp")
DRIVER = "mujoco.mjx.third_party.mujoco_warp._src.collision_driver"
"""Private; the version of MJX is pinned."""
BESIDE = True
"""Whether there are branches; `benchmarks.islands.speed` compares a step without them."""
STREAMS = 6
"""Streams of a device besides its current one."""


class Branches:
    """Streams for launches beside those of the device's current stream.

    Args:
        streams: The streams; none: all launches are on the current one.
    """

    def __init__(self, streams: list[Any]) -> None:
        self._streams, self._open = streams, list[Any]()

    def stream(self, which: int) -> Any:  # noqa: ANN401 - Warp's
        """Return a stream for launches that need what is launched so far; None: the current one."""
        if not self._streams:
            return None
        stream = self._streams[which % len(self._streams)]
        # An event in both directions (here and in `join`): a captured graph takes streams up by such waits
        # alone.
        stream.wait_stream(stream.device.stream)
        if stream not in self._open:
            self._open.append(stream)
        return stream

    def join(self) -> None:
        """Let later launches on the current stream wait for all others."""
        for stream in self._open:
            stream.device.stream.wait_stream(stream)
        self._open.clear()

    def __len__(self) -> int:
        """Return the number of streams."""
        return len(self._streams)


@cache
def _streams_of(device: str) -> Branches:
    return Branches([warp.Stream(device) for _ in range(STREAMS)])


def branches_of(device: Any) -> Branches:  # noqa: ANN401 - Warp's
    """Return the branches of a device. The first call must not be during the capture of a graph."""
    return _streams_of(device.alias) if BESIDE and device.is_cuda else Branches([])


def narrow_phase(m: Any, d: Any, context: Any) -> None:  # noqa: ANN401 - MuJoCo Warp's
    """Find contacts as MuJoCo Warp's function does, kinds of pairs of the convex collider beside others."""
    driver, branches, held, kinds = (
        import_module(DRIVER),
        branches_of(d.qpos.device),
        list[Any](),
        list[Any](),
    )

    def hold(make: Any) -> Any:  # noqa: ANN401
        def make_and_hold(*args: object, **kwargs: object) -> Any:  # noqa: ANN401
            held.append(make(*args, **kwargs))  # until other streams have read and written it
            return held[-1]

        return make_and_hold

    def launch(kernel: object, inputs: list[Any], **kwargs: object) -> None:
        scratch = {id(array) for array in held[1:]}  # the first is of counters, one for each kind
        if kinds:
            # Kinds that run at the same time would overwrite each other's scratch memory.
            inputs = [warp.empty_like(one) if id(one) in scratch else one for one in inputs]
        kinds.append(inputs)
        warp.launch(kernel, inputs=inputs, stream=branches.stream(len(kinds)), **kwargs)

    changed = {"launch": launch, "zeros": hold(warp.zeros), "empty": hold(warp.empty)}
    replaced: dict[str, Any] = {"ccd_kernel_builder": near_collider}
    if len(branches):
        replaced["wp"] = SimpleNamespace(**vars(warp) | changed)
    # The undecorated function: a wrapper's globals are those of the decorator's module.
    convex = with_globals(driver.convex_narrowphase.__wrapped__, **replaced)
    with_globals(driver._narrowphase, convex_narrowphase=convex)(m, d, context)
    branches.join()
