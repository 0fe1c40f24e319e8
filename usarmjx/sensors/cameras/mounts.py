"""The cameras of a robot class, resolved: where they sit, what they can zoom to, and what lens they have."""

from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Literal

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import SpecError, UnknownNameError
from usarmjx.base.transforms import Vec3, flip_angles, flip_vector, mat_from_angles
from usarmjx.models.compile.kinematic_tree import KinematicTree, kinematic_tree_of
from usarmjx.models.compile.ray_geoms import TRIANGLE_KIND
from usarmjx.models.compile.visuals import Solids
from usarmjx.models.effecters import effecters_of
from usarmjx.models.effecters.jointless import Headlight
from usarmjx.models.types.robot import CHASSIS, Mount, RobotSpec
from usarmjx.sensors.cameras.imaging import PLAIN_IMAGING, Imaging, imaging_of
from usarmjx.sensors.settings import CameraSettings, resolve_camera

COVER_DISTANCE = 0.04
"""How near to the lens a solid covers it [m]."""
STAND_IN_MARGIN = 0.01
"""How far beside a solid the middle of what is drawn in its place may be [m]."""
GeomType = mujoco.mjtGeom


def covering_geoms(plan: KinematicTree, body: int, at: np.ndarray) -> np.ndarray:
    """Return which of a robot's drawn solids a camera at a place (3,) on a body does not see (solids,).

    Those of the body itself, those nearer than `COVER_DISTANCE` with all joints at 0, and those that are
    drawn in the place of a solid so near, as the pieces of a housing are.
    """
    drawn, solids = plan.visuals.solids, plan.solids
    (middles, drawn_mat), (pos, mat) = _rest_poses(plan, drawn), _rest_poses(plan, solids)
    lens = (plan.rest_pos[body] + plan.rest_frames[body] @ at)[None]

    def away(of: Solids, place: int, mat: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, 3), seen from the middle of a solid, are from it (n,)."""
        kind, size = int(of.kind[place]), of.size[place]
        return np.array([_away(kind, point, size) for point in points @ mat[place]])

    count = range(len(drawn.kind))
    near = [away(drawn, i, drawn_mat, lens - middles[i])[0] < COVER_DISTANCE for i in count]
    hidden = np.array(near, bool) | (drawn.frame == body)
    for place in range(len(solids.kind)):
        if away(solids, place, mat, lens - pos[place])[0] < COVER_DISTANCE:
            own = np.flatnonzero((drawn.frame == solids.frame[place]) & ~hidden)
            hidden[own[away(solids, place, mat, middles[own] - pos[place]) <= STAND_IN_MARGIN]] = True
    return hidden


def _rest_poses(plan: KinematicTree, solids: Solids) -> tuple[np.ndarray, np.ndarray]:
    """Return where solids are on the chassis with all joints at 0 [m] (n, 3), and their turns (n, 3, 3)."""
    with numpy_backend():  # it may be asked for while JAX traces
        pos, mat = solids.poses(plan.rest_pos, plan.rest_frames)
    return np.asarray(pos), np.asarray(mat)


def _away(kind: int, point: np.ndarray, size: np.ndarray) -> float:
    """Return how far a point in a geom's frame is from it [m]; of an ellipsoid, from the box about it."""
    x, y, z = np.abs(point)
    if kind == GeomType.mjGEOM_SPHERE:
        return float(np.linalg.norm(point)) - size[0]
    if kind == GeomType.mjGEOM_CAPSULE:
        return float(np.hypot(np.hypot(x, y), max(z - size[1], 0.0))) - size[0]
    if kind == GeomType.mjGEOM_CYLINDER:
        return float(np.hypot(max(np.hypot(x, y) - size[0], 0.0), max(z - size[1], 0.0)))
    if kind == TRIANGLE_KIND:
        return _from_triangle(point, size)
    return float(np.linalg.norm(np.maximum([x, y, z] - size, 0.0)))


def _from_triangle(point: np.ndarray, size: np.ndarray) -> float:
    corners = np.array([(0.0, 0.0), (size[0], 0.0), (size[1], size[2])])
    edges, flat = np.roll(corners, -1, 0) - corners, point[:2] - corners
    share = np.clip((flat * edges).sum(-1) / np.maximum((edges**2).sum(-1), 1e-12), 0.0, 1.0)
    beside = float(np.linalg.norm(flat - share[:, None] * edges, axis=-1).min())
    within = (edges[:, 0] * flat[:, 1] - edges[:, 1] * flat[:, 0] >= 0).all()
    return float(np.hypot(0.0 if within else beside, point[2]))


