"""A gated recurrent unit over a sequence of steps (Cho et al. 2014), made to be differentiated on a GPU.

There a short sequence costs as many launches as it has small operations. So its gradient does at once, for
all steps, all that does not need the step after; what is left for each is a product and a few factors.

It is the variant with the reset gate behind the product: with r, u, n for reset, update and new, and
own = before @ weights, the carry after a step is (1 - u) n + u before, where n = tanh(n' + r (own_n + bias)),
and r and u are sigmoids of what comes in plus own.
"""

from typing import Any, TypeAlias, cast

import jax
import jax.numpy as jnp

from usarmjx.base.fusion import rounds_at_once

Residuals: TypeAlias = tuple[jax.Array, ...]
"""What `recur` was given, and what came out."""
GPU_STEPS = 8
"""So many steps are in a round of a loop over them on a GPU."""


def recur(
    gates: jax.Array, weights: jax.Array, bias: jax.Array, carry: jax.Array, is_first: jax.Array
) -> jax.Array:
    """Return the carry after each step (steps, worlds, robots, memory).

    It has a gradient of its own, and so cannot be differentiated in forward mode.

    Args:
        gates: What comes into reset, update and new gates, in this order (steps, worlds, robots, 3 memory).
        weights: From the carry to the gates (memory, 3 memory).
        bias: Of the new gate's product (memory,).
        carry: That before the first step (worlds, robots, memory).
        is_first: Whether the carry is reset before the step (steps, worlds).
    """
    return _recur(gates, weights, bias, carry, is_first)


def _in_turn(
    gates: jax.Array, weights: jax.Array, bias: jax.Array, carry: jax.Array, is_first: jax.Array
) -> jax.Array:
    def step(carry: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        gates, is_first = now
        before = _reset(is_first, carry)
        reset, update, new = jnp.split(gates, 3, axis=-1)
        own_reset, own_update, own_new = jnp.split(before @ weights, 3, axis=-1)
        update = jax.nn.sigmoid(update + own_update)
        new = jnp.tanh(new + jax.nn.sigmoid(reset + own_reset) * (own_new + bias))
        after = (1.0 - update) * new + update * before
        return after, after

    return jax.lax.scan(step, carry, (gates, is_first), unroll=rounds_at_once(GPU_STEPS))[1]


def _reset(where: jax.Array, carry: jax.Array) -> jax.Array:
    return jnp.where(where[..., None, None], 0.0, carry)


def _forward(*given: jax.Array) -> tuple[jax.Array, Residuals]:
    after = _in_turn(*given)
    return after, (*given, after)


def _backward(kept: Residuals, slopes: jax.Array) -> tuple[Any, ...]:
    """Return the gradient by what `recur` was given, from that by what came out."""
    gates, weights, bias, carry, is_first, after = kept
    before = _reset(is_first, jnp.concatenate([carry[None], after[:-1]]))
    own, new, update = _slopes_of_a_step(gates, before, before @ weights, bias)

    def step(later: jax.Array, now: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        slope, own, update, is_first = now
        slope = slope + later
        return _reset(is_first, (jnp.tile(slope, 3) * own) @ weights.T + slope * update), slope

    start, slopes = jax.lax.scan(
        step,
        jnp.zeros_like(carry),
        (slopes, own, update, is_first),
        reverse=True,
        unroll=rounds_at_once(GPU_STEPS),
    )
    by_own = jnp.tile(slopes, 3) * own
    by_reset, by_update, by_new = jnp.split(by_own, 3, axis=-1)
    return (
        jnp.concatenate([by_reset, by_update, slopes * new], axis=-1),
        jnp.tensordot(before, by_own, ((0, 1, 2), (0, 1, 2))),
        by_new.sum((0, 1, 2)),
        start,
        None,
    )


def _slopes_of_a_step(
    gates: jax.Array, before: jax.Array, own: jax.Array, bias: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return how the carry after each step changes with what it is made of, number by number.

    With the three parts of own (..., 3 memory), with what comes into the new gate (..., memory), and with
    the carry before it, own left as it is (..., memory).
    """
    own_reset, own_update, own_new = jnp.split(own, 3, axis=-1)
    reset, update, new = jnp.split(gates, 3, axis=-1)
    reset, update = jax.nn.sigmoid(reset + own_reset), jax.nn.sigmoid(update + own_update)
    own_new = own_new + bias
    new = jnp.tanh(new + reset * own_new)
    by_new = (1.0 - update) * (1.0 - new * new)
    by_reset = by_new * own_new * reset * (1.0 - reset)
    by_update = (before - new) * update * (1.0 - update)
    return jnp.concatenate([by_reset, by_update, by_new * reset], axis=-1), by_new, update


_recur = cast(Any, jax.custom_vjp)(_in_turn)  # jax leaves its types open
_recur.defvjp(_forward, _backward)
