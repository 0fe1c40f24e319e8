"""A task of one's own, for `usarmjx train examples/own_task.py:Meet --out runs/meet` and the other commands.

Two robots meet, and know of each other where they are. docs/tutorial-task.md writes it step by step.
"""

from dataclasses import dataclass

import jax.numpy as jnp

from usarmjx.train import Policy, StepResult, Task


@dataclass(frozen=True, kw_only=True)
class Meet(Task):
    """Two robots meet; score: 1 once their origins are within `near` of each other [m]."""

    sensors: tuple = ("GroundTruth",)
    episode_steps: int = 100
    robot: str = "P2DX"
    near: float = 0.8

    @property
    def robots(self):
        return (self.robot, self.robot)

    def start(self, view, key):
        return {"gap": self.gap(view)}

    def gap(self, view):
        """Return the distance between the robots [m] ()."""
        one, other = view.robots(0).pos[:, :2]
        return jnp.linalg.norm(one - other)

    def observe(self, view, memory):
        pose = view.sensor(0, "GroundTruth")  # x, y, z, roll, pitch, yaw of each (2, 6)
        here, yaw = pose[:, :2], pose[:, 5]
        east, north = (here[::-1] - here).T
        ahead = east * jnp.cos(yaw) + north * jnp.sin(yaw)
        left = north * jnp.cos(yaw) - east * jnp.sin(yaw)
        return (jnp.stack([ahead, left], -1),)

    def evaluate(self, view, memory):
        gap = self.gap(view)
        met = gap < self.near
        nearer = memory["gap"] - gap
        return StepResult(
            memory={"gap": gap},
            reward=(jnp.full(2, nearer) + 2.0 * met,),
            terminated=met,
            score=met.astype(float),
            metrics={},
        )

    @staticmethod
    def baseline(env):
        """Return the baseline: `--baseline` plays it, `--set imitation_steps=200000` imitates it first."""

        def steer(carry, obs, key):
            ahead, left = obs[0][..., 0], obs[0][..., 1]
            turn = 0.3 * jnp.arctan2(left, ahead)
            speed = 0.3 * (jnp.cos(jnp.arctan2(left, ahead)) > 0.7)
            return carry, (jnp.stack([speed - turn, speed + turn], -1),)

        return Policy(initial_carry=jnp.zeros, act=steer)
