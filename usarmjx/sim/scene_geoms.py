"""What rays see of a scene beside its robots, resolved once: arrays in the form of `models.build.pieces`."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.cameras.paint import labels_of
from usarmjx.models.build.compose_arena import DOOR, LOOSE_PREFIX
from usarmjx.models.build.materials import materials_of, textures_of
from usarmjx.models.build.pieces import ray_primitives_of
from usarmjx.models.spec.arena import ArenaSpec


@dataclass(frozen=True, eq=False)
class GeomTable:
    """Pieces of geoms.

    Attributes:
        geom: Ids of the geoms that they belong to (n,).
        kind: MuJoCo types, or kinds of `models.build.pieces` (n,).
        pos: Positions [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: Size numbers [m] (n, 3).
        material: What they are made of; members of `spec.MATERIALS` (n,).
        rgb: Their colours (n, 3).
        label: What they are in a segmentation, see `cameras.paint` (n,).
        texture: Codes of what is on them, see `models.spec.textures` (n,).
    """

    geom: np.ndarray
    kind: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray
    material: np.ndarray
    rgb: np.ndarray
    label: np.ndarray
    texture: np.ndarray


@dataclass(frozen=True, eq=False)
class LooseGeoms:
    """Geoms of loose objects.

    Attributes:
        root_qpos: Qpos addresses of the objects' free joints (objects, 7).
        root_dof: Qvel addresses (objects, 6).
        owner: The object that each piece belongs to (n,).
        local: The pieces, in the frames of their objects.
    """

    root_qposadr: np.ndarray
    root_dof: np.ndarray
    owner: np.ndarray
    local: GeomTable


def fixed_geoms(model: mujoco.MjModel, arena: ArenaSpec, moved: Sequence[str]) -> GeomTable:
    """Return floor and arena as they are in the model, without the geoms that are data."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    names = [model.geom(i).name for i in range(model.ngeom)]
    left = (model.geom_bodyid < 2) & ~np.isin(names, list(moved))  # the world's own body and the arena's
    fixed = np.flatnonzero(left)
    return _geom_table(model, arena, fixed, data.geom_xpos[fixed], data.geom_xmat[fixed].reshape(-1, 3, 3))


def moved_geom_table(model: mujoco.MjModel, arena: ArenaSpec, moved: Sequence[str]) -> GeomTable:
    """Return the geoms that are data, in the axes of the arena, where the model has them."""
    geoms = np.array([model.geom(name).id for name in moved], int)
    return _geom_table(model, arena, geoms, model.geom_pos[geoms], _matrices(model.geom_quat[geoms]))


def loose_geoms(model: mujoco.MjModel, arena: ArenaSpec) -> LooseGeoms:
    """Return what of the scene lies loose."""
    names = [f"{LOOSE_PREFIX}{loose.name}" for loose in arena.loose]
    bodies = [model.body(name).id for name in names]
    mine = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    local = _geom_table(model, arena, mine, model.geom_pos[mine], _matrices(model.geom_quat[mine]))
    joints = [model.joint(name) for name in names]
    return LooseGeoms(
        root_qposadr=np.array([j.qposadr[0] + np.arange(7) for j in joints], int).reshape(-1, 7),
        root_dof=np.array([j.dofadr[0] + np.arange(6) for j in joints], int).reshape(-1, 6),
        owner=np.searchsorted(bodies, model.geom_bodyid[local.geom]),
        local=local,
    )


def door_qpos(model: mujoco.MjModel, arena: ArenaSpec) -> np.ndarray:
    """Return the qpos addresses of the doors' hinges (doors,)."""
    return np.array([model.joint(f"{DOOR}{door.name}").qposadr[0] for door in arena.doors], int)


def _matrices(quats: np.ndarray) -> np.ndarray:
    mats = np.zeros((len(quats), 9))
    for mat, quat in zip(mats, quats, strict=True):
        mujoco.mju_quat2Mat(mat, quat)
    return mats.reshape(-1, 3, 3)


def _geom_table(
    model: mujoco.MjModel, arena: ArenaSpec, geoms: np.ndarray, pos: np.ndarray, mat: np.ndarray
) -> GeomTable:
    pieces = ray_primitives_of(model, geoms, materials_of(model, arena))
    world_pos, world_mat = pieces.world_poses(pos, mat)
    return GeomTable(
        geom=geoms[pieces.geom],
        kind=pieces.kind,
        pos=np.asarray(world_pos, np.float32),
        mat=np.asarray(world_mat, np.float32),
        size=pieces.size,
        material=pieces.material,
        rgb=model.geom_rgba[geoms[pieces.geom], :3].astype(np.float32),
        label=labels_of(model, arena)[geoms[pieces.geom]],
        texture=textures_of(model, arena)[geoms[pieces.geom]],
    )
