"""Array library of the pure functions: JAX for batches, NumPy for single worlds.

A batch is traced and compiled: `xp` is `jax.numpy` by default. A world that clients share must never wait for
a compiler: inside `with numpy_backend():` the same functions run on NumPy without compilation, with the same
random numbers. The two differ only in the last bits of single precision, because XLA fuses products and sums
(`tests/base/test_backend.py`).

`jax_entry_points` guards the methods through which programs use JAX: single precision, and no forked process.

Annotations take the array types from here: `Float[Array, "worlds robots 3"]` is a float array of that shape.
The dimension names are those of the docstrings: worlds, robots (of a robot group unless stated otherwise),
joints, beams, geoms. Shapes are not checked at run time; `tests/test_shapes.py` compares the docstrings'
shapes with a built world.
"""

import os
import sys
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import wraps
from inspect import Signature, signature
from threading import Lock
from types import FunctionType
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeAlias, TypeVar, cast
from weakref import WeakKeyDictionary, ref

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from usarmjx.base import numpy_arrays
from usarmjx.base.errors import UsageError

T = TypeVar("T")
Owner = TypeVar("Owner")
Params = ParamSpec("Params")
Array: TypeAlias = jax.Array | np.ndarray
"""NumPy or JAX array; a function that accepts both takes the array module as an argument where it matters."""
ArrayLike: TypeAlias = Array | float
"""Array, or one number for all elements."""
Key: TypeAlias = PRNGKeyArray
"""JAX random key."""
_on_numpy: ContextVar[bool] = ContextVar("on_numpy", default=False)


@contextmanager
def numpy_backend() -> Generator[None]:
    """Run pure functions on NumPy in this thread: nothing inside is traced or compiled.

    As in JAX, non-finite numbers raise no warnings.
    """
    # A context variable: other threads, such as a server's, keep their own library.
    token = _on_numpy.set(True)
    try:
        # JAX never warns of NaN or infinity, and served worlds would fill the log.
        with np.errstate(all="ignore"):
            yield
    finally:
        _on_numpy.reset(token)


def on_numpy() -> bool:
    """Return whether pure functions currently run on NumPy."""
    return _on_numpy.get()


def known_all(flags: Any) -> bool:  # noqa: ANN401 - an array of booleans
    """Return whether all flags are set; False on JAX, where a traced value decides no branch."""
    # count_nonzero is faster than `all` on arrays this small.
    return _on_numpy.get() and np.count_nonzero(flags) == flags.size


def known_none(flags: Any) -> bool:  # noqa: ANN401 - an array
    """Return whether no flag is set, or all numbers are 0; False on JAX, as `known_all`."""
    return _on_numpy.get() and not np.count_nonzero(flags)


class _ArrayFunctions:
    """Array module that forwards every attribute to the active library."""

    def __getattribute__(self, name: str) -> Any:  # noqa: ANN401 - whatever the library has
        return getattr(numpy_arrays if _on_numpy.get() else jnp, name)


if TYPE_CHECKING:
    xp = jnp
    """Array functions of the active library: `jax.numpy`, or NumPy inside `numpy_backend()`."""
else:
    xp = _ArrayFunctions()


def named_scope(name: str) -> "_NamedScope":
    """Name a part of a tick in profiles of compiled code: context or decorator; no effect on NumPy."""
    return _NamedScope(name)


def single_precision(function: Callable[Params, T]) -> Callable[Params, T]:
    """Make a function compute in single precision, also where `jax_enable_x64` asks for double precision.

    Worlds are the same whatever precision other libraries in the process want.
    """

    @wraps(function)
    def run(*args: Params.args, **kwargs: Params.kwargs) -> T:
        if not cast(Any, jax.config).jax_enable_x64:
            return function(*args, **kwargs)
        with jax.enable_x64(False):
            return function(*args, **kwargs)

    return run


class _NamedScope(AbstractContextManager[None]):
    """Result of `named_scope`."""

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
"""Row indices of any shape, and the new rows: an array that broadcasts to that shape."""


MAX_RUNS = 16
"""Most blocks of successive rows that are joined: from more on a gather takes less."""


def get_rows(values: Array, places: np.ndarray) -> Any:  # noqa: ANN401 - an array of the library in force
    """Return the rows of an array (n, ...) at indices that are known beforehand (rows,).

    On JAX successive rows are a slice: a gather would be a kernel of its own on a GPU, and a copy.
    """
    beyond = places.size and (places[0] < 0 or places[-1] >= len(values))
    if _on_numpy.get() or not places.size or beyond or (np.diff(places) != 1).any():
        return values[places]
    return values[int(places[0]) : int(places[-1]) + 1]


