"""Warp kernels as functions of JAX arrays, with launch ids that are equal in all processes.

Warp numbers the launches of a traced program in the order of tracing, so that a stored program is meaningless
in another process. Here a launch's id is a digest of its content: with the list of its launches, a stored
program runs in a process that has traced nothing (`program_cache`).

XLA calls back while it captures a CUDA graph. The collector may run there and free compiled programs of
batches that are no longer used; unloading these is illegal during a capture, and the program that is being
captured fails with CUDA error 901.
"""

import gc
import hashlib
import logging
from collections.abc import Callable, Iterable
from functools import cache, wraps
from importlib import import_module
from importlib.util import find_spec
from threading import Event, Lock
from types import FunctionType, SimpleNamespace
from typing import Any, NamedTuple

import jax

from usarmjx.base.installation import install_command
from usarmjx.base.warp_modules import wait_for_modules

_LOCK = Lock()
"""Guards the launch table and Warp's own counter."""


class _Pause:
    """Pause of the collector for as long as any callback runs, in whatever thread."""

    def __init__(self) -> None:
        self._lock, self._running, self._was_enabled = Lock(), 0, False

    def __enter__(self) -> None:
        with self._lock:
            # Counted: callbacks of several threads overlap, and only the first and the last switch.
            if not self._running:
                self._was_enabled = gc.isenabled()
                # A collection could unload compiled programs, which is illegal while XLA captures a CUDA
                # graph.
                gc.disable()
            self._running += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._running -= 1
            if not self._running and self._was_enabled:
                gc.enable()


_PAUSE = _Pause()


