"""Warp's kernels as functions of JAX arrays whose launches mean the same in every process.

Warp numbers the launches that are put into programs in the order in which they are traced, so that a program
says nothing to another process. Here a launch's number is a digest of what it is: with a list of its launches
a program that was kept can be used by a process that has traced nothing (`kept_programs`).
"""

import hashlib
from collections.abc import Callable, Iterable
from functools import cache, wraps
from importlib import import_module
from threading import Lock
from types import SimpleNamespace
from typing import Any, NamedTuple

_LOCK = Lock()


class Launch(NamedTuple):
    """A launch of a kernel within programs.

    Attributes:
        maker: Module and name of the function that returns the `WarpFunction`.
        given: What that is called with.
        target: Name under which XLA knows the kernel.
        static: The kernel's arguments that are no arrays, in their order.
        dims: Threads.
    """

    maker: tuple[str, str]
    given: tuple[Any, ...]
    target: str
    static: tuple[Any, ...]
    dims: int

    @property
    def number(self) -> int:
        """What stands for it in programs."""
        return int.from_bytes(hashlib.blake2b(repr(tuple(self)).encode(), digest_size=4).digest()) >> 1


_LAUNCHES: dict[int, Launch] = {}
"""All of this process, by their numbers."""


class WarpFunction:
    """A kernel as a function of JAX arrays.

    Args:
        maker: See `Launch`.
        given: See `Launch`.
        kernel: As Warp's `jax_kernel` returns it.
    """

    def __init__(self, maker: tuple[str, str], given: tuple[Any, ...], kernel: Any) -> None:  # noqa: ANN401 - Warp's own
        self._maker, self._given, self._kernel = maker, given, kernel

    def __call__(self, *args: Any, output_dims: int, launch_dims: int) -> Any:  # noqa: ANN401 - arrays and numbers
        """Return the kernel's outputs, a tuple of arrays.

        Args:
            args: The kernel's, but for its outputs.
            output_dims: Length of each output.
            launch_dims: Threads.
        """
        static = tuple(value for value, known in zip(args, self._inputs, strict=True) if not known.is_array)
        launch = Launch(self._maker, self._given, self._kernel.name, static, launch_dims)
        with _LOCK:  # Warp counts on from there
            if _LAUNCHES.setdefault(launch.number, launch) != launch:
                raise RuntimeError(f"{launch} and {_LAUNCHES[launch.number]} have the same number")
            self._kernel.launch_id = launch.number
            return self._kernel(*args, output_dims=output_dims, launch_dims=launch_dims)

    @property
    def _inputs(self) -> list[Any]:
        return self._kernel.input_args

    @property
    def target(self) -> str:
        """Name under which XLA knows the kernel."""
        return self._kernel.name

    def expect(self, launch: Launch) -> None:
        """Be ready for a launch by a program that another process has traced.

        Raises:
            ValueError: XLA knows the kernel by another name here.
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
        wp.load_module(self._kernel.kernel.module, block_dim=self._kernel.block_dim)


def warp_function(make: Callable[..., Any]) -> Callable[..., WarpFunction]:
    """Return a function that returns a kernel as JAX calls it as one that returns its `WarpFunction`.

    It must be one of a module. Both are made once for what it is called with: numbers and texts.
    """

    @cache
    @wraps(make)
    def made(*given: Any) -> WarpFunction:  # noqa: ANN401 - the function's own
        return WarpFunction((make.__module__, make.__qualname__), given, make(*given))

    return made


def targets() -> set[str]:
    """Return by which names XLA knows the kernels that programs of this process launch."""
    with _LOCK:
        return {launch.target for launch in _LAUNCHES.values()}


def launches(numbers: Iterable[int]) -> list[Launch]:
    """Return the launches with some numbers; others are someone else's."""
    with _LOCK:
        return [_LAUNCHES[number] for number in sorted(set(numbers)) if number in _LAUNCHES]


def expect(known: Iterable[Launch]) -> None:
    """Be ready for launches by programs that other processes have traced.

    Raises:
        ValueError: See `WarpFunction.expect`.
        AttributeError: There is no such kernel any more.
    """
    for launch in known:
        module, name = launch.maker
        getattr(import_module(module), name)(*launch.given).expect(launch)
