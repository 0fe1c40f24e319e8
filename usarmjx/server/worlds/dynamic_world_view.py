"""What cameras see of a served world on C MuJoCo, as arrays with room to spare: see `live`."""

from collections.abc import Mapping

import jax
import mujoco
import numpy as np

from usarmjx.cameras.light import SUN, Headlights, lamps_of
from usarmjx.cameras.mounts import headlight_of
from usarmjx.cameras.paint import (
    ROBOT,
    WATER,
    WATER_CLEAR,
    WATER_RGB,
    Paint,
    clears,
    glosses,
    labels_of,
    piece_of,
)
from usarmjx.cameras.shading import Stage
from usarmjx.models.build.layout import RobotIndex
from usarmjx.models.build.pieces import Pieces
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import GLASS, RobotSpec
from usarmjx.sensors.rays.targets import FAR_AWAY, Block, Geoms, Sort
from usarmjx.sim.views import EVERYWHERE, TILE

WATER_SORT: Sort = (int(mujoco.mjtGeom.mjGEOM_BOX), GLASS)
BEAMS = 8
"""Headlights that can shine at once; of more, those in the lowest slots do."""

Columns = dict[str, np.ndarray]
"""Geoms, by fields of `raycast.Block` and `paint.Paint`: each has a leading axis over them."""


def live_stage(
    arena: ArenaSpec,
    data: mujoco.MjData,
    pieces: Pieces,
    places: Mapping[Sort, np.ndarray],
    room: Mapping[Sort, int],
    index: Mapping[int, RobotIndex],
    lights: Mapping[int, RobotSpec],
) -> Stage:
    """Return all that cameras see of a world; numpy arrays.

    Args:
        arena: Its arena.
        data: The state of the model of arena and robots; kinematics must be current.
        pieces: What rays see of the model's geoms.
        places: The pieces of each kind and material.
        room: For how many of each kind and material there is room.
        index: Where each robot is in the model, by slot.
        lights: The robots whose headlights shine, by slot.
    """
    columns, water = _columns(arena, data, pieces, index), _water(arena)
    waters = len(arena.waters)
    sorts = sorted({*room, WATER_SORT} if waters else room)
    blocks, paints = [], []
    for sort in sorts:
        members = places.get(sort, np.zeros(0, int))
        rows, n = {name: column[members] for name, column in columns.items()}, room.get(sort, 0)
        if waters and sort == WATER_SORT:
            rows, n = {name: np.concatenate([own, water[name]]) for name, own in rows.items()}, n + waters
        rows = _padded(rows, n)
        blocks.append(Block(**{name: rows[name] for name in ("pos", "mat", "size", "owner")}))
        paints.append(Paint(**{name: rows[name] for name in ("rgb", "clear", "gloss", "label")}))
    types, materials = (tuple(sort[k] for sort in sorts) for k in (0, 1))
    sun = np.array(SUN, np.float32)
    return Stage(
        geoms=Geoms(blocks=tuple(blocks), types=types, materials=materials),  # type: ignore - numbers and words
        paint=jax.tree.map(lambda *parts: np.concatenate(parts), *paints),
        sun=sun / np.linalg.norm(sun),
        lamps=lamps_of(arena.lights, arena.floor),
        headlights=_headlights(data, index, lights),
        tile=np.float32(TILE),
        tiled=np.array(EVERYWHERE, np.float32),
    )


def _columns(
    arena: ArenaSpec, data: mujoco.MjData, pieces: Pieces, index: Mapping[int, RobotIndex]
) -> Columns:
    model = data.model
    owner = np.full(model.nbody, -1)
    for robot, layout in index.items():
        owner[list(layout.body)] = robot
    slot = owner[model.geom_bodyid[pieces.geom]]
    piece = np.zeros(len(slot), int)
    for robot in index:
        piece[slot == robot] = np.arange((slot == robot).sum())
    pos, mat = pieces.placed(data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3))
    return {
        "pos": pos,
        "mat": mat,
        "size": pieces.size,
        "owner": np.where(slot >= 0, piece_of(slot, piece), -1),
        "rgb": model.geom_rgba[pieces.geom, :3],
        "clear": clears(pieces.material),
        "gloss": glosses(pieces.material),
        "label": np.where(slot >= 0, ROBOT + slot, labels_of(model, arena)[pieces.geom]),
    }


def _water(arena: ArenaSpec) -> Columns:
    corners = np.array([(water.low, water.high) for water in arena.waters], np.float32).reshape(-1, 2, 3)
    n, low, high = len(corners), corners[:, 0], corners[:, 1]
    return {
        "pos": (low + high) / 2 + (0.0, 0.0, arena.floor),
        "mat": np.tile(np.eye(3), (n, 1, 1)),
        "size": (high - low) / 2,
        "owner": np.full(n, -1),
        "rgb": np.tile(WATER_RGB, (n, 1)),
        "clear": np.full(n, WATER_CLEAR),
        "gloss": np.zeros(n),
        "label": np.full(n, WATER),
    }


def _padded(rows: Columns, room: int) -> Columns:
    """Return geoms with some that are far away, so that there are as many as there is room for."""
    fills = {"pos": FAR_AWAY, "owner": -1}
    padded = {}
    for name, values in rows.items():
        whole = np.issubdtype(values.dtype, np.integer)
        out = np.full((room, *values.shape[1:]), fills.get(name, 0.0), np.int32 if whole else np.float32)
        out[: len(values)] = values
        if name == "mat":
            out[len(values) :] = np.eye(3)
        padded[name] = out
    return padded


def _headlights(
    data: mujoco.MjData, index: Mapping[int, RobotIndex], lights: Mapping[int, RobotSpec]
) -> Headlights:
    pos, along = np.zeros((BEAMS, 3), np.float32), np.zeros((BEAMS, 3), np.float32)
    on, label = np.zeros(BEAMS, bool), np.zeros(BEAMS, np.int32)
    for k, slot in enumerate(sorted(lights)[:BEAMS]):
        lamp = headlight_of(lights[slot])
        body = index[slot].body[lamp.body]
        mat = data.xmat[body].reshape(3, 3)
        pos[k], along[k] = data.xpos[body] + mat @ lamp.at, mat @ lamp.along
        on[k], label[k] = True, ROBOT + slot
    return Headlights(pos=pos, along=along, on=on, label=label)
