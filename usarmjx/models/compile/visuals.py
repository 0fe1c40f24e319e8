"""Visuals: solids that follow frames, for pictures, as arrays and as a MuJoCo model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import SpecError
from usarmjx.base.rotations import matmul, matvec
from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.models.compile.geoms import add_geom
from usarmjx.models.compile.ray_geoms import TRIANGLE_KIND, ray_primitives_of
from usarmjx.models.types.shapes import OPAQUE, Shape

GeomType = mujoco.mjtGeom
VISUAL_MODEL_MEMORY = 1 << 16
"""Arena of a visual model's MjData, which is never stepped [bytes]."""


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
