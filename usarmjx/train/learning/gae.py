"""Advantages of actions: generalised advantage estimation (Schulman et al. 2016), with care at the ends.

An episode that ended by itself is worth nothing afterwards; one that was cut off by the time limit would
have gone on, so the critic's value of its last state stands in for the rest. A bad transition counts for
nothing: its advantage is 0 and nothing is carried over it.
"""

import jax
import jax.numpy as jnp


def advantages(
    reward: jax.Array,
    value: jax.Array,
    bootstrap: jax.Array,
    last_value: jax.Array,
    ends: tuple[jax.Array, ...],
    discount: float,
    gae_lambda: float,
) -> jax.Array:
    """Return how much better than expected each action turned out.

    Args:
        reward: Of each step (steps, ...).
        value: The critic's value of the state that each step began in (steps, ...).
        bootstrap: That of the state before the reset, used where truncated (steps, ...).
        last_value: That of the state after the last step (...).
        ends: Whether the episode ended with the step, whether that was by time-out, and whether the
            transition is bad, each (steps, ...).
        discount: Of the next step's value.
        gae_lambda: Lambda: weight of what lies further ahead.
    """
    done, truncated, bad = ends
    following = jnp.concatenate([value[1:], last_value[None]])
    following = jnp.where(done, jnp.where(truncated, bootstrap, 0.0), following)
    td_error = jnp.where(bad, 0.0, reward + discount * following - value)
    keep = jnp.where(done | bad, 0.0, discount * gae_lambda)

    def back(later: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        now = step[0] + step[1] * later
        return now, now

    _, found = jax.lax.scan(back, jnp.zeros_like(last_value), (td_error, keep), reverse=True)
    return found