def set_rows(values: Array, *parts: Part) -> Any:  # noqa: ANN401 - an array of the library in force
    """Return a copy of an array (n, ...) with rows replaced, part by part.

    On JAX a few blocks of successive rows are joined, many are one gather: separate writes would each be a
    kernel on a GPU and a loop on a CPU.
    """
    if _on_numpy.get():
        copy = np.array(values)
        for places, new in parts:
            copy[places] = new
        return copy
    values = jnp.asarray(values)
    # `owner` and `row` map each output row to an array, the old one or a part, and a row of that.
    rows, owner, row = [values], np.zeros(len(values), int), np.arange(len(values))
    for places, new in parts:
        owner[places], row[places] = len(rows), np.arange(places.size).reshape(places.shape)
        new = jnp.broadcast_to(jnp.asarray(new, values.dtype), (*places.shape, *values.shape[1:]))
        rows.append(new.reshape(-1, *values.shape[1:]))
    runs = np.split(np.arange(len(row)), np.flatnonzero(np.diff(owner) | (np.diff(row) != 1)) + 1)
    if len(runs) <= MAX_RUNS:
        blocks = [rows[owner[run[0]]][row[run[0]] : row[run[-1]] + 1] for run in runs if run.size]
        return jnp.concatenate(blocks) if len(blocks) > 1 else (blocks or rows)[0]
    starts = np.cumsum([0, *map(len, rows)])
    # The indices are constants that were made here, so bounds need no check.
    return jnp.concatenate(rows).at[starts[owner] + row].get(mode="promise_in_bounds")


def stop_gradient(values: T) -> T:
    """Return arrays that differentiation treats as constants; on NumPy, the arrays themselves."""
    return values if _on_numpy.get() else jax.lax.stop_gradient(values)


def fori_loop(count: int, body: Callable[[Any, T], T], start: T) -> T:
    """Apply `body(i, value)` for i in [0, count) and return the last value; on NumPy a Python loop."""
    if not _on_numpy.get():
        return jax.lax.fori_loop(0, count, body, start)
    value = start
    for i in range(count):
        value = body(i, value)
    return value


def jit(function: Callable[Params, T], static_argnames: tuple[str, ...] = ()) -> Callable[Params, T]:
    """Compile a function as `jax.jit` does; on NumPy, call it directly."""
    compiled = jax.jit(function, static_argnames=static_argnames)

    @wraps(function)
    def run(*args: Params.args, **kwargs: Params.kwargs) -> T:
        # Asked at each call: the same function serves both libraries.
        return function(*args, **kwargs) if _on_numpy.get() else compiled(*args, **kwargs)

    return run


def traced_once(
    *static_argnames: str,
) -> Callable[[Callable[Concatenate[Owner, Params], T]], Callable[Concatenate[Owner, Params], T]]:
    """Decorate a function to be traced once for each owner, its first argument, by all programs that call it.

    On NumPy it is called directly. Owners are compared by identity. The result must not refer to the owner,
    which would then never be deleted.

    Args:
        static_argnames: Names of the other arguments that are no arrays.
    """

    def decorate(
        function: Callable[Concatenate[Owner, Params], T],
    ) -> Callable[Concatenate[Owner, Params], T]:
        programs: WeakKeyDictionary[Owner, Callable[..., T]] = WeakKeyDictionary()
        guard = Lock()

        def of(owner: Owner) -> Callable[..., T]:
            # As a static argument, or by a strong reference, it would live as long as its program.
            known = cast("Callable[[], Owner]", ref(owner))

            def owned(*args: Params.args, **kwargs: Params.kwargs) -> T:
                return function(known(), *args, **kwargs)

            # JAX looks for the names of static arguments there.
            parameters = list(signature(function).parameters.values())[1:]
            owned.__signature__ = Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
            owned.__name__ = function.__name__
            return jax.jit(owned, static_argnames=static_argnames)

        @wraps(function)
        def run(owner: Owner, *args: Params.args, **kwargs: Params.kwargs) -> T:
            if _on_numpy.get():
                return function(owner, *args, **kwargs)
            # Threads may compile at once: all of them take the program of the first.
            with guard:
                program = programs.get(owner) or programs.setdefault(owner, of(owner))
            return program(*args, **kwargs)

        return run

    return decorate


