"""Random maps of teams that ways are looked for in."""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.train.mapping.wavefront import UNREACHABLE

TEAMS, ROBOTS = 3, 4


def mazes(shape: tuple[int, int]) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return mazes with starts of different worth and tolls, and squares that are asked for.

    Returns:
        Starts, which squares are open, tolls (TEAMS, ROBOTS, i, j), and squares (TEAMS, ROBOTS, 2).
    """
    rng = np.random.default_rng(0)
    all_of = (TEAMS, ROBOTS, *shape)
    open_ = rng.random(all_of) > 0.35
    start = np.where(rng.random(all_of) < 0.02, rng.uniform(0, 20, all_of), UNREACHABLE).astype(np.float32)
    start[0, 0] = UNREACHABLE  # no way begins anywhere
    toll = rng.choice([0.0, 6.0], all_of).astype(np.float32)
    until = np.stack([rng.integers(0, n, (TEAMS, ROBOTS)) for n in shape], -1)
    return tuple(map(jnp.asarray, (start, open_, toll, until)))
