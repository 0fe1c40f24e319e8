"""A toy of robots that choose one of a set; what to choose has a closed form."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from tests.train.toys import Toy
from usarmjx.train.envs.layout import ObservationLayout
from usarmjx.train.envs.state import AgentGroup

CHOICES = 5
PLAIN = ObservationLayout(own=1, others=(2, 2), choices=(CHOICES, 2), kinds=(0, 1, 1, 1, 1))
PICTURED = replace(PLAIN, picture=(1, 4, 1))


class ChoiceToy(Toy):
    """Two robots choose of five things; right is the largest number of those that are there.

    With a picture right is the largest where its left half is bright, else the smallest. Score: the share of
    the robots that are right in the last of four steps.
    """

    name, episode_steps, privileged_size = "choice-toy", 4, 1

    def __init__(self, *args, layout=PLAIN, **more):
        self.layout = layout
        self.groups = (AgentGroup("A", ("a0", "a1"), layout.size, CHOICES, True, layout),)
        super().__init__(*args, **more)

    def start(self, key):
        return {"key": key}

    def drawn(self, x, time):
        """Numbers of the choices, which there are, and whether the left half is bright, of both robots."""
        keys = jax.random.split(jax.random.fold_in(x["key"], time), 3)
        value = jax.random.normal(keys[0], (2, CHOICES))
        there = jax.random.bernoulli(keys[1], 0.7, (2, CHOICES)).at[:, 0].set(True)
        return value, there, jax.random.bernoulli(keys[2], 0.5, (2,))

    def see(self, x, time):
        value, there, left = self.drawn(x, time)
        number = jnp.where(there, value, 0.0)
        parts = [jnp.ones((2, 1)), jnp.zeros((2, 4)), jnp.stack([number, 0 * number], -1).reshape(2, -1)]
        if self.layout.picture_size.size:
            bright = (jnp.arange(4) < 2) == left[:, None]
            parts.append(jnp.broadcast_to(bright[:, None], (2, 4, 4)).reshape(2, -1))
        return (jnp.concatenate([*parts, there], -1).astype(jnp.float32),), jnp.zeros(1)

    def go(self, x, time, actions):
        value, there, left = self.drawn(x, time)
        sign = jnp.where(left | (not self.layout.picture_size.size), 1.0, -1.0)
        best = jnp.where(there, sign[:, None] * value, -jnp.inf).argmax(-1)
        right = (actions[0].argmax(-1) == best).astype(jnp.float32)
        no = jnp.zeros((), bool)
        return x, (right,), no, right.mean(), no
