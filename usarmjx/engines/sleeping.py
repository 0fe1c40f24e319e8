"""Loose objects that lie still sleep on engine `warp`: they have no contacts until something comes near.

MuJoCo Warp's own sleeping needs the Newton solver. Here a margin far below 0, which MuJoCo adds to that of
whatever is beside a geom, lets neither broad phase nor solver find a contact of what sleeps; it has no weight
meanwhile, and no velocity.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from usarmjx.base.arrays import Array
from usarmjx.models.build.compose_arena import LOOSE_PREFIX, VICTIM_PREFIX

STILL_TIME = 0.5
"""An object falls asleep when it has been still for so long [s]: longer than at the top of a throw."""
NEAR = 0.1
"""What comes nearer than that wakes it, from one bounding sphere to the other [m] ..."""
STEPS_AHEAD = 2.0
"""... and what will be as near after so many control steps."""
LIMB_SPEED = 1.0
"""At which limbs of victims and doors are taken to move [m/s]."""
NO_CONTACT = -1e3
"""Margin of the geoms of what sleeps [m]."""


class LooseSleep:
    """Which loose objects sleep.

    How long each has been still is in MuJoCo's data for users (worlds, objects) [control steps]: `make_room`
    asks for that before the model is compiled.

    Args:
        model: The engine's model.
        tolerance: An object that moves slower is still [m/s]; turning counts by the speed of what is farthest
            from its middle.
        period: The control step [s].
    """

    def __init__(self, model: mujoco.MjModel, tolerance: float, period: float) -> None:
        self._tolerance, self._period = tolerance, period
        self.bodies = np.array([b for b in range(model.nbody) if _is_loose(model, b)], int)
        joints = model.body_jntadr[self.bodies]
        self.qposadr = model.jnt_qposadr[joints][:, None] + np.arange(7)
        self.dofadr = model.jnt_dofadr[joints][:, None] + np.arange(6)
        touching = (model.geom_contype | model.geom_conaffinity) != 0
        body = model.geom_bodyid
        self.geoms = np.flatnonzero(touching & np.isin(body, self.bodies))
        self._owner = np.searchsorted(self.bodies, body[self.geoms])
        limbs = [model.geom(g).name.startswith(VICTIM_PREFIX) for g in range(model.ngeom)]
        moves = (model.body_weldid[body] != 0) & ~np.isin(body, self.bodies)
        self._movers = np.flatnonzero(touching & (moves | limbs))
        # The free joint of the robot that a geom is of; those of limbs and doors have none.
        roots = model.body_jntadr[model.body_rootid[body[self._movers]]]
        free = (roots >= 0) & (model.jnt_type[roots] == mujoco.mjtJoint.mjJNT_FREE)
        self._mover_dof = np.where(free, model.jnt_dofadr[roots], -1)
        radius = model.geom_rbound.astype(np.float32)
        self._reach = radius[self.geoms][:, None] + radius[self._movers] + np.float32(NEAR)
        self._between = radius[self.geoms][:, None] + radius[self.geoms] + np.float32(NEAR)
        # Of each object, for how fast its turning is.
        self._radius = np.zeros(len(self.bodies), np.float32)
        np.maximum.at(self._radius, self._owner, radius[self.geoms])

    def still_steps(self, data: mjx.Data, force: Array) -> jax.Array:
        """Return for how long each object has been still, this control step included (worlds, objects).

        Args:
            data: The engine's state, of all worlds.
            force: Forces and torques from outside on each body (worlds, nbody, 6).
        """
        qvel, xpos = data.qvel, data.geom_xpos
        own = qvel[:, self.dofadr]
        speed = jnp.linalg.norm(own[..., :3], axis=-1)
        speed += self._radius * jnp.linalg.norm(own[..., 3:], axis=-1)
        moving = ~(speed < self._tolerance)  # what is not finite moves
        moving |= (jnp.asarray(force)[:, self.bodies] != 0.0).any(-1)
        near = (self._apart(xpos, self._movers) < self._reach + self._ahead(qvel)[:, None]).any(-1)
        beside = (self._apart(xpos, self.geoms) < self._between) & moving[:, None, self._owner]
        disturbed = moving | self._any(near | beside.any(-1))
        return jnp.where(disturbed, 0.0, data.userdata + 1.0)

    def asleep(self, still_steps: jax.Array) -> jax.Array:
        """Return which objects sleep (worlds, objects)."""
        return still_steps * self._period > STILL_TIME

    def margin(self, margin: jax.Array, asleep: jax.Array) -> jax.Array:
        """Return the margins of all geoms (worlds, ngeom) [m], given those of the model (ngeom,)."""
        everywhere = jnp.broadcast_to(margin.reshape(-1), (len(asleep), margin.size))
        mine = jnp.where(asleep[:, self._owner], NO_CONTACT, everywhere[:, self.geoms])
        return everywhere.at[:, self.geoms].set(mine)

    def moved(self, pinned: Array, qpos: Array, before: Array) -> jax.Array:
        """Return which objects are put elsewhere (worlds, objects); masks and qpos as in `Inputs`."""
        return (jnp.asarray(pinned) & (qpos != before))[:, self.qposadr].any(-1)

    def _ahead(self, qvel: jax.Array) -> jax.Array:
        """Return how far the geoms of robots, limbs and doors may get soon [m] (worlds, movers)."""
        rows = np.maximum(self._mover_dof, 0)[:, None] + np.arange(3)
        speed = jnp.linalg.norm(qvel[:, rows], axis=-1)
        return STEPS_AHEAD * self._period * jnp.where(self._mover_dof >= 0, speed, LIMB_SPEED)

    def _apart(self, xpos: jax.Array, others: np.ndarray) -> jax.Array:
        """Return the distances between the objects' geoms and others (worlds, geoms, others) [m]."""
        return jnp.linalg.norm(xpos[:, self.geoms, None] - xpos[:, None, others], axis=-1)

    def _any(self, of_geoms: jax.Array) -> jax.Array:
        """Return of which objects any geom is so (worlds, objects)."""
        mine = jnp.asarray(self._owner == np.arange(len(self.bodies))[:, None])  # (objects, geoms)
        return (of_geoms[:, None] & mine).any(-1)


def make_room(spec: mujoco.MjSpec) -> None:
    """Ask for data for users, a number for each loose object of a description."""
    spec.nuserdata = sum(body.name.startswith(LOOSE_PREFIX) for body in spec.bodies)


def _is_loose(model: mujoco.MjModel, body: int) -> bool:
    return model.body(body).name.startswith(LOOSE_PREFIX)
