"""The cameras of a robot class, resolved: where they sit, what they can zoom to, and what lens they have."""

from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Literal

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import SpecError, UnknownNameError
from usarmjx.base.transforms import Vec3, flip_angles, flip_vector, mat_from_angles
from usarmjx.cameras.imaging import PLAIN_IMAGING, Imaging, imaging_of
from usarmjx.cameras.lens_cover import covering_geoms
from usarmjx.models.build.body_plan import kinematic_tree_of
from usarmjx.models.effecters import effecters_of
from usarmjx.models.effecters.still import Headlight
from usarmjx.models.spec.robot import CHASSIS, Mount, RobotSpec
from usarmjx.sensors.settings import CameraSettings, resolve_camera

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
