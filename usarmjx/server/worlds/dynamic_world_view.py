"""What cameras see of a served world on C MuJoCo, as arrays with capacity to spare: see `dynamic_world`."""

from collections.abc import Mapping

import jax
import mujoco
import numpy as np

from usarmjx.cameras.light import SUN_DIRECTION, Headlights, point_lights
from usarmjx.cameras.mounts import headlight_of
from usarmjx.cameras.paint import (
    ROBOT_LABEL,
    WATER_LABEL,
    WATER_RGB,
    WATER_TRANSPARENCY,
    GeomAppearance,
    labels_of,
    reflectances,
    robot_geom_owner,
    transparencies,
)
from usarmjx.cameras.shading import RenderScene
from usarmjx.models.build.layout import RobotIndex
from usarmjx.models.build.pieces import RayPrimitives
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.models.spec.shapes import GLASS
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, BlockKey, GeomBlock, Geoms
from usarmjx.sim.views import CHECKER_SIZE, UNBOUNDED_EXTENT

WATER_KEY: BlockKey = (int(mujoco.mjtGeom.mjGEOM_BOX), GLASS)
MAX_HEADLIGHTS = 8
"""Headlights that can shine at once; of more, those in the lowest slots do."""

GeomColumns = dict[str, np.ndarray]
"""Geoms, by fields of `targets.GeomBlock` and `paint.GeomAppearance`: each has a leading axis over them."""


def dynamic_render_scene(
    arena: ArenaSpec,
    data: mujoco.MjData,
    pieces: RayPrimitives,
    piece_indices: Mapping[BlockKey, np.ndarray],
    capacity: Mapping[BlockKey, int],
    index: Mapping[int, RobotIndex],
    lights: Mapping[int, RobotSpec],
) -> RenderScene:
    """Return all that cameras see of a world; numpy arrays.

    Args:
        arena: Its arena.
        data: The state of the model of arena and robots; kinematics must be current.
        pieces: What rays see of the model's geoms.
        piece_indices: The pieces of each kind and material.
        capacity: For how many of each kind and material to make arrays.
        index: Where each robot is in the model, by slot.
        lights: The robots whose headlights shine, by slot.
    """
    columns, water = _columns(arena, data, pieces, index), _water(arena)
    waters = len(arena.waters)
    keys = sorted({*capacity, WATER_KEY} if waters else capacity)
    blocks, appearances = [], []
    for key in keys:
        members = piece_indices.get(key, np.zeros(0, int))
        rows, n = {name: column[members] for name, column in columns.items()}, capacity.get(key, 0)
        if waters and key == WATER_KEY:
            rows, n = {name: np.concatenate([own, water[name]]) for name, own in rows.items()}, n + waters
        rows = _padded(rows, n)
        blocks.append(GeomBlock(**{name: rows[name] for name in ("pos", "mat", "size", "owner")}))
        appearances.append(
            GeomAppearance(**{name: rows[name] for name in ("rgb", "transparency", "reflectance", "label")})
        )
    kinds, materials = tuple(kind for kind, _ in keys), tuple(material for _, material in keys)
    sun = np.array(SUN_DIRECTION, np.float32)
    return RenderScene(
        geoms=Geoms(blocks=tuple(blocks), kinds=kinds, materials=materials),
        appearance=jax.tree.map(lambda *parts: np.concatenate(parts), *appearances),
        sun_direction=sun / np.linalg.norm(sun),
        lights=point_lights(arena.lights, arena.floor),
        headlights=_headlights(data, index, lights),
        checker_size=np.array(CHECKER_SIZE, np.float32),
        checker_bounds=np.array(UNBOUNDED_EXTENT, np.float32),
    )


def _columns(
    arena: ArenaSpec, data: mujoco.MjData, pieces: RayPrimitives, index: Mapping[int, RobotIndex]
) -> GeomColumns:
    model = data.model
    owner = np.full(model.nbody, -1)
    for robot, layout in index.items():
        owner[list(layout.body_ids)] = robot
    slot = owner[model.geom_bodyid[pieces.geom]]
    piece = np.zeros(len(slot), int)
    for robot in index:
        piece[slot == robot] = np.arange((slot == robot).sum())
    pos, mat = pieces.world_poses(data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3))
    return {
        "pos": np.asarray(pos),
        "mat": np.asarray(mat),
        "size": pieces.size,
        "owner": np.where(slot >= 0, robot_geom_owner(slot, piece), -1),
        "rgb": model.geom_rgba[pieces.geom, :3],
        "transparency": transparencies(pieces.material),
        "reflectance": reflectances(pieces.material),
        "label": np.where(slot >= 0, ROBOT_LABEL + slot, labels_of(model, arena)[pieces.geom]),
    }


def _water(arena: ArenaSpec) -> GeomColumns:
    corners = np.array([(water.low, water.high) for water in arena.waters], np.float32).reshape(-1, 2, 3)
    n, low, high = len(corners), corners[:, 0], corners[:, 1]
    return {
        "pos": (low + high) / 2 + (0.0, 0.0, arena.floor),
        "mat": np.tile(np.eye(3), (n, 1, 1)),
        "size": (high - low) / 2,
        "owner": np.full(n, -1),
        "rgb": np.tile(WATER_RGB, (n, 1)),
        "transparency": np.full(n, WATER_TRANSPARENCY),
        "reflectance": np.zeros(n),
        "label": np.full(n, WATER_LABEL),
    }


def _padded(rows: GeomColumns, capacity: int) -> GeomColumns:
    """Return geoms with some that are far away, so that the arrays have that capacity."""
    fills = {"pos": PADDING_DISTANCE, "owner": -1}
    padded = {}
    for name, values in rows.items():
        whole = np.issubdtype(values.dtype, np.integer)
        out = np.full((capacity, *values.shape[1:]), fills.get(name, 0.0), np.int32 if whole else np.float32)
        out[: len(values)] = values
        if name == "mat":
            out[len(values) :] = np.eye(3)
        padded[name] = out
    return padded


def _headlights(
    data: mujoco.MjData, index: Mapping[int, RobotIndex], lights: Mapping[int, RobotSpec]
) -> Headlights:
    pos, along = np.zeros((MAX_HEADLIGHTS, 3), np.float32), np.zeros((MAX_HEADLIGHTS, 3), np.float32)
    on, label = np.zeros(MAX_HEADLIGHTS, bool), np.zeros(MAX_HEADLIGHTS, np.int32)
    for k, slot in enumerate(sorted(lights)[:MAX_HEADLIGHTS]):
        lamp = headlight_of(lights[slot])
        body = index[slot].body_ids[lamp.body]
        mat = data.xmat[body].reshape(3, 3)
        pos[k], along[k] = data.xpos[body] + mat @ lamp.pos, mat @ lamp.direction
        on[k], label[k] = True, ROBOT_LABEL + slot
    return Headlights(pos=pos, direction=along, on=on, label=label)
