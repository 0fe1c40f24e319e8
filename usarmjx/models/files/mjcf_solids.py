"""Solids and masses of a body from an MJCF or URDF file."""

from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import angles_from_mat, flip_angles, flip_vector
from usarmjx.models.compile.geoms import Inertia
from usarmjx.models.types.robot import Vec3
from usarmjx.models.types.shapes import Rgba, Shape

KINDS = {
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
}
"""Kinds of shapes by MuJoCo's geom types."""
SIZES = {"box": 3, "sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3}
"""Number of size numbers of each kind."""
DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
"""Colour of geoms for which a file has none; any other wins over their material's."""
INERTIA_TOLERANCE = 1e-6
"""Relative difference of masses and inertias that is neglected."""
GIMBAL_TOLERANCE = 1e-7
"""Cosine of the pitch below which roll and yaw are one rotation."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame in another: position (3,) and orientation (3, 3), MuJoCo's axes."""

    pos: np.ndarray
    mat: np.ndarray

    def compose(self, pos: np.ndarray, quat: np.ndarray) -> "Pose":
        """Return a frame that is given relative to this one, by position (3,) and quaternion (4,)."""
        return self.then(Pose(pos, mat_of(quat)))

    def then(self, offset: "Pose") -> "Pose":
        """Return a frame that is given relative to this one."""
        return Pose(self.pos + self.mat @ offset.pos, self.mat @ offset.mat)


def mat_of(quat: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a w-first quaternion (4,)."""
    # MuJoCo's functions write into a flat array of doubles.
    mat = np.zeros(9)
    mujoco.mju_quat2Mat(mat, quat)
    return mat.reshape(3, 3)


def usarsim_vector(vector: np.ndarray) -> Vec3:
    """Convert a vector (3,) from MuJoCo's axes to USARSim's."""
    # Plus 0.0: -0.0 becomes 0.0, or files would show its sign.
    x, y, z = (np.array(flip_vector(vector.tolist())) + 0.0).tolist()
    return (x, y, z)


def usarsim_angles(mat: np.ndarray) -> Vec3:
    """Convert an orientation (3, 3) from MuJoCo's axes to roll, pitch, yaw in USARSim's."""
    angles = angles_from_mat(mat)
    if np.hypot(mat[0, 0], mat[1, 0]) < GIMBAL_TOLERANCE:
        # Roll and yaw are one rotation then: all of it counts as yaw.
        angles = np.array([0.0, angles[1], np.arctan2(-mat[0, 1], mat[1, 1])])
    roll, pitch, yaw = (np.array(flip_angles(angles.tolist())) + 0.0).tolist()
    return (roll, pitch, yaw)


def geom_colour(model: mujoco.MjModel, geom: int) -> Rgba:
    """Return the colour in which MuJoCo draws a geom."""
    material, own = int(model.geom_matid[geom]), tuple(model.geom_rgba[geom].tolist())
    # The default cannot be told from a colour that was not written.
    if material >= 0 and own == DEFAULT_RGBA:
        own = tuple(model.mat_rgba[material].tolist())
    return own


def shape_of(model: mujoco.MjModel, geom: int, frame: Pose, surface: str, mass: float) -> Shape:
    """Return a geom as a shape of a part; `frame` is the pose of the geom's body in the part's axes.

    Raises:
        SpecError: A geom of a kind that robots cannot have.
    """
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind not in KINDS:
        name = model.geom(geom).name or f"number {geom}"
        raise SpecError(f"geom {name} is a {kind.name[7:].lower()}; robots have {', '.join(KINDS.values())}")
    placed = frame.compose(model.geom_pos[geom], model.geom_quat[geom])
    touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
    return Shape(
        kind=KINDS[kind],  # type: ignore[arg-type]
        size=tuple(model.geom_size[geom][: SIZES[KINDS[kind]]].tolist()),
        at=usarsim_vector(placed.pos),
        rotation=usarsim_angles(placed.mat),
        mass=mass,
        surface=surface if touches else "fixture",
        rgba=geom_colour(model, geom),
    )


def geom_inertia(model: mujoco.MjModel, geom: int, frame: Pose, mass: float) -> Inertia:
    """Return the inertia of a homogeneous geom of that mass, in the axes of `frame`."""
    x, y, z = model.geom_size[geom]
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        # Sizes are half lengths: the usual twelfth of whole ones squared is a third here.
        moments = np.array([y * y + z * z, x * x + z * z, x * x + y * y]) / 3
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        moments = np.array([y * y + z * z, x * x + z * z, x * x + y * y]) / 5
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        moments = np.full(3, 2 * x * x / 5)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        side = x * x / 4 + y * y / 3
        moments = np.array([side, side, x * x / 2])
    else:  # a capsule: a cylinder and two half balls, whose centres of mass are 3/8 r beyond its ends
        rod, ball = _capsule_shares(x, y)
        side = rod * (x * x / 4 + y * y / 3) + ball * (2 * x * x / 5 + y * y + 3 * x * y / 4)
        moments = np.array([side, side, rod * x * x / 2 + ball * 2 * x * x / 5])
    placed = frame.compose(model.geom_pos[geom], model.geom_quat[geom])
    return Inertia(mass, placed.pos, placed.mat @ np.diag(mass * moments) @ placed.mat.T)


def _capsule_shares(radius: float, half: float) -> tuple[float, float]:
    """Return the shares of a capsule's volume in its cylinder and in its two half balls."""
    rod, ball = 2 * half, 4 * radius / 3
    return rod / (rod + ball), ball / (rod + ball)


def volume(model: mujoco.MjModel, geom: int) -> float:
    """Return the volume of a geom [m3]."""
    x, y, z = model.geom_size[geom].tolist()
    volumes = {
        "box": 8 * x * y * z,
        "sphere": 4 / 3 * np.pi * x * x * x,  # a power of a large number raises
        "capsule": np.pi * x * x * (2 * y + 4 / 3 * x),
        "cylinder": 2 * np.pi * x * x * y,
        "ellipsoid": 4 / 3 * np.pi * x * y * z,
    }
    return volumes[KINDS[mujoco.mjtGeom(model.geom_type[geom])]]


def agrees(one: Inertia, other: Inertia) -> bool:
    """Return whether two inertias are equal within the tolerance."""
    if abs(one.mass - other.mass) > INERTIA_TOLERANCE * other.mass:
        return False
    # About the radius of gyration: tolerances grow with the body.
    reach = np.sqrt(np.trace(other.tensor) / other.mass)
    near = np.abs(one.centre - other.centre).max() <= INERTIA_TOLERANCE * reach
    return bool(
        near and np.abs(one.tensor - other.tensor).max() <= INERTIA_TOLERANCE * np.trace(other.tensor)
    )
