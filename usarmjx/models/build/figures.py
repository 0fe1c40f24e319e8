"""Figures: what is drawn of robots and victims, as solids that follow frames and are no part of the physics.

A figure has a little model of its own, at which C MuJoCo can cast rays, and the same solids as arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import SpecError
from usarmjx.base.rotations import matmul, matvec
from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.models.build.geoms import add_geom
from usarmjx.models.build.pieces import TRIANGLE_KIND, ray_primitives_of
from usarmjx.models.spec.shapes import OPAQUE, Shape

GeomType = mujoco.mjtGeom
FIGURE_MEMORY = 1 << 16
"""What a figure's MjData takes: it is never stepped [bytes]."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Solids that follow frames, meshes as their triangles (`models.build.pieces`).

    Attributes:
        kind: MuJoCo types, or `pieces.TRIANGLE_KIND` (n,).
        frame: The frame that each follows: a robot's body, a victim's bone (n,).
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
        """Return where they are (..., n, 3), (..., n, 3, 3) for frames at (..., frames, 3), (..., 3, 3)."""
        turn = mat[..., self.frame, :, :]
        return pos[..., self.frame, :] + matvec(turn, self.pos), matmul(turn, self.mat)


def reach_of(solids: Solids, mat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far solids reach from their positions along the axes: least and most [m] (n, 3) twice.

    Args:
        solids: Boxes, spheres, capsules, cylinders, ellipsoids and triangles.
        mat: How they are turned (n, 3, 3).
    """
    size, kind = solids.size, solids.kind[:, None]
    round_, long = size[:, :1], size[:, 1:2]
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
    corners = np.stack(
        [0 * mat[:, :, 0], round_ * mat[:, :, 0], long * mat[:, :, 0] + size[:, 2:] * mat[:, :, 1]]
    )
    is_triangle = kind == TRIANGLE_KIND
    return np.where(is_triangle, corners.min(0), -half), np.where(is_triangle, corners.max(0), half)


@dataclass(frozen=True, eq=False)
class Figure:
    """What is drawn.

    Attributes:
        model: Its solids as geoms of mocap bodies, which are the frames.
        solids: The geoms, meshes in triangles.
        geom_of: The geom that each of the solids belongs to (n,).
    """

    model: mujoco.MjModel
    solids: Solids
    geom_of: np.ndarray


def flipped(shape: Shape) -> Shape:
    """Return a robot's shape in MuJoCo's axes."""
    return Shape(**{**vars(shape), "at": flip_vector(shape.at), "rotation": flip_angles(shape.rotation)})


def build_figure(shapes: Sequence[Sequence[Shape]]) -> Figure:
    """Return the figure of the shapes that follow each frame, in MuJoCo's axes.

    Raises:
        SpecError: A shape is not opaque.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.memory = FIGURE_MEMORY
    frame = np.repeat(np.arange(len(shapes)), [len(some) for some in shapes]).astype(int)
    for number, some in enumerate(shapes):
        body = spec.worldbody.add_body(name=str(number), mocap=True)
        for place, shape in enumerate(some):
            if shape.material != OPAQUE:
                raise SpecError(f"what is drawn of a robot is {OPAQUE}, not {shape.material!r}")
            add_geom(spec, body, f"{number}/{place}", shape)
    model = spec.compile()
    mats = np.zeros((model.ngeom, 9))
    for mat, quat in zip(mats, model.geom_quat, strict=True):
        mujoco.mju_quat2Mat(mat, quat)
    pieces = ray_primitives_of(model, np.arange(model.ngeom))
    pos, mat = pieces.world_poses(model.geom_pos, mats.reshape(-1, 3, 3))
    solids = Solids(
        kind=pieces.kind,
        frame=frame[pieces.geom],
        size=pieces.size,
        pos=np.asarray(pos, np.float32),
        mat=np.asarray(mat, np.float32),
        rgb=model.geom_rgba[pieces.geom, :3].astype(np.float32),
    )
    return Figure(model=model, solids=solids, geom_of=pieces.geom)
