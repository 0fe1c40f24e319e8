"""Visuals: solids that follow frames or victims, for pictures, as arrays and as a MuJoCo model.

Sensors meet the boxes. Every box has the same slots, so that the visuals of boxes that are data, whichever
bones they are, have one shape in all worlds; slots that a bone does not use are not drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import ModuleType
from typing import Literal, NamedTuple

import mujoco
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.errors import SpecError
from usarmjx.base.rotations import matmul, matvec
from usarmjx.base.transforms import Vec3, flip_angles, flip_vector
from usarmjx.models.compile.geoms import add_geom
from usarmjx.models.compile.ray_geoms import TRIANGLE_KIND, ray_primitives_of
from usarmjx.models.compile.victims import PARKED_COORDINATE, PART_NAMES, VictimTable
from usarmjx.models.types.shapes import OPAQUE, Shape

GeomType = mujoco.mjtGeom
VISUAL_MODEL_MEMORY = 1 << 16
"""Arena of a visual model's MjData, which is never stepped [bytes]."""
ELLIPSOID, CAPSULE = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
VISUAL_SLOTS = (ELLIPSOID,) * 6 + (CAPSULE,) * 2
"""Kinds of the solids that a victim's box can have."""
SIZE_AXES = {ELLIPSOID: (0, 1, 2), CAPSULE: (0, 2, 2)}
"""Half length of the box that each size number scales: a capsule stands along z."""
SKIN, HAIR, EYE, LIPS = (0.87, 0.68, 0.57), (0.22, 0.13, 0.07), (0.1, 0.12, 0.2), (0.65, 0.25, 0.25)
"""Colours of victims."""
STRIPE, BELT, SOLE = (0.93, 0.92, 0.85), (0.12, 0.09, 0.07), (0.75, 0.73, 0.7)


@dataclass(frozen=True, eq=False)
class Solids:
    """Solids that follow frames, meshes as their triangles (`models.compile.ray_geoms`).

    Attributes:
        kind: MuJoCo types, or `ray_geoms.TRIANGLE_KIND` (n,).
        frame: Frame of each: a robot's body, a victim's bone (n,).
        size: Size numbers [m] (n, 3).
        pos: Positions in their frames [m] (n, 3).
        mat: Orientations in their frames (n, 3, 3).
        rgb: Colours (n, 3).
    """

    kind: np.ndarray
    frame: np.ndarray
    size: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    rgb: np.ndarray

    def poses(self, pos: Array, mat: Array) -> tuple[Array, Array]:
        """Return their poses (..., n, 3), (..., n, 3, 3) for frames at (..., frames, 3), (..., 3, 3)."""
        turn = mat[..., self.frame, :, :]
        return pos[..., self.frame, :] + matvec(turn, self.pos), matmul(turn, self.mat)


