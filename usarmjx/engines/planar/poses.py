"""Where the bodies are that are no robot's: fixed, on a hinge as doors, or lying loose."""

from dataclasses import dataclass

import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import set_rows
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.rotations import mat_from_quat, matmul

FREE, HINGE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_HINGE)


@dataclass(frozen=True, eq=False)
class FixedBodies:
    """Bodies that stay where qpos has them.

    Attributes:
        pos: Origins of all bodies of the model at rest [m] (nbody, 3).
        mat: Their orientations (nbody, 3, 3).
        free: Bodies that lie loose (n,).
        free_qpos: Where in qpos they are (n, 7).
        hinged: Bodies on a hinge (n,).
        hinge_qpos: Where in qpos their angles are (n,).
        axis: Their axes, in their own axes (n, 3).
    """

    pos: np.ndarray
    mat: np.ndarray
    free: np.ndarray
    free_qpos: np.ndarray
    hinged: np.ndarray
    hinge_qpos: np.ndarray
    axis: np.ndarray

    @property
    def movable(self) -> np.ndarray:
        """Bodies that need not be where they are at rest (n,)."""
        return np.concatenate([self.free, self.hinged])

    def poses(self, qpos: Array) -> tuple[Array, Array]:
        """Return origins (nbody, 3) and orientations (nbody, 3, 3) of the bodies; of robots those at rest."""
        pos, mat = jnp.asarray(self.pos, jnp.float32), jnp.asarray(self.mat, jnp.float32)
        if len(self.free):
            here = qpos[self.free_qpos]
            pos = set_rows(pos, (self.free, here[:, :3]))
            mat = set_rows(mat, (self.free, mat_from_quat(here[:, 3:])))
        if len(self.hinged):
            half = qpos[self.hinge_qpos][:, None] / 2
            turn = mat_from_quat(jnp.concatenate([jnp.cos(half), jnp.sin(half) * self.axis], -1))
            mat = set_rows(mat, (self.hinged, matmul(mat[self.hinged], turn)))
        return pos, mat


def fixed_bodies(model: mujoco.MjModel, robot_bodies: set[int]) -> FixedBodies:
    """Return the bodies of a model that are no robot's.

    Raises:
        UnsupportedFeatureError: One hangs on a joint that this engine does not know.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    joints = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) not in robot_bodies]
    free = [j for j in joints if model.jnt_type[j] == FREE]
    hinges = [j for j in joints if model.jnt_type[j] == HINGE]
    strange = set(joints) - set(free) - set(hinges)
    strange |= {
        j for j in hinges if np.any(model.jnt_pos[j]) or model.body_parentid[model.jnt_bodyid[j]] != 0
    }
    if strange:
        names = ", ".join(repr(model.joint(j).name) for j in sorted(strange)[:4])
        raise UnsupportedFeatureError(
            f"engine 'planar' cannot run this scene: joints {names}: of what is no robot it knows bodies "
            "that are fixed, that lie loose, or that turn on one hinge"
        )
    return FixedBodies(
        pos=data.xpos.copy(),
        mat=data.xmat.reshape(-1, 3, 3).copy(),
        free=model.jnt_bodyid[free],
        free_qpos=model.jnt_qposadr[free][:, None] + np.arange(7),
        hinged=model.jnt_bodyid[hinges],
        hinge_qpos=model.jnt_qposadr[hinges],
        axis=model.jnt_axis[hinges],
    )
