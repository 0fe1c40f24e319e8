"""Cameras and headlights of a robot class: mounts, zoom limits, lenses, and geoms that cover a lens.

`Imaging` is what happens behind the lens: exposure, noise and supersampling.
"""

import math
from dataclasses import dataclass, replace
from functools import cache
from types import ModuleType
from typing import Annotated, Literal, NamedTuple

import mujoco
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, numpy_backend, xp
from usarmjx.base.errors import SpecError, UnknownNameError
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.base.transforms import Vec3, flip_angles, flip_vector, mat_from_angles
from usarmjx.models.compile.kinematic_tree import KinematicTree, kinematic_tree_of
from usarmjx.models.compile.ray_geoms import TRIANGLE_KIND
from usarmjx.models.compile.visuals import Solids
from usarmjx.models.effecters import effecters_of
from usarmjx.models.effecters.standard import Headlight
from usarmjx.models.types.robot import CHASSIS, Mount, RobotSpec, field_name, resolve_settings
from usarmjx.sensors.base import SENSORS, SensorSettings

DISTORTION_LIMITS = Setting(ge=-0.3, le=1.0)
"""Limits of a distortion coefficient."""
MAX_SUPERSAMPLING = 4
"""Largest number of rays along each side of a pixel."""


@dataclass(frozen=True)
class CameraSettings:
    """Settings of a camera (manual 10.14.2, its CONF example, and 3.2.6.2).

    Attributes:
        weight: Share of the payload [kg].
        camera_def_fov: Initial horizontal field of view [rad].
        camera_min_fov: Smallest field of view [rad].
        camera_max_fov: Largest field of view [rad].
        is_stereo: Whether it has two lenses.
        stereo_spacing: Half the offset from the left to the right lens, in USARSim's axes [m].
        omni: Whether it faces a parabolic mirror; the packages of manual 10.15 always do.
        exposure: Factor on the brightness of its pictures. Own key, like the following.
        distortion_k1: Brown's radial distortion: coefficient of the squared distance from the centre, in
            focal lengths; negative is barrel distortion.
        distortion_k2: Coefficient of the fourth power.
        image_noise: Standard deviation of the noise of each colour of each pixel, of 255.
        supersampling: Rays along each side of a pixel, for smooth edges.
    """

    weight: Annotated[float, NOT_NEGATIVE] = 0.4
    camera_def_fov: float = 0.8727
    camera_min_fov: float = 0.3491
    camera_max_fov: float = 2.0944
    is_stereo: bool = False
    stereo_spacing: tuple[tuple[str, float], ...] = (("Y", 0.05),)
    omni: bool = False
    exposure: Annotated[float, POSITIVE] = 1.0
    distortion_k1: Annotated[float, DISTORTION_LIMITS] = 0.0
    distortion_k2: Annotated[float, DISTORTION_LIMITS] = 0.0
    image_noise: Annotated[float, NOT_NEGATIVE] = 0.0
    supersampling: Annotated[int, Setting(ge=1, le=MAX_SUPERSAMPLING)] = 1


def resolve_camera(mount: Mount, owner: str) -> CameraSettings:
    """Return the settings of a camera; a default field of view is clamped to the limits.

    So equal CameraMinFov and CameraMaxFov make a camera of that field of view (manual 10.14.2).

    Raises:
        UnknownNameError: See `models.types.robot.checked`.
        SpecError: Likewise; or fields of view in the wrong order or not between 0 and pi.
    """
    settings = resolve_settings(CameraSettings, mount.all_options, owner)
    low, high = settings.camera_min_fov, settings.camera_max_fov
    if "camera_def_fov" not in {field_name(key) for key, _ in mount.options}:
        # Only a default is moved: a field of view that the file states has to fit its limits.
        settings = replace(settings, camera_def_fov=max(low, min(high, settings.camera_def_fov)))
    if not 0 < low <= settings.camera_def_fov <= high < math.pi:
        raise SpecError(
            f"{owner}: fields of view are {low:g} to {high:g}, at first {settings.camera_def_fov:g} rad; "
            "expected 0 < CameraMinFov <= CameraDefFov <= CameraMaxFov < pi"
        )
    return settings


