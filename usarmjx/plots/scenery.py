"""What pictures show: the solids of a model as the sensors' rays meet them, and their colours."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from usarmjx.cameras.paint import (
    GLASS_TRANSPARENCY,
    MIRROR_REFLECTANCE,
    ROBOT_LABEL,
    WATER_LABEL,
    bone_labels,
    reflectances,
    transparencies,
)
from usarmjx.models.build.pieces import ray_primitives_of
from usarmjx.models.build.victim_looks import SLOTS, drawn_bones, used_slots
from usarmjx.models.build.victims import VictimTable, orientations, segment_poses
from usarmjx.models.spec.shapes import OPAQUE, SKY

__all__ = [
    "BOX",
    "GLASS_TRANSPARENCY",
    "MIRROR_REFLECTANCE",
    "PLANE",
    "RenderGeoms",
    "box_geoms",
    "render_geoms_of",
    "victim_geoms",
]

PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)


@dataclass(frozen=True, eq=False)
class RenderGeoms:
    """What can be seen.

    Attributes:
        kind: MuJoCo types, or those of `models.build.pieces` (n,).
        pos: Places [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: Size numbers [m] (n, 3).
        rgb: Colours (n, 3).
        transparency: Share of what is behind that is seen through them (n,).
        reflectance: Share of what they reflect in how they look (n,).
        label: What they are, see `cameras.paint`; an arena's solids show bricks (n,).
    """

    kind: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray
    rgb: np.ndarray
    transparency: np.ndarray
    reflectance: np.ndarray
    label: np.ndarray

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.kind)

    def select(self, which: np.ndarray) -> "RenderGeoms":
        """Return some of them, by index or mask."""
        return RenderGeoms(**{field.name: getattr(self, field.name)[which] for field in fields(self)})

    def concatenate(self, other: "RenderGeoms") -> "RenderGeoms":
        """Return these and others."""
        both = {f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)}
        return RenderGeoms(**both)


def render_geoms_of(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    materials: Sequence[str] | None = None,
    labels: np.ndarray | None = None,
) -> RenderGeoms:
    """Return what rays see of a model's geoms in their present poses; kinematics must be current.

    Args:
        model: The model.
        data: Its state.
        materials: What each geom is made of, see `materials_of`; None: all opaque. Sky is left out.
        labels: What each geom is in a segmentation (ngeom,); None: all are robots.
    """
    named = np.array([OPAQUE] * model.ngeom if materials is None else materials, object)
    ids = np.flatnonzero(named != SKY)
    pieces = ray_primitives_of(model, ids, named.tolist())
    pos, mat = pieces.world_poses(
        data.geom_xpos[ids].astype(np.float32), data.geom_xmat[ids].reshape(-1, 3, 3).astype(np.float32)
    )
    return RenderGeoms(
        kind=pieces.kind,
        pos=np.asarray(pos),
        mat=np.asarray(mat),
        size=pieces.size,
        rgb=model.geom_rgba[ids, :3].astype(np.float32)[pieces.geom],
        transparency=transparencies(pieces.material),
        reflectance=reflectances(pieces.material),
        label=(np.full(model.ngeom, ROBOT_LABEL) if labels is None else labels)[ids][pieces.geom],
    )


def victim_geoms(table: VictimTable, floor: float) -> RenderGeoms:
    """Return what is drawn of victims and false alarms at the start, with the floor at a height [m]."""
    drawn, used = drawn_bones(table), used_slots(table.part)
    place, quat = segment_poses(table, 0.0)
    turn = np.asarray(orientations(quat))[:, None]
    pos = (
        np.asarray(place)[:, None] + (turn @ np.asarray(drawn.offset)[..., None])[..., 0] + (0.0, 0.0, floor)
    )
    count = int(used.sum())
    return RenderGeoms(
        kind=np.tile(SLOTS, (table.num_boxes, 1))[used],
        pos=pos[used].astype(np.float32),
        mat=np.broadcast_to(turn, (*used.shape, 3, 3))[used].astype(np.float32),
        size=np.asarray(drawn.size, np.float32)[used],
        rgb=np.asarray(drawn.rgb, np.float32)[used],
        transparency=np.zeros(count, np.float32),
        reflectance=np.zeros(count, np.float32),
        label=np.broadcast_to(bone_labels(np.asarray(table.owner))[:, None], used.shape)[used],
    )


def box_geoms(low: np.ndarray, high: np.ndarray, rgb: np.ndarray, clear: float = 0.0) -> RenderGeoms:
    """Return upright boxes between corners (n, 3) and (n, 3), all of one colour (3,)."""
    count = len(low)
    return RenderGeoms(
        kind=np.full(count, BOX),
        pos=((low + high) / 2).astype(np.float32),
        mat=np.tile(np.eye(3, dtype=np.float32), (count, 1, 1)),
        size=((high - low) / 2).astype(np.float32),
        rgb=np.tile(np.asarray(rgb, np.float32), (count, 1)),
        transparency=np.full(count, clear, np.float32),
        reflectance=np.zeros(count, np.float32),
        label=np.full(count, WATER_LABEL),
    )
