"""Solids of a drawing as triangles, at rest and at the poses of a frame."""

from dataclasses import dataclass

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.models.types.shapes import SKY
from usarmjx.sensors.cameras.paint import ARENA_LABEL, MIRROR_REFLECTANCE
from usarmjx.view.drawing import NOBODY, Drawing, DrawnShape, Frame
from usarmjx.view.mesh import BOX, Finish, TriangleMesh, meshes_of, rectangle

FLOOR_REACH = 300.0
"""Distance from the arena up to which an unbounded floor is drawn [m]."""
FLOOR_RGB = np.full(3, 0.8)
"""Colour of the floor's triangles, which shading replaces by checkers."""
OVERHEAD = 2.2
"""Height of a solid's underside above the floor, or above robots, from which on it is overhead [m]."""
ROOF_SHARE = 0.5
"""Share of the plan from which on solids overhead are a roof, and are left out."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Triangles of a drawing, in the axes of their bodies.

    Attributes:
        corners: Corners [m] (n, 3, 3).
        normals: Unit normals at the corners (n, 3, 3).
        rgb: Colours (n, 3).
        transparency: Share of light that passes through (n,).
        reflectance: Share of the reflection in the colour (n,).
        label: Labels, see `cameras.paint` (n,).
        body: Index of the body, `NOBODY` for the floor (n,).
        is_floor: Which are the unbounded floor (n,).
        two_sided: Which are visible from behind, too (n,).
    """

    corners: np.ndarray
    normals: np.ndarray
    rgb: np.ndarray
    transparency: np.ndarray
    reflectance: np.ndarray
    label: np.ndarray
    body: np.ndarray
    is_floor: np.ndarray
    two_sided: np.ndarray

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.corners)

    def at(self, frame: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return corners (n, 3, 3), normals (n, 3, 3) and which of them are shown (n,) in a frame."""
        with numpy_backend():
            turns = np.asarray(mat_from_quat(np.asarray(frame.quat, np.float64)))
        turns = np.concatenate([turns, np.eye(3)[None]])
        places = np.concatenate([frame.pos, np.zeros((1, 3))])
        shown = np.append(frame.shown, True)
        mat = turns[self.body].swapaxes(1, 2)
        corners = self.corners @ mat + places[self.body][:, None]
        return corners, self.normals @ mat, shown[self.body]


def solids_of(drawing: Drawing) -> Solids:
    """Return the triangles of a drawing, without its roof and its sky."""
    parts: list[Solids] = []
    robots_floor = drawing.floor + OVERHEAD
    for index, body in enumerate(drawing.bodies):
        shape = _kept(drawing.shapes[body.shape], drawing, robots_floor if body.slot == NOBODY else None)
        parts += [_part(mesh, finish, body.label, index) for finish, mesh in meshes_of(shape).items()]
    if drawing.has_floor:
        low, high = drawing.extent.T
        flat = rectangle(low - FLOOR_REACH, high + FLOOR_REACH, drawing.floor, FLOOR_RGB)
        parts.append(_part(flat, Finish(), ARENA_LABEL, NOBODY, is_floor=True))
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Solids(*(np.concatenate(column) for column in columns))


def _part(mesh: TriangleMesh, finish: Finish, label: int, body: int, is_floor: bool = False) -> Solids:
    count = len(mesh.faces)
    return Solids(
        corners=mesh.vertices[mesh.faces].astype(np.float64),
        normals=mesh.normals[mesh.faces].astype(np.float64),
        rgb=mesh.rgb[mesh.faces[:, 0]].astype(np.float32),
        transparency=np.full(count, 1.0 - finish.opacity, np.float32),
        reflectance=np.full(count, MIRROR_REFLECTANCE * (finish.metallic > 0), np.float32),
        label=np.full(count, label, np.int32),
        body=np.full(count, body),
        is_floor=np.full(count, is_floor),
        two_sided=np.full(count, finish.two_sided or finish.opacity < 1.0),
    )


def _kept(shape: DrawnShape, drawing: Drawing, overhead: float | None) -> DrawnShape:
    """Return a shape without sky, and without the boxes of a roof."""
    kept = np.asarray(shape.material) != SKY
    if overhead is not None:
        boxes = shape.kind == BOX
        half = np.abs(shape.mat) @ shape.size[..., None].astype(float)
        above = boxes & (shape.pos[:, 2] - half[:, 2, 0] > overhead) & kept
        area = float((4 * half[above, 0, 0] * half[above, 1, 0]).sum())
        if area > ROOF_SHARE * float(np.prod(np.diff(drawing.extent, axis=1))):
            kept &= ~above
    return DrawnShape(**{name: value[kept] for name, value in vars(shape).items()})
