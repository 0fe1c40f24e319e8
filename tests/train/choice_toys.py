"""Toys of robots that choose one of a set, and of robots that tell each other what to choose.

The right choice has a closed form.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from tests.train.toys import Toy
from usarmjx.train.envs.layout import ActionVector, ObservationLayout
from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.tasks.learned_vectors import LEVELS, quantised

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


SECRETS = 2
TALK = ObservationLayout(own=SECRETS, others=(1, 2), choices=(SECRETS + 2, 1), kinds=(*range(SECRETS), 3, 4))
"""Own secret; the other robot: whether there is one, and what came; secrets to name, silence, to speak."""


class WhisperToy(Toy):
    """Two robots are to name each other's secret, one of two, of which nothing but a vector can tell.

    In the first step they may stay silent or send a number, as robots of `learned_vectors` do, in the second
    they name a secret. Deaf robots hear 0: nobody is right in more than half. Score: the share that is right.
    """

    name, episode_steps, privileged_size = "whisper-toy", 2, 2
    groups = (AgentGroup("A", ("a0", "a1"), TALK.size, SECRETS + 3, True, TALK, ActionVector(1, 1)),)

    def __init__(self, *args, deaf=False, **more):
        self.deaf = deaf
        super().__init__(*args, **more)

    def start(self, key):
        return {"secret": jax.random.randint(key, (2,), 0, SECRETS), "heard": jnp.zeros(2)}

    def see(self, x, time):
        own, other = jax.nn.one_hot(x["secret"], SECRETS), jnp.stack([jnp.ones(2), x["heard"] / LEVELS], -1)
        names = jnp.broadcast_to(time > 0, (2, SECRETS))
        there = jnp.concatenate([names, jnp.broadcast_to(time == 0, (2, 2))], -1)
        return (jnp.concatenate([own, other, jnp.zeros((2, SECRETS + 2)), there], -1),), x["secret"] / SECRETS

    def go(self, x, time, actions):
        choice, number = actions[0][:, :-1].argmax(-1), actions[0][:, -1]
        speaks = (choice == SECRETS + 1) & (time == 0) & (not self.deaf)
        right = ((choice == x["secret"][::-1]) & (time == 1)).astype(jnp.float32)
        heard = jnp.where(speaks, quantised(number), 0.0)[::-1]
        team = jnp.broadcast_to(right.mean(), (2,))
        no = jnp.zeros((), bool)
        return {**x, "heard": heard}, (team,), no, right.mean(), no