def without_collection(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Return a callback during which no garbage is collected."""

    @wraps(callback)
    def paused(*args: Any) -> Any:  # noqa: ANN401 - those of XLA
        with _PAUSE:
            return callback(*args)

    return paused


def once_loaded(callback: Callable[..., Any], registered: Event) -> Callable[..., Any]:
    """Return a callback that waits for the modules of kernels, unless XLA calls it while it registers it."""

    @wraps(callback)
    def waited(*args: Any) -> Any:  # noqa: ANN401 - those of XLA
        if registered.is_set():
            wait_for_modules()
        return callback(*args)

    return waited


def with_globals(function: Callable[..., None], **changed: object) -> Callable[..., Any]:
    """Return a copy of a function in which some globals of its module are replaced."""
    # A copy of the globals: the original module and everybody else's calls stay as they are.
    seen = {**function.__globals__, **changed}
    copied = FunctionType(function.__code__, seen, function.__name__, function.__defaults__)
    copied.__annotations__, copied.__module__ = function.__annotations__, function.__module__
    return copied


@cache
def pause_collection_in_callbacks() -> None:
    """Let all kernels that are made from now on call back without the collector."""
    # Warp has no public place for it; its version is pinned.
    ffi: Any = import_module("warp._src.jax.ffi")
    register: Callable[..., Any] = ffi._register_ffi_targets

    def register_paused(name: str, callback: Callable[..., Any]) -> Any:  # noqa: ANN401 - Warp's own
        registered = Event()
        try:
            return register(name, once_loaded(without_collection(callback), registered))
        finally:
            registered.set()

    ffi._register_ffi_targets = register_paused


class Launch(NamedTuple):
    """Launch of a kernel within a traced program.

    Attributes:
        maker: Module and name of the function that returns the `WarpFunction`.
        given: Arguments of that function.
        target: XLA's name of the kernel.
        static: Non-array arguments of the kernel, in order.
        dims: Number of threads.
    """

    maker: tuple[str, str]
    given: tuple[Any, ...]
    target: str
    static: tuple[Any, ...]
    dims: int

    @property
    def number(self) -> int:
        """Launch id in compiled programs, 31 bits."""
        return int.from_bytes(hashlib.blake2b(repr(tuple(self)).encode(), digest_size=4).digest()) >> 1


_LAUNCHES: dict[int, Launch] = {}
"""All launches of this process, by id."""


class WarpFunction:
    """Warp kernel as a function of JAX arrays.

    Args:
        maker: See `Launch`.
        given: See `Launch`.
        kernel: Result of Warp's `jax_kernel`.
    """

    def __init__(self, maker: tuple[str, str], given: tuple[Any, ...], kernel: Any) -> None:  # noqa: ANN401 - Warp's own
        self._maker, self._given, self._kernel = maker, given, kernel

    def __call__(self, *args: Any, output_dims: int, launch_dims: int) -> Any:  # noqa: ANN401 - arrays and numbers
        """Launch the kernel and return its outputs, a tuple of arrays.

        Args:
            args: Inputs of the kernel.
            output_dims: Length of each output.
            launch_dims: Number of threads.
        """
        static = tuple(value for value, known in zip(args, self._inputs, strict=True) if not known.is_array)
        launch = Launch(self._maker, self._given, self._kernel.name, static, launch_dims)
        with _LOCK:  # Warp increments launch_id after the call
            # 31 bits may collide: a wrong launch would run silently.
            if _LAUNCHES.setdefault(launch.number, launch) != launch:
                raise RuntimeError(f"{launch} and {_LAUNCHES[launch.number]} have the same number")
            # Ids from the content instead of a counter: a cached program finds its launch in another process.
            self._kernel.launch_id = launch.number
            return self._kernel(*args, output_dims=output_dims, launch_dims=launch_dims)

    @property
    def _inputs(self) -> list[Any]:
        return self._kernel.input_args

    @property
    def target(self) -> str:
        """XLA's name of the kernel."""
        return self._kernel.name

    def expect(self, launch: Launch) -> None:
        """Register a launch of a program that another process has traced.

        Raises:
            ValueError: XLA's name of the kernel differs in this process.
        """
        import warp as wp

        if launch.target != self.target:
            raise ValueError(f"the kernel {launch.target} is {self.target} here")
        names = [known.name for known in self._inputs if not known.is_array]
        kinds = [known.type for known in self._inputs if not known.is_array]
        static = {n: kind(value) for n, kind, value in zip(names, kinds, launch.static, strict=True)}
        with _LOCK:
            _LAUNCHES[launch.number] = launch
            self._kernel.launch_descriptors[launch.number] = SimpleNamespace(
                static_inputs=static, launch_dims=(launch.dims,)
            )
        # Now and not at the first launch, which may be within the capture of a CUDA graph.
        wp.load_module(self._kernel.kernel.module, block_dim=self._kernel.block_dim)


def warp_function(make: Callable[..., Any]) -> Callable[..., WarpFunction]:
    """Turn a module-level function that returns a JAX kernel into one that returns its `WarpFunction`.

    The result is cached by arguments, which are numbers and texts.
    """

    @cache
    @wraps(make)
    def made(*given: Any) -> WarpFunction:  # noqa: ANN401 - the function's own
        pause_collection_in_callbacks()
        return WarpFunction((make.__module__, make.__qualname__), given, make(*given))

    return made


def targets() -> set[str]:
    """Return XLA's names of the kernels that programs of this process launch."""
    with _LOCK:
        return {launch.target for launch in _LAUNCHES.values()}


def launches(numbers: Iterable[int]) -> list[Launch]:
    """Return the launches with the given ids; unknown ids are skipped (launches of MuJoCo Warp, for one)."""
    with _LOCK:
        return [_LAUNCHES[number] for number in sorted(set(numbers)) if number in _LAUNCHES]


def expect(known: Iterable[Launch]) -> None:
    """Register the launches of programs that other processes have traced.

    Raises:
        ValueError: See `WarpFunction.expect`.
        AttributeError: The kernel no longer exists.
    """
    for launch in known:
        module, name = launch.maker
        getattr(import_module(module), name)(*launch.given).expect(launch)


log = logging.getLogger(__name__)


@cache
def warp_in_use() -> bool:
    """Return whether kernels of Warp replace plain JAX: on GPUs where Warp is installed.

    They cast rays, count the radio's walls, find ways over maps and what is around robots of engine `planar`,
    and keep these apart.
    """
    if jax.default_backend() != "gpu":
        return False
    # Looked for, not imported: the import takes seconds.
    if find_spec("warp") is None:
        log.warning(
            "Warp is not installed: plain JAX casts rays on this GPU, which is slow; %s installs it",
            install_command("cuda"),
        )
        return False
    return True
