"""Casts that are saved where nobody wants them, also under `jax.vmap`."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from usarmjx.base.arrays import Array, Bool

T = TypeVar("T")


def cast_if_wanted(wanted: Bool[Array, ""] | None, cast: Callable[..., T], missed: T, *args: Any) -> T:  # noqa: ANN401
    """Return `cast(*args)` where that is wanted, else misses.

    Mapped over robots and worlds it is cast for all of them if any one wants it, and not at all if none does.
    (A plain `lax.cond` would become a select there, which always casts.)

    Args:
        wanted: Whether anybody wants to know (); None: yes.
        cast: A function of arrays only; it must not close over any that are traced.
        missed: What a miss is, a number for each array of its result.
        args: Its arguments.
    """
    if wanted is None:
        return cast(*args)
    hits = _cast_if_any(wanted, cast, missed, args)
    return jax.tree.map(lambda hit, miss: jnp.where(wanted, hit, miss), hits, missed)


def _cast_if_any(wanted: Array, cast: Callable[..., T], missed: T, args: tuple[Any, ...]) -> T:
    """Return what is cast, if any of many want it (...); else misses of the same shape."""
    cast = jax.jit(cast, inline=True)  # traced once: for its shapes, for its work, and for all maps

    @custom_vmap
    def run(wanted: Array, args: tuple[Any, ...]) -> T:
        shapes = jax.eval_shape(cast, *args)
        blank = jax.tree.map(lambda hit, miss: jnp.full(hit.shape, miss, hit.dtype), shapes, missed)
        return jax.lax.cond(jnp.any(wanted), lambda args: cast(*args), lambda _: blank, args)

    @run.def_vmap
    def run_mapped(size: int, batched: Any, wanted: Array, args: tuple[Any, ...]) -> tuple[T, Any]:  # noqa: ANN401
        axes = jax.tree.map(lambda mapped: 0 if mapped else None, batched[1])
        mapped = jax.vmap(cast, in_axes=axes, axis_size=size)
        # Not `run` again: an outer map calls this rule too, with one axis more on everything.
        hits = _cast_if_any(wanted, mapped, missed, args)
        return hits, jax.tree.map(lambda _: True, hits)

    return run(wanted, args)