def solid_extents(solids: Solids, mat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the extent of solids from their positions along the axes: lowest and highest [m] (n, 3) twice.

    Args:
        solids: Boxes, spheres, capsules, cylinders, ellipsoids and triangles.
        mat: Orientations (n, 3, 3).
    """
    size, kind = solids.size, solids.kind[:, None]
    round_, long = size[:, :1], size[:, 1:2]
    # Exact for each kind: boxes around turned solids' boxes would be larger.
    up = np.abs(mat[:, :, 2])
    half = np.select(
        [kind == one for one in (GeomType.mjGEOM_BOX, GeomType.mjGEOM_CYLINDER, GeomType.mjGEOM_CAPSULE)],
        [
            (np.abs(mat) * size[:, None]).sum(-1),
            round_ * np.sqrt(np.maximum(0.0, 1 - up * up)) + long * up,
            round_ + long * up,
        ],
        np.sqrt(((mat * size[:, None]) ** 2).sum(-1)),
    )
    half = np.where(kind == GeomType.mjGEOM_SPHERE, round_, half)
    # A triangle's size numbers: x of its second corner, x and y of the third, along its own axes.
    corners = np.stack(
        [0 * mat[:, :, 0], round_ * mat[:, :, 0], long * mat[:, :, 0] + size[:, 2:] * mat[:, :, 1]]
    )
    is_triangle = kind == TRIANGLE_KIND
    return np.where(is_triangle, corners.min(0), -half), np.where(is_triangle, corners.max(0), half)


@dataclass(frozen=True, eq=False)
class VisualModel:
    """Visuals as a MuJoCo model.

    Attributes:
        model: Its solids as geoms of mocap bodies, which are the frames.
        solids: The geoms, meshes in triangles.
        geom_of: Geom of each of the solids (n,).
    """

    model: mujoco.MjModel
    solids: Solids
    geom_of: np.ndarray


def flipped(shape: Shape) -> Shape:
    """Return a robot's shape in MuJoCo's axes."""
    return replace(shape, at=flip_vector(shape.at), rotation=flip_angles(shape.rotation))


def build_visual_model(shapes: Sequence[Sequence[Shape]]) -> VisualModel:
    """Return the visuals of the shapes that follow each frame, in MuJoCo's axes.

    Raises:
        SpecError: A shape is not opaque.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.memory = VISUAL_MODEL_MEMORY
    frame = np.repeat(np.arange(len(shapes)), [len(some) for some in shapes]).astype(int)
    for number, some in enumerate(shapes):  # a mocap body is a frame that is set, not simulated
        body = spec.worldbody.add_body(name=str(number), mocap=True)
        for index, shape in enumerate(some):
            if shape.material != OPAQUE:
                raise SpecError(f"a robot's visuals are {OPAQUE}, not {shape.material!r}")
            add_geom(spec, body, f"{number}/{index}", shape)
    model = spec.compile()
    mats = np.zeros((model.ngeom, 9))
    for mat, quat in zip(mats, model.geom_quat, strict=True):
        mujoco.mju_quat2Mat(mat, quat)
    pieces = ray_primitives_of(model, np.arange(model.ngeom))
    # Geoms' poses in their frames stand in for those in the world: the pieces' poses then are in the frames
    # too.
    pos, mat = pieces.world_poses(model.geom_pos, mats.reshape(-1, 3, 3))
    solids = Solids(
        kind=pieces.kind,
        frame=frame[pieces.geom],
        size=pieces.size,
        pos=np.asarray(pos, np.float32),
        mat=np.asarray(mat, np.float32),
        rgb=model.geom_rgba[pieces.geom, :3].astype(np.float32),
    )
    return VisualModel(model=model, solids=solids, geom_of=pieces.geom)


class BonePart(NamedTuple):
    """One solid of a bone, in shares of the half lengths of its box and in its axes.

    Attributes:
        at: Its centre.
        size: Radii of an ellipsoid; of a capsule the radius, and half the length of its tube.
        rgb: Its colour; None: the bone's.
        kind: Geom type.
    """

    at: Vec3
    size: Vec3
    rgb: Vec3 | None = None
    kind: int = ELLIPSOID


def _limb(z: float, radius: float, half: float, rgb: Vec3 | None = None) -> BonePart:
    return BonePart((0.0, 0.0, z), (radius, half, half), rgb, CAPSULE)


BONE_VISUALS: dict[str, tuple[BonePart, ...]] = {
    "Head": (
        BonePart((0.0, 0.0, 0.2), (0.93, 0.95, 0.8)),
        BonePart((-0.2, 0.0, 0.48), (0.95, 1.06, 0.62), HAIR),
        BonePart((0.95, 0.0, 0.08), (0.2, 0.14, 0.17)),  # nose
        BonePart((0.84, 0.38, 0.27), (0.1, 0.17, 0.07), EYE),
        BonePart((0.84, -0.38, 0.27), (0.1, 0.17, 0.07), EYE),
        BonePart((0.8, 0.0, -0.2), (0.1, 0.33, 0.05), LIPS),
        _limb(-0.7, 0.5, 0.35),  # neck
    ),
    "Chest": (
        BonePart((0.0, 0.0, 0.1), (1.0, 0.98, 1.1)),
        BonePart((0.0, 0.0, -0.65), (0.92, 0.86, 0.75)),
        BonePart((0.0, 0.0, 0.62), (0.72, 1.3, 0.42)),  # shoulders
        BonePart((0.0, 0.0, 0.1), (1.03, 1.01, 0.14), STRIPE),
        BonePart((0.05, 0.0, 0.98), (0.5, 0.36, 0.2), SKIN),  # the open collar
    ),
    "Pelvis": (
        BonePart((0.0, 0.0, -0.1), (1.0, 1.02, 1.05)),
        BonePart((0.0, 0.0, 0.72), (0.98, 0.94, 0.2), BELT),
    ),
    "Arm": (_limb(0.42, 1.05, 0.4), _limb(-0.45, 0.8, 0.45, SKIN)),
    "Hand": (
        BonePart((0.0, 0.0, 0.35), (0.95, 1.0, 0.65)),
        BonePart((-0.05, 0.0, -0.45), (0.75, 0.8, 0.55)),  # fingers
        BonePart((0.95, 0.0, 0.25), (0.3, 0.8, 0.45)),  # thumb
    ),
    "Leg": (_limb(0.45, 1.0, 0.42), _limb(-0.5, 0.78, 0.42)),
    "Foot": (
        BonePart((0.1, 0.0, -0.1), (0.92, 1.0, 1.0)),
        BonePart((-0.45, 0.0, 0.5), (0.5, 0.88, 1.2)),  # heel and ankle
        BonePart((0.05, 0.0, -0.75), (1.0, 1.05, 0.3), SOLE),
    ),
}
"""Visuals of each part of a victim's body."""


class DrawnBones(NamedTuple):
    """Visuals of the boxes of a table; arrays have axes over boxes and slots.

    Attributes:
        size: Size numbers [m] (boxes, slots, 3).
        offset: Centres in the axes of their boxes, relative to these; out of reach for unused slots [m]
            (boxes, slots, 3).
        rgb: Colours (boxes, slots, 3).
    """

    size: Array
    offset: Array
    rgb: Array


class _Columns(NamedTuple):
    """`BONE_VISUALS` as arrays over parts and slots; `bare` marks slots in the colour of their bone."""

    size: np.ndarray
    at: np.ndarray
    rgb: np.ndarray
    bare: np.ndarray
    used: np.ndarray


@cache
def _columns() -> _Columns:
    """Return `BONE_VISUALS` as arrays."""
    parts, slots = len(PART_NAMES), len(VISUAL_SLOTS)
    size, at, rgb = (np.zeros((parts, slots, 3), np.float32) for _ in range(3))
    bare, used = np.zeros((parts, slots), bool), np.zeros((parts, slots), bool)
    for row, part in enumerate(PART_NAMES):
        for trait in BONE_VISUALS[part]:
            # Each slot has one kind for all bones: arrays then need no kind of their own, and programs no
            # branch.
            slot = next(i for i, kind in enumerate(VISUAL_SLOTS) if kind == trait.kind and not used[row, i])
            used[row, slot], bare[row, slot] = True, trait.rgb is None
            size[row, slot], at[row, slot], rgb[row, slot] = trait.size, trait.at, trait.rgb or (0, 0, 0)
    return _Columns(size, at, rgb, bare, used)


def used_slots(part: Array) -> np.ndarray:
    """Return the used slots of boxes by their parts (boxes,), indices in `PART_NAMES`."""
    return _columns().used[np.asarray(part)]


def drawn_bones(table: VictimTable, xp: ModuleType = np) -> DrawnBones:
    """Return the visuals of a table's boxes; numpy or JAX arrays, of one world."""
    size, at, rgb, bare, used = (xp.asarray(column)[table.part] for column in _columns())
    half, rgba = xp.asarray(table.size), xp.asarray(table.rgba)
    of_slot = half[:, np.array([SIZE_AXES[kind] for kind in VISUAL_SLOTS])]
    return DrawnBones(
        # Not 0: rays divide by sizes.
        size=xp.where(used[..., None], size * of_slot, 1e-3),
        offset=xp.where(used[..., None], at * half[:, None], PARKED_COORDINATE),
        rgb=xp.where(bare[..., None], rgba[:, None, :3], rgb),
    )


VisualSolid = tuple[Literal["ellipsoid", "capsule"], Vec3, Vec3, Vec3]
"""Kind, size, centre and colour."""
_KINDS: dict[int, Literal["ellipsoid", "capsule"]] = {ELLIPSOID: "ellipsoid", CAPSULE: "capsule"}


def victim_visual_model(table: VictimTable, owner: int) -> VisualModel:
    """Return the visuals of an owner's boxes, a victim's or a false alarm's: these are its frames."""
    mine = np.flatnonzero(table.owner == owner)
    drawn, used = drawn_bones(table), used_slots(table.part)
    rows = (
        tuple(
            (_KINDS[VISUAL_SLOTS[slot]], *(_vector(column[box, slot]) for column in drawn))
            for slot in np.flatnonzero(used[box])
        )
        for box in mine
    )
    return _visual_model(tuple(rows))


def _vector(array: Array) -> Vec3:
    x, y, z = array.tolist()
    return (x, y, z)


@cache
def _visual_model(rows: tuple[tuple[VisualSolid, ...], ...]) -> VisualModel:
    """Return the visuals of solids by box; victims of one size share them."""
    return build_visual_model(
        [
            [Shape(kind=kind, size=size, at=at, rgba=(*rgb, 1.0)) for kind, size, at, rgb in solids]
            for solids in rows
        ]
    )
