"""Facts about a world that critics of teams see, against sums over squares."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np

from usarmjx.train.tasks.critic_features import VICTIM_NUMBERS, coarse, victim_features


def test_a_block_shows_the_share_of_its_squares():
    """Of 5 x 7 squares in 2 x 2 blocks of 3 x 4; squares beyond the map count as empty."""
    mask = np.random.default_rng(0).random((5, 7)) < 0.5
    found = np.asarray(coarse(jnp.asarray(mask), 2))
    parts = [[mask[i : i + 3, j : j + 4].sum() / 12 for j in (0, 4)] for i in (0, 3)]
    np.testing.assert_allclose(found, parts, rtol=1e-6)


def test_a_victim_is_shown_by_its_place_and_by_all_who_know_it():
    """Two robots; the third victim is none of this world."""
    arena = SimpleNamespace(extent=((-2.0, 6.0), (0.0, 4.0)))
    found = victim_features(
        arena,
        at=jnp.array([[0.0, 1.0], [6.0, 4.0], [1e6, 1e6]]),
        there=jnp.array([True, True, False]),
        reported=jnp.array([False, True, False]),
        known=jnp.array([[True, True, True], [False, True, True]]),
    )
    rows = np.asarray(found).reshape(3, VICTIM_NUMBERS + 2)
    np.testing.assert_array_equal(rows, [[1, 0.25, 0.25, 0, 1, 0], [1, 1, 1, 1, 1, 1], [0] * 6])