OMNI_PACKAGES = ("OmniCamera", "OmniCamPillar")
"""Mission packages that carry a mirror: a camera on one of their links looks into it (manual 10.15.2)."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera of a robot class; lengths and axes are ours.

    Attributes:
        mount: Where it is described.
        body: The body it sits on, as a place in `KinematicTree.parts`.
        pos: Position on it [m] (3,).
        mat: Orientation on it; x is the optical axis (3, 3).
        default_fov: Field of view that it starts with [rad].
        min_fov: Smallest field of view [rad].
        max_fov: Largest [rad].
        lens: What it looks through.
        eye_offsets: Where its eyes are, in its own axes: one in the middle, or the left one and the right
            one [m] (n, 3).
        hidden_geoms: Geoms of its robot that it does not see, as they would cover its lens (`lens_cover`):
            captured mounts leave the original's finer bodies free, and lie on or in our solids (geoms,).
        imaging: What becomes of the light behind the lens.
    """

    mount: Mount
    body: int
    pos: np.ndarray
    mat: np.ndarray
    default_fov: float
    min_fov: float
    max_fov: float
    lens: Literal["pinhole", "omni"]
    eye_offsets: np.ndarray
    hidden_geoms: np.ndarray
    imaging: Imaging = PLAIN_IMAGING

    def clamp(self, fov: Array, xp: ModuleType = np) -> Array:
        """Return what field of view it has when told one [rad] (...,): 0 is the default (manual 9.4)."""
        fov = xp.asarray(fov, xp.float32)
        wanted = xp.where(xp.isnan(fov) | (fov == 0), self.default_fov, fov)
        return xp.clip(wanted, self.min_fov, self.max_fov).astype(xp.float32)


@cache
def cameras_of(robot: RobotSpec) -> tuple[Camera, ...]:
    """Return the cameras of a robot class, in its order: the first is the main one (manual 12.1.2).

    Raises:
        SpecError: A camera on a part that the robot does not have; fields of view in the wrong order or not
            between 0 and pi; a stereo camera without a distance of its eyes.
    """
    return tuple(_camera(robot, mount) for mount in robot.cameras)


def _camera(robot: RobotSpec, mount: Mount) -> Camera:
    where = f"{robot.name}: {mount.kind} {mount.name}"
    settings, plan = resolve_camera(mount, where), kinematic_tree_of(robot)
    parts = plan.parts
    if mount.parent not in parts:
        raise SpecError(f"{where}: no part {mount.parent!r}; parts: {', '.join(parts)}")
    roll, pitch, yaw = flip_angles(mount.direction)
    body, at = parts.index(mount.parent), np.array(flip_vector(mount.at), np.float32)
    return Camera(
        mount=mount,
        body=body,
        pos=at,
        mat=mat_from_angles(np.array(roll), np.array(pitch), np.array(yaw)).astype(np.float32),
        default_fov=settings.camera_def_fov,
        min_fov=settings.camera_min_fov,
        max_fov=settings.camera_max_fov,
        lens="omni" if settings.omni or mount.parent.rsplit("_Link", 1)[0] in OMNI_PACKAGES else "pinhole",
        eye_offsets=_eyes(where, settings),
        hidden_geoms=covering_geoms(plan, body, at),
        imaging=imaging_of(settings),
    )


def _eyes(where: str, settings: CameraSettings) -> np.ndarray:
    if not settings.is_stereo:
        return np.zeros((1, 3), np.float32)
    axes = {str(axis).upper(): value for axis, value in settings.stereo_spacing}
    if not set(axes) <= {"X", "Y", "Z"} or not any(axes.values()):
        raise SpecError(
            f"{where}: StereoSpacing is {settings.stereo_spacing}, expected X, Y and Z, not all 0"
        )
    right: Vec3 = tuple(float(axes.get(axis, 0.0)) for axis in "XYZ")  # type: ignore[assignment]
    return np.array([flip_vector(tuple(-x for x in right)), flip_vector(right)], np.float32)  # type: ignore


def camera_index(robot: RobotSpec, name: str | int | None = None) -> int:
    """Return the place of a camera, by its name (case ignored) or its place; None: the main one.

    Raises:
        UnknownNameError: There is no such camera; lists those there are.
    """
    known = [mount.name for mount in robot.cameras]
    lower = [one.lower() for one in known]
    if name is None and known:
        return 0
    if isinstance(name, int) and 0 <= name < len(known):
        return name
    if isinstance(name, str) and name.lower() in lower:
        return lower.index(name.lower())
    raise UnknownNameError(f"{robot.name} has no camera {name!r}; it has: {', '.join(known) or 'none'}")


@dataclass(frozen=True, eq=False)
class HeadlightMount:
    """Where a robot class has its headlight; lengths and axes are ours.

    Attributes:
        body: The body it sits on, as a place in `KinematicTree.parts`.
        pos: Position on it [m] (3,).
        direction: Where it shines, a unit vector (3,).
    """

    body: int
    pos: np.ndarray
    direction: np.ndarray


@cache
def headlight_of(robot: RobotSpec) -> HeadlightMount:
    """Return the headlight: its effecter's, or else in the middle of the robot's front (manual 11.5)."""
    mounts = [one.mount for one in effecters_of(robot) if isinstance(one, Headlight)]
    front: Vec3 = (robot.dimensions[0] / 2, 0.0, 0.0)
    mount = mounts[0] if mounts else Mount(kind="Headlight", name="Headlight", at=front)
    parts = kinematic_tree_of(robot).parts
    roll, pitch, yaw = flip_angles(mount.direction)
    mat = mat_from_angles(np.array(roll), np.array(pitch), np.array(yaw))
    return HeadlightMount(
        body=parts.index(mount.parent) if mount.parent in parts else parts.index(CHASSIS),
        pos=np.array(flip_vector(mount.at), np.float32),
        direction=mat[:, 0].astype(np.float32),
    )