def carried_weight(robot: RobotSpec) -> float:
    """Return the weight of all sensors, cameras and effecters of a robot class [kg].

    It is not added to any body: the mass of an item is in the solids of its part (manual 10, footnote 3).

    Raises:
        UnknownNameError: An item has an unknown type or setting.
    """
    weights = [_weight(mount, SENSORS.get(mount.kind).settings_class) for mount in robot.sensors]
    weights += [_weight(mount, CameraSettings) for mount in robot.cameras]
    weights += [effecter.settings.weight for effecter in effecters_of(robot)]
    return float(sum(weights))


def _weight(mount: Mount, kind: type[object]) -> float:
    settings = resolve_settings(kind, mount.all_options, f"{mount.kind} {mount.name}")
    return getattr(settings, "weight", SensorSettings.weight)


def overload(robot: RobotSpec) -> str:
    """Return the fault if a robot carries more than its payload, otherwise "".

    A payload of 0 is unknown.
    """
    load = carried_weight(robot)
    # Sums of weights such as 0.1 kg are off by roundings.
    if not robot.payload or load <= robot.payload + 1e-9:
        return ""
    items = len(robot.sensors) + len(robot.cameras) + len(robot.effecters)
    return f"{robot.name} carries {load:.2f} kg of {items} items, its payload is {robot.payload:.2f} kg"


class Imaging(NamedTuple):
    """Imaging parameters of a camera.

    Attributes:
        exposure: Factor on brightness.
        distortion: k1 and k2 of the lens; None: no distortion (2,).
        noise: Standard deviation of each colour, of 255; None: no noise.
        supersampling: Rays along each side of a pixel.
    """

    exposure: float = 1.0
    distortion: np.ndarray | None = None
    noise: float | None = None
    supersampling: int = 1


PLAIN_IMAGING = Imaging()
"""Imaging of an ideal camera."""


def imaging_of(settings: CameraSettings) -> Imaging:
    """Return the imaging parameters of settings; effects that are off are None and cost nothing."""
    bend = np.array([settings.distortion_k1, settings.distortion_k2], np.float32)
    return Imaging(
        exposure=settings.exposure,
        distortion=bend if bend.any() else None,
        noise=settings.image_noise or None,
        supersampling=settings.supersampling,
    )


def quantize(rgb: Array, noise: Array | None, seed: Array | int, slot: Array | int) -> Array:
    """Return colours in [0, 1] (..., 3) as uint8 levels, with noise if there is any.

    Args:
        rgb: Colours.
        noise: Standard deviation of the noise, of 255 ().
        seed: Seed of the noise ().
        slot: Slot of the robot, whose noise is its own ().
    """
    bright = 255 * rgb
    if noise is not None:
        # From the moment's seed alone: the same picture has the same noise on all backends.
        key = random.fold_in(random.fold_in(random.key(0), seed), slot)
        bright = xp.clip(bright + noise * random.normal(key, bright.shape), 0.0, 255.0)
    # Not `round`, which rounds halves to even.
    return xp.floor(bright + 0.5).astype(xp.uint8)


def box_filter(values: Array, times: int) -> Array:
    """Return the mean of each block of `times` x `times` values of a picture (rows, columns, ...)."""
    rows, columns = values.shape[0] // times, values.shape[1] // times
    return values.reshape(rows, times, columns, times, *values.shape[2:]).mean((1, 3))


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
    # With all joints at 0: a camera on an arm is judged at rest, since the geoms are chosen once.
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
    # One octant stands for all, as these solids are symmetric; triangles are not, and get the point itself.
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
    # Degenerate triangles have an edge of length 0.
    share = np.clip((flat * edges).sum(-1) / np.maximum((edges**2).sum(-1), 1e-12), 0.0, 1.0)
    beside = float(np.linalg.norm(flat - share[:, None] * edges, axis=-1).min())
    # Corners are counter-clockwise, so a point inside is to the left of each edge.
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
        # NaN would pass `clip` and make every ray NaN.
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
        # Links of a mission package are called after it, OmniCamera_Link1.
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
    # The setting is half the offset: both lenses lie beside the mount.
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
