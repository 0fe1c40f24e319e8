"""The array library that pure functions run on: JAX for batches, NumPy for single worlds.

A batch is traced and compiled: `xp` is `jax.numpy` then, as anywhere unless said otherwise. A world that
clients share must never wait for a compiler: inside `with numpy_backend():` the same functions run on NumPy,
at once, with the same random numbers. Both differ in the last bits of single precision only, as XLA fuses
products and sums (`tests/base/test_backend.py`).
"""

from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import numpy_arrays
from usarmjx.base.arrays import Array

T = TypeVar("T")
Params = ParamSpec("Params")
Params = ParamSpec("Params")
_on_numpy: ContextVar[bool] = ContextVar("on_numpy", default=False)


@contextmanager
def numpy_backend() -> Generator[None]:
    """Run pure functions on NumPy: nothing is traced or compiled inside. It holds for this thread alone.

    Numbers that are not finite are no cause for warnings, as in JAX.
    """
    token = _on_numpy.set(True)
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        _on_numpy.reset(token)


def on_numpy() -> bool:
    """Return whether pure functions run on NumPy now."""
    return _on_numpy.get()


class _ArrayFunctions:
    """The array functions of the library in force."""

    def __getattribute__(self, name: str) -> Any:  # noqa: ANN401 - whatever the library has
        return getattr(numpy_arrays if _on_numpy.get() else jnp, name)


if TYPE_CHECKING:
    xp = jnp
else:
    xp = _ArrayFunctions()


def named_scope(name: str) -> "_NamedScope":
    """Name a part of a tick in profiles of compiled code: a context, or a decorator. Nothing on NumPy."""
    return _NamedScope(name)


class _NamedScope(AbstractContextManager[None]):
    """What `named_scope` returns."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._scope: AbstractContextManager[Any] | None = None

    def __enter__(self) -> None:
        if not _on_numpy.get():
            self._scope = jax.named_scope(self._name)
            self._scope.__enter__()

    def __exit__(self, *error: Any) -> None:  # noqa: ANN401 - as of any context
        if self._scope is not None:
            self._scope.__exit__(*error)

    def __call__(self, function: Callable[Params, T]) -> Callable[Params, T]:
        @wraps(function)
        def named(*args: Params.args, **kwargs: Params.kwargs) -> T:
            if _on_numpy.get():
                return function(*args, **kwargs)
            with jax.named_scope(self._name):
                return function(*args, **kwargs)

        return named


def set_at(values: Array, index: Any, new: Any) -> Any:  # noqa: ANN401 - what indexes and is assigned
    """Return a copy of an array with `values[index] = new`."""
    if not _on_numpy.get():
        return jnp.asarray(values).at[index].set(new)
    copy = np.array(values)
    copy[index] = new
    return copy


Part: TypeAlias = tuple[np.ndarray, Any]
"""Places of rows, and what is there: an array that broadcasts to their shape."""


def set_rows(values: Array, *parts: Part) -> Any:  # noqa: ANN401 - an array of the library in force
    """Return a copy of an array (n, ...) with rows set, part by part.

    On JAX it is one gather: each write by itself would be a kernel on a GPU, and a loop on a CPU.
    """
    if _on_numpy.get():
        copy = np.array(values)
        for places, new in parts:
            copy[places] = new
        return copy
    values = jnp.asarray(values)
    rows, source = [values], np.arange(values.shape[0])
    for places, new in parts:
        source[places] = sum(row.shape[0] for row in rows) + np.arange(places.size).reshape(places.shape)
        new = jnp.broadcast_to(jnp.asarray(new, values.dtype), (*places.shape, *values.shape[1:]))
        rows.append(new.reshape(-1, *values.shape[1:]))
    return jnp.concatenate(rows).at[source].get(mode="promise_in_bounds")


def stop_gradient(values: T) -> T:
    """Return arrays that count as constants where something is differentiated; on NumPy nothing is."""
    return values if _on_numpy.get() else jax.lax.stop_gradient(values)


def fori_loop(count: int, body: Callable[[Any, T], T], start: T) -> T:
    """Return what becomes of a value by `body(i, value)` for i from 0 to count; on NumPy a loop."""
    if not _on_numpy.get():
        return jax.lax.fori_loop(0, count, body, start)
    value = start
    for i in range(count):
        value = body(i, value)
    return value


def jit(function: Callable[Params, T], static_argnames: tuple[str, ...] = ()) -> Callable[Params, T]:
    """Compile a function as `jax.jit` does; on NumPy it runs as it is."""
    compiled = jax.jit(function, static_argnames=static_argnames)

    @wraps(function)
    def run(*args: Params.args, **kwargs: Params.kwargs) -> T:
        return function(*args, **kwargs) if _on_numpy.get() else compiled(*args, **kwargs)

    return run


def vmap(function: Callable[..., T], in_axes: Any = 0) -> Callable[..., T]:  # noqa: ANN401 - as JAX has it
    """Map over leading axes as `jax.vmap` does; on NumPy a loop.

    Args:
        function: Of one row; returns a PyTree.
        in_axes: 0 for arguments that have the axis and None for those that are shared, or PyTree prefixes.
    """
    if not _on_numpy.get():
        return jax.vmap(function, in_axes)

    def looped(*args: Any) -> T:  # noqa: ANN401 - PyTrees
        given = cast(tuple[Any, ...], in_axes if isinstance(in_axes, tuple) else (in_axes,) * len(args))
        columns = [_rows(arg, axis) for arg, axis in zip(args, given, strict=True)]
        count = next(n for n, _ in columns if n is not None)
        results = [function(*(row(i) for _, row in columns)) for i in range(count)]
        if not results:
            raise ValueError("nothing to map over")
        if count == 1:
            return jax.tree.map(lambda leaf: np.asarray(leaf)[None], results[0])
        return jax.tree.map(lambda *leaves: np.array(leaves), *results)

    return looped


def _rows(arg: Any, axis: Any) -> tuple[int | None, Callable[[int], Any]]:  # noqa: ANN401 - PyTrees
    """Return how many rows an argument has (None: it is shared), and a function that gives one."""
    if axis is None:
        return None, lambda _: arg
    leaves, tree = jax.tree.flatten(arg)
    if axis == 0:
        mapped = [True] * len(leaves)
    else:
        prefix = jax.tree.map(lambda value: value is not None, axis, is_leaf=lambda value: value is None)
        mapped = jax.tree.leaves(
            jax.tree.map(lambda flag, part: jax.tree.map(lambda _: flag, part), prefix, arg)
        )
    count = next((len(leaf) for leaf, flag in zip(leaves, mapped, strict=True) if flag), None)

    def row(i: int) -> Any:  # noqa: ANN401 - a PyTree
        picked = [leaf[i] if flag else leaf for leaf, flag in zip(leaves, mapped, strict=True)]
        return jax.tree.unflatten(tree, picked)

    return count, row
