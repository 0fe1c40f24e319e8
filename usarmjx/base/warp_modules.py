"""Modules of Warp's kernels, compiled side by side before their first launch.

Warp compiles a module when the first of its kernels is launched, and the launches of a step come one after
another. Two of MuJoCo Warp's modules, of its convex collider, take most of the time.
"""

import logging
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Lock, get_ident
from typing import Any, NamedTuple

from usarmjx.base.errors import UsageError
from usarmjx.base.process import cores

log = logging.getLogger(__name__)


class WarpModule(NamedTuple):
    """Module of kernels for blocks of a given number of threads."""

    module: Any
    block_dim: int


_LOADING: list[Future[Any]] = []
_LOCK = Lock()


@contextmanager
def _replaced(owner: Any, **others: Callable[..., object]) -> Generator[None]:  # noqa: ANN401 - Warp's
    """Replace functions in this thread; a step of another batch may run meanwhile, in a thread of XLA."""
    mine, usual = get_ident(), {name: getattr(owner, name) for name in others}

    def chosen(name: str) -> Callable[..., object]:
        def call(*args: object, **kwargs: object) -> object:
            return (others if get_ident() == mine else usual)[name](*args, **kwargs)

        return call

    for name in others:
        setattr(owner, name, chosen(name))
    try:
        yield
    finally:
        for name, function in usual.items():
            setattr(owner, name, function)


@contextmanager
def _recorded_loads() -> Generator[dict[WarpModule, None]]:
    """Record the modules that launches ask for, which load and launch nothing meanwhile."""
    asked: dict[WarpModule, None] = {}

    def record(module: Any, device: Any, block_dim: int | None = None) -> None:  # noqa: ANN401 - Warp's
        del device
        asked[WarpModule(module, module.options["block_dim"] if block_dim is None else block_dim)] = None

    # Conditions are results of kernels: a loop would not end.
    def once(_: object, while_body: Callable[..., object], stream: object = None, **given: object) -> None:
        del stream
        while_body(**given)

    def both(
        _: object,
        on_true: Callable[..., object] | None = None,
        on_false: Callable[..., object] | None = None,
        stream: object = None,
        **given: object,
    ) -> None:
        del stream
        for branch in (on_true, on_false):
            if branch is not None:
                branch(**given)

    # The numbers of blocks of some launches come from it; it would need the loaded kernel.
    def suggest(kernel: Any, device: Any = None) -> tuple[int, int]:  # noqa: ANN401 - Warp's
        record(kernel.module, device)
        return kernel.module.options["block_dim"], 1

    # A launch without a loaded module does nothing. Warp has no public place for it; its version is pinned.
    module = import_module("warp._src.context").Module
    with (
        _replaced(module, load=record),
        _replaced(
            import_module("warp"), capture_while=once, capture_if=both, get_suggested_block_size=suggest
        ),
    ):
        yield asked


def modules_of(run: Callable[[], object]) -> list[WarpModule]:
    """Return the modules of the kernels that a function launches, those with most code first.

    Args:
        run: Called once; its kernels are not launched, so that it must not depend on their results.
    """
    with _LOCK, _recorded_loads() as asked:
        run()
    return sorted(asked, key=_length, reverse=True)


def _length(one: WarpModule) -> int:
    """Return the length of the source of a module's kernels and all that they call."""
    seen: set[int] = set()
    left = [kernel.adj for kernel in one.module.kernels.values()]
    length = 0
    while left:
        adjoint = left.pop()
        if id(adjoint) in seen:
            continue
        seen.add(id(adjoint))
        length += len(adjoint.source or "")
        _, _, functions = adjoint.get_references()
        left += [function.adj for function in functions if getattr(function, "adj", None) is not None]
    return length


@contextmanager
def block_sizes_of_gpus() -> Generator[None]:
    """Let launches on a CPU keep the block sizes that they ask for, as on a GPU."""
    config = import_module("warp").config
    usual, config.enable_cpu_blocks = config.enable_cpu_blocks, True
    try:
        yield
    finally:
        config.enable_cpu_blocks = usual


def check_architectures(architectures: Sequence[int]) -> None:
    """Refuse compute capabilities, 90 for 9.0, that Warp cannot compile for.

    Raises:
        UsageError: Names one, and those that it can.
    """
    warp = import_module("warp")
    level, warp.config.log_level = warp.config.log_level, warp.LOG_ERROR
    # Its first use prints a banner on the standard output, which is for results.
    try:
        known = warp.get_cuda_supported_archs()
    finally:
        warp.config.log_level = level
    for one in architectures:
        if one not in known:
            raise UsageError(f"compute capability {one}: Warp compiles for {', '.join(map(str, known))}")


def compile_for(modules: Sequence[WarpModule], architectures: Sequence[int]) -> None:
    """Compile modules into Warp's cache for GPUs, none of which need be here, side by side.

    Args:
        modules: Found with `block_sizes_of_gpus`; one thread a block means that a launch asks for no size.
        architectures: Compute capabilities, 90 for 9.0.
    """
    sizes = dict[Any, set[int]]()
    for module, size in modules:
        sizes.setdefault(module, set()).add(size if size > 1 else module.options["block_dim"])
    with ThreadPoolExecutor(cores(), "warp module") as pool:
        for done in [pool.submit(_compile, module, known, architectures) for module, known in sizes.items()]:
            done.result()


def _compile(module: Any, sizes: set[int], architectures: Sequence[int]) -> None:  # noqa: ANN401 - Warp's
    warp = import_module("warp")
    for size in sorted(sizes):
        # The size is among the ingredients of a module's name in the cache.
        warp.set_module_options({"block_dim": size}, module)
        warp.compile_aot_module(module, arch=architectures, use_ptx=False)


def load_side_by_side(modules: list[WarpModule], device: Any) -> None:  # noqa: ANN401 - Warp's
    """Start to load modules on a device, as many at a time as there are cores; see `wait_for_modules`."""
    missing = [one for one in modules if (device.context, one.block_dim) not in one.module.execs]
    if not missing:
        return
    log.info("loading %d modules of Warp on %d cores", len(missing), cores())
    pool = ThreadPoolExecutor(max_workers=cores(), thread_name_prefix="warp module")
    # Longest first: the last one to finish should not be the last one to begin.
    with _LOCK:
        _LOADING.extend(pool.submit(one.module.load, device, one.block_dim) for one in missing)
    pool.shutdown(wait=False)


def wait_for_modules() -> None:
    """Wait until all modules are loaded that `load_side_by_side` began with.

    A module that cannot be compiled raises its error at its first launch, where Warp expects it.
    """
    for one in tuple(_LOADING):
        one.exception()
        with _LOCK, suppress(ValueError):  # another thread waits, too
            _LOADING.remove(one)
