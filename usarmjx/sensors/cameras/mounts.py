"""Cameras and headlights of a robot class: mounts, zoom limits, lenses, and geoms that cover a lens."""

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
"""Distance from the lens within which a solid covers it [m]."""
STAND_IN_MARGIN = 0.01
"""Largest distance of a visual's centre from the solid that it stands for [m]."""
GeomType = mujoco.mjtGeom
OMNI_PACKAGES = ("OmniCamera", "OmniCamPillar")
"""Mission packages with a mirror: a camera on one of their links faces it (manual 10.15.2)."""


def lens_covering_geoms(plan: KinematicTree, body: int, at: np.ndarray) -> np.ndarray:
    """Return which of a robot's visual geoms are hidden from a camera at a position (3,) on a body (geoms,).

    Those of the body itself, those nearer than `COVER_DISTANCE` with all joints at 0, and the visuals of a
    collision solid that near, such as the pieces of a housing.
    """
    drawn, solids = plan.visuals.solids, plan.solids
    (middles, drawn_mat), (pos, mat) = _rest_poses(plan, drawn), _rest_poses(plan, solids)
    lens = (plan.rest_pos[body] + plan.rest_frames[body] @ at)[None]

    def away(of: Solids, place: int, mat: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, 3), seen from the middle of a solid, are from it (n,)."""
        kind, size = int(of.kind[place]), of.size[place]
        return np.array([_distance_from_geom(kind, point, size) for point in points @ mat[place]])

    count = range(len(drawn.kind))
    near = [away(drawn, i, drawn_mat, lens - middles[i])[0] < COVER_DISTANCE for i in count]
    hidden = np.array(near, bool) | (drawn.frame == body)
    for place in range(len(solids.kind)):
        if away(solids, place, mat, lens - pos[place])[0] < COVER_DISTANCE:
            own = np.flatnonzero((drawn.frame == solids.frame[place]) & ~hidden)
            hidden[own[away(solids, place, mat, middles[own] - pos[place]) <= STAND_IN_MARGIN]] = True
    return hidden


def _rest_poses(plan: KinematicTree, solids: Solids) -> tuple[np.ndarray, np.ndarray]:
    """Return positions [m] (n, 3) and orientations (n, 3, 3) of solids on the chassis, all joints at 0."""
    with numpy_backend():  # the caller may be inside a JAX trace
        pos, mat = solids.poses(plan.rest_pos, plan.rest_frames)
    return np.asarray(pos), np.asarray(mat)


def _distance_from_geom(kind: int, point: np.ndarray, size: np.ndarray) -> float:
    """Return the distance of a point from a geom in its frame [m]; for an ellipsoid, from its box."""
    x, y, z = np.abs(point)
    if kind == GeomType.mjGEOM_SPHERE:
        return float(np.linalg.norm(point)) - size[0]
    if kind == GeomType.mjGEOM_CAPSULE:
        return float(np.hypot(np.hypot(x, y), max(z - size[1], 0.0))) - size[0]
    if kind == GeomType.mjGEOM_CYLINDER:
        return float(np.hypot(max(np.hypot(x, y) - size[0], 0.0), max(z - size[1], 0.0)))
    if kind == TRIANGLE_KIND:
        return _distance_from_triangle(point, size)
    return float(np.linalg.norm(np.maximum([x, y, z] - size, 0.0)))


def _distance_from_triangle(point: np.ndarray, size: np.ndarray) -> float:
    corners = np.array([(0.0, 0.0), (size[0], 0.0), (size[1], size[2])])
    edges, flat = np.roll(corners, -1, 0) - corners, point[:2] - corners
    share = np.clip((flat * edges).sum(-1) / np.maximum((edges**2).sum(-1), 1e-12), 0.0, 1.0)
    beside = float(np.linalg.norm(flat - share[:, None] * edges, axis=-1).min())
    within = (edges[:, 0] * flat[:, 1] - edges[:, 1] * flat[:, 0] >= 0).all()
    return float(np.hypot(0.0 if within else beside, point[2]))


@dataclass(frozen=True, eq=False)
class Camera:
    """Camera of a robot class, in SI units and MuJoCo's axes.

    Attributes:
        mount: Its mount.
        body: Index of its body in `KinematicTree.parts`.
        pos: Position on the body [m] (3,).
        mat: Orientation on the body; x is the optical axis (3, 3).
        default_fov: Initial field of view [rad].
        min_fov: Smallest field of view [rad].
        max_fov: Largest field of view [rad].
        lens: Type of lens.
        eye_offsets: Positions of its lenses in its own axes: one in the centre, or left and right [m] (n, 3).
        hidden_geoms: Geoms of its robot hidden from it, as they would cover the lens (`lens_covering_geoms`):
            captured mounts are outside the original's finer bodies, but lie on or in our solids (geoms,).
        imaging: Imaging parameters.
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
        """Return the field of view for a request [rad] (...,): 0 is the default (manual 9.4)."""
        fov = xp.asarray(fov, xp.float32)
        wanted = xp.where(xp.isnan(fov) | (fov == 0), self.default_fov, fov)
        return xp.clip(wanted, self.min_fov, self.max_fov).astype(xp.float32)


@cache
def cameras_of(robot: RobotSpec) -> tuple[Camera, ...]:
    """Return the cameras of a robot class in its order: the first is the main one (manual 12.1.2).

    Raises:
        SpecError: A camera on an unknown part; fields of view in the wrong order or not between 0 and pi; a
            stereo camera with spacing 0.
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
        eye_offsets=_lens_offsets(where, settings),
        hidden_geoms=lens_covering_geoms(plan, body, at),
        imaging=imaging_of(settings),
    )


def _lens_offsets(where: str, settings: CameraSettings) -> np.ndarray:
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
    """Return the index of a camera, by its name (case ignored) or its index; None: the main one.

    Raises:
        UnknownNameError: There is no such camera; lists the known ones.
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
    """Headlight of a robot class, in SI units and MuJoCo's axes.

    Attributes:
        body: Index of its body in `KinematicTree.parts`.
        pos: Position on the body [m] (3,).
        direction: Direction of its light, a unit vector (3,).
    """

    body: int
    pos: np.ndarray
    direction: np.ndarray


@cache
def headlight_of(robot: RobotSpec) -> HeadlightMount:
    """Return the headlight: its effecter's, or else at the centre of the robot's front (manual 11.5)."""
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