def vmap(function: Callable[..., T], in_axes: Any = 0) -> Callable[..., T]:  # noqa: ANN401 - as JAX has it
    """Map over leading axes as `jax.vmap` does; on NumPy, loop.

    Args:
        function: Function of one row; returns a PyTree.
        in_axes: 0 for mapped arguments, None for shared ones, or PyTree prefixes of these.
    """
    if not _on_numpy.get():
        return jax.vmap(function, in_axes)

    def looped(*args: Any) -> T:  # noqa: ANN401 - PyTrees
        given = cast(tuple[Any, ...], in_axes if isinstance(in_axes, tuple) else (in_axes,) * len(args))
        columns = [_rows(arg, axis) for arg, axis in zip(args, given, strict=True)]
        # As `jax.vmap`: shared arguments have no count of their own.
        count = next(n for n, _ in columns if n is not None)
        results = [function(*(row(i) for _, row in columns)) for i in range(count)]
        if not results:
            # Without a row the structure of the result is unknown.
            raise ValueError("nothing to map over")
        # A view instead of a copy.
        if count == 1:
            return jax.tree.map(lambda leaf: np.asarray(leaf)[None], results[0])
        return jax.tree.map(lambda *leaves: np.array(leaves), *results)

    return looped


def _rows(arg: Any, axis: Any) -> tuple[int | None, Callable[[int], Any]]:  # noqa: ANN401 - PyTrees
    """Return the row count of an argument (None: shared) and a function that returns one row."""
    if axis is None:
        return None, lambda _: arg
    leaves, tree = jax.tree.flatten(arg)
    if axis == 0:
        mapped = [True] * len(leaves)
    else:
        # None is no leaf of JAX's trees: without a test of leaves shared arguments would vanish.
        prefix = jax.tree.map(lambda value: value is not None, axis, is_leaf=lambda value: value is None)
        mapped = jax.tree.leaves(
            jax.tree.map(lambda flag, part: jax.tree.map(lambda _: flag, part), prefix, arg)
        )
    count = next((len(leaf) for leaf, flag in zip(leaves, mapped, strict=True) if flag), None)

    def row(i: int) -> Any:  # noqa: ANN401 - a PyTree
        picked = [leaf[i] if flag else leaf for leaf, flag in zip(leaves, mapped, strict=True)]
        return jax.tree.unflatten(tree, picked)

    return count, row


Guarded = TypeVar("Guarded", bound=type)
FORKED = (
    "this process was forked from one in which JAX had started, and would hang: start it with 'spawn', as "
    "AsyncVectorEnv(..., context='spawn'), SubprocVecEnv(..., start_method='spawn') or "
    "DataLoader(..., multiprocessing_context='spawn')"
)


class _Process:
    """Whether this process can use JAX."""

    is_forked = False


def _note_fork() -> None:
    # A handler of a fork must not import anything: JAX may not be loaded at all.
    bridge = sys.modules.get("jax._src.xla_bridge")
    started = getattr(bridge, "backends_are_initialized", lambda: bridge is not None)
    # A fork of a fork stays unusable.
    _Process.is_forked = _Process.is_forked or bool(started())


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def check_not_forked() -> None:
    """Refuse a process that was forked after JAX had started: its threads are missing there.

    Raises:
        UsageError: It was; names the way out.
    """
    if _Process.is_forked:
        raise UsageError(FORKED)


def jax_entry_points(cls: Guarded) -> Guarded:
    """Guard the constructor and all methods that a class defines; a decorator.

    They compute in single precision whatever `jax_enable_x64` says, and raise a `UsageError` in a process
    that was forked after JAX had started.
    """
    # A list: the class's dictionary changes while it is gone through.
    for name, method in list(vars(cls).items()):
        if isinstance(method, FunctionType) and (name == "__init__" or not name.startswith("__")):
            setattr(cls, name, _guarded(method))
    return cls


def _guarded(method: FunctionType) -> FunctionType:
    precise, settings = single_precision(method), cast(Any, jax.config)

    @wraps(method)
    def run(*args: object, **kwargs: object) -> object:
        check_not_forked()
        # Every step comes here: another call would be a third of what the guard costs.
        return (precise if settings.jax_enable_x64 else method)(*args, **kwargs)

    return run  # type: ignore[return-value] - of the same signature
