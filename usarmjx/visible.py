"""What rays can hit in a world: floor and arena, loose objects, doors, and the robots in use.

Pure functions of one world. What belongs to a robot carries its slot, all else -1.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.engines.base import PhysicsState
from usarmjx.models.arena_set import Site
from usarmjx.models.doors import door_boxes
from usarmjx.models.plan import Bodies, geom_poses
from usarmjx.models.spec import OPAQUE
from usarmjx.rotations import mat_from_quat
from usarmjx.scene import Scene
from usarmjx.scene_geoms import Look
from usarmjx.sensors.raycast import FAR_AWAY, Geoms, gather
from usarmjx.site import places
from usarmjx.transforms import Array

BOX = int(mujoco.mjtGeom.mjGEOM_BOX)


class Rows(NamedTuple):
    """Some geoms: kinds (n,) and materials (n,) as numpy arrays, the others as in `raycast.Block`."""

    kind: np.ndarray
    pos: Array
    mat: Array
    size: Array
    owner: Array
    material: np.ndarray


def collect(rows: Sequence[Rows]) -> Geoms:
    """Return rows as what rays are cast at."""
    kind, pos, mat, size, owner, material = zip(*rows, strict=True)
    # Kept as arrays: else XLA works out the poses of all geoms again for every ray, and compiles for minutes.
    joined = jax.lax.optimization_barrier([jnp.concatenate(part) for part in (pos, mat, size, owner)])
    return gather(np.concatenate(kind), *joined, np.concatenate(material).tolist())  # type: ignore - four


def arena_rows(scene: Scene, site: Site | None, time: jax.Array) -> list[Rows]:
    """Return floor and arena, victims included, at a time [s] ()."""
    rows = [_rows(scene.fixed_look)]
    here = places(scene, site, time)
    if here is not None:
        look = scene.moved_look
        size = look.size if here.size is None else here.size
        lift = jnp.array([0.0, 0.0, scene.arena.floor])
        rows.append(_rows(look, here.pos + lift, mat_from_quat(here.quat), size))
    return rows


def loose_rows(scene: Scene, physics: PhysicsState) -> Rows:
    """Return the loose objects."""
    loose = scene.loose_geoms
    root = physics.qpos[loose.root_qpos]
    turn = mat_from_quat(root[:, 3:])[loose.owner]
    pos = root[loose.owner, :3] + jnp.einsum("gij,gj->gi", turn, loose.local.pos)
    return _rows(loose.local, pos, turn @ loose.local.mat)


def door_rows(scene: Scene, physics: PhysicsState) -> Rows:
    """Return the doors as they stand."""
    pos, mat, size = door_boxes(scene.arena, physics.qpos[scene.door_qpos], jnp)
    n = len(size)
    kind, material = np.full(n, BOX), np.full(n, OPAQUE, object)
    return Rows(kind, pos, mat, jnp.asarray(size), jnp.full(n, -1), material)


def robot_rows(scene: Scene, bodies: Sequence[Bodies], active: Sequence[jax.Array]) -> list[Rows]:
    """Return the robots, by team; those that are not in use are far away."""
    rows = []
    for team, body, used in zip(scene.teams, bodies, active, strict=True):
        plan, n, g = team.plan, len(team.slots), len(team.plan.geom_type)
        pos, mat = jax.vmap(partial(geom_poses, plan))(body)
        rows.append(
            Rows(
                kind=np.tile(plan.geom_type, n),
                pos=jnp.where(used[:, None, None], pos, FAR_AWAY).reshape(-1, 3),
                mat=mat.reshape(-1, 3, 3),
                size=jnp.tile(plan.geom_size, (n, 1)),
                owner=jnp.repeat(jnp.asarray(team.slots), g),
                material=np.full(n * g, OPAQUE, object),
            )
        )
    return rows


def _rows(look: Look, pos: Array = None, mat: Array = None, size: Array = None) -> Rows:
    """Return geoms that are no robot's, where the scene has them or elsewhere."""
    return Rows(
        kind=look.kind,
        pos=jnp.asarray(look.pos if pos is None else pos),
        mat=jnp.asarray(look.mat if mat is None else mat),
        size=jnp.asarray(look.size if size is None else size),
        owner=jnp.full(len(look.kind), -1),
        material=look.material,
    )
