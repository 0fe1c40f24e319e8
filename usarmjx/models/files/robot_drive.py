"""Drives of robots from files: those of plugins, wheels or rotors; joints and wheels that bear the robot.

`BodyTree` has the bodies of the file, sorted by the part that they belong to.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import GRAVITY
from usarmjx.models.compile.geoms import Inertia, combine_inertias, described_inertia
from usarmjx.models.compile.kinematic_tree import lowest_point, robot_at_rest
from usarmjx.models.drives import Ackermann, Drive, NoDrive, RotaryWing, SkidSteer
from usarmjx.models.drives.ground import Wheel
from usarmjx.models.files.mesh_solids import hull_mesh, round_about
from usarmjx.models.files.mjcf_solids import (
    KINDS,
    Pose,
    agrees,
    geom_colour,
    geom_inertia,
    shape_of,
    usarsim_angles,
    usarsim_vector,
    volume,
)
from usarmjx.models.files.robot_source import RobotSource, StatedDrive, listed, place_of
from usarmjx.models.types.robot import CHASSIS, BodyInertia, Motor, Part, RobotSpec, Spring
from usarmjx.models.types.shapes import SURFACES, Shape, Tyre

NO_STIFFNESS = 1e-9
"""Stiffness of a joint that has a damper alone: our springs need some [N m/rad]."""
AXIS_TOLERANCE = 1e-6
"""Largest difference of an axis' length from 1: MuJoCo makes nothing of one that is infinite."""
UNBOUNDED_TURN = 4 * np.pi
"""Range of a hinge from which on it is taken for a wheel's [rad]."""
MASSLESS = BodyInertia(mass=1e-9, at=(0.0, 0.0, 0.0), moments=(1e-12, 1e-12, 1e-12, 0.0, 0.0, 0.0))
"""Inertia of a part between two joints of a body: MuJoCo needs some."""
MESH = mujoco.mjtGeom.mjGEOM_MESH
PartSolids = tuple[tuple[Shape, ...], BodyInertia | None]
"""Solids of a part; and its inertia, where the solids' masses do not account for it."""


class BodyTree:
    """A compiled file, its bodies sorted by the part that they belong to.

    Args:
        model: The file.
        spec: Its description, for densities.
        root: The chassis' body id.
        path: The file, for messages.
        slippery: Bodies whose solids slide like casters.

    Attributes:
        owners: Numbers of chassis and parts, parents first. A part has its body's number; of a body with
            several joints that is the part of the last one, and the others have numbers above all bodies'.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        spec: mujoco.MjSpec,
        root: int,
        path: Path,
        slippery: frozenset[str] = frozenset(),
    ) -> None:
        self.model, self._path = model, path
        self._slippery = slippery
        touching = (model.geom_contype | model.geom_conaffinity) > 0
        # Without the world's geoms: a floor in the file says nothing about the robot's own solids.
        self._has_contacts = bool(np.any(touching & (model.geom_bodyid > 0)))
        self._described = {geom.id: geom for geom in spec.geoms}
        self._joint_info = {joint.id: joint.info for joint in spec.joints}
        self._owner = {root: root}
        self._frame = {root: Pose(np.zeros(3), np.eye(3))}  # of a body in the axes of its part
        self._joint: dict[int, int] = {}
        self._above: dict[int, tuple[int, Pose]] = {}  # the part that holds a part, and its pose there
        # A parent has a lower id than its children in MuJoCo: each body finds its part.
        for body in range(root + 1, model.nbody):
            self._enter(body)
        self.owners = [root, *self._joint]

    def _enter(self, body: int) -> None:
        model, parent = self.model, int(self.model.body_parentid[body])
        if parent not in self._owner:
            return  # under the world beside the chassis
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        # Balls and free joints have no single position, which a motor and its limits need.
        allowed = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        held = [joint for joint in joints if model.jnt_type[joint] not in allowed]
        if held:
            names = ", ".join(model.joint(joint).name or f"number {joint}" for joint in held)
            kind = mujoco.mjtJoint(model.jnt_type[held[0]]).name[6:].lower()
            raise SpecError(
                f"{self._place(held[0])}: body {model.body(body).name!r} has the joint {names}, which is of "
                f"kind {kind}; parts have hinges and slides"
            )
        holder = self._owner[parent]
        pose = self._frame[parent].compose(model.body_pos[body], model.body_quat[body])
        if not joints:
            self._owner[body], self._frame[body] = holder, pose
            return
        # MuJoCo turns a body about its first joint first: it holds the second one, and so on.
        for joint in joints:
            if not abs(float(np.linalg.norm(model.jnt_axis[joint])) - 1) < AXIS_TOLERANCE:
                raise SpecError(f"{self._place(joint)}: joint {model.joint(joint).name!r} has no axis")
            anchor = Pose(model.jnt_pos[joint], np.eye(3))
            # Numbers above all bodies' cannot meet those of bodies.
            part = body if joint == joints[-1] else model.nbody + joint
            self._joint[part] = joint
            self._above[part] = holder, pose.then(anchor)
            # A part's axes have their origin at its joint's anchor, a body's at the body: go back there.
            holder, pose = part, Pose(-model.jnt_pos[joint], np.eye(3))
        self._owner[body], self._frame[body] = body, pose

    def _place(self, joint: int) -> str:
        """Return file and line of a joint."""
        return place_of(self._path, self._joint_info[joint])

    def _members(self, owner: int) -> list[int]:
        return [body for body, mine in self._owner.items() if mine == owner]

    def name(self, owner: int) -> str:
        """Return the name of a part: its joint's, else its body's."""
        model = self.model
        if self.owners[0] == owner:
            return CHASSIS
        joint = self._joint[owner]
        body = int(model.jnt_bodyid[joint])
        name = model.joint(joint).name or (model.body(body).name if owner == body else "")
        if not name:
            raise SpecError(f"{self._place(joint)}: a joint of body number {body} has no name: give it one")
        return name

    def joint_of(self, owner: int) -> int:
        """Return the joint of a part's body."""
        return self._joint[owner]

    def holder_of(self, owner: int) -> int:
        """Return the part that holds a part."""
        return self._above[owner][0]

    def axis(self, owner: int) -> np.ndarray:
        """Return the axis of a part's joint in USARSim's axes of the part (3,)."""
        return np.array(usarsim_vector(self.model.jnt_axis[self._joint[owner]]))

    def is_limited(self, owner: int) -> bool:
        """Return whether the joint of a part has a lowest and a highest position, however far apart."""
        return bool(self.model.jnt_limited[self._joint[owner]])

    def turns_freely(self, owner: int) -> bool:
        """Return whether the joint of a part is a hinge that turns without end."""
        joint = self.joint_of(owner)
        if int(self.model.jnt_type[joint]) != int(mujoco.mjtJoint.mjJNT_HINGE):
            return False
        # Some files give wheels wide limits instead of none.
        return not self.model.jnt_limited[joint] or np.ptp(self.model.jnt_range[joint]) >= UNBOUNDED_TURN

    def touching_geoms(self, owner: int) -> list[int]:
        """Return the geoms of a part that are more than looks."""
        return [geom for geom, _ in self._geoms(owner) if not self._only_looks(geom)]

    def locate(self, body: int) -> tuple[str, Pose] | None:
        """Return the part that a body belongs to, and the body's pose in it; None: to no part."""
        if body not in self._owner:
            return None
        return self.name(self._owner[body]), self._frame[body]

    def part(self, owner: int, motor: Motor | None, rolling: set[str]) -> Part:
        """Return the part of a body with a joint."""
        model, joint = self.model, self.joint_of(owner)
        name, (holder, at) = self.name(owner), self._above[owner]
        limits = None
        if model.jnt_limited[joint]:
            # MuJoCo's ranges count from the joint's zero, ours from the pose in which the file describes it
            # (`ref`).
            low, high = (model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]).tolist()
            limits = (low, high)
        hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        shapes, inertia = self.solids(owner, "wheel" if name in rolling else "hull")
        return Part(
            name=name,
            parent=self.name(holder),
            at=usarsim_vector(at.pos),
            rotation=usarsim_angles(at.mat),
            axis=usarsim_vector(model.jnt_axis[joint]),
            joint="hinge" if hinge else "slide",
            motor=motor,
            limits=limits,
            spring=self._spring(joint, driven=motor is not None),
            shapes=shapes,
            inertia=inertia,
            looks=self.looks(owner),
            is_wheel=name in rolling and motor is not None,
        )

    def _spring(self, joint: int, *, driven: bool) -> Spring | None:
        """Return a joint's spring and damper; without a spring the damper is part of the motor."""
        model, qposadr = self.model, self.model.jnt_qposadr[joint]
        stiffness = float(np.ravel(model.jnt_stiffness[joint])[0])
        damping = float(np.ravel(model.dof_damping[model.jnt_dofadr[joint]])[0])
        if stiffness == 0 and (damping == 0 or driven):
            return None
        rest = float(model.qpos_spring[qposadr] - model.qpos0[qposadr])
        return Spring(
            stiffness=stiffness or NO_STIFFNESS, damping=damping, load=-rest * (stiffness or NO_STIFFNESS)
        )

    def solids(self, owner: int, surface: str) -> PartSolids:
        """Return the solids of a part, with masses if these account for its inertia; else its inertia too.

        Raises:
            SpecError: A geom of a kind that robots cannot have, or a part without mass.
        """
        model = self.model
        if owner >= model.nbody:
            return (), MASSLESS
        whole = combine_inertias([self._inertia(body) for body in self._members(owner)])
        if whole.mass <= 0:
            named = "the chassis" if owner == self.owners[0] else self.name(owner)
            raise SpecError(f"{named} has no mass: give its body an inertial or its geoms a density")
        geoms = [pair for pair in self._geoms(owner) if not self._only_looks(pair[0])]
        light = [self._shape(owner, geom, frame, surface) for geom, frame in geoms]
        # Meshes have no closed form here: with one of them the body's own inertia is stated.
        if all(mujoco.mjtGeom(model.geom_type[geom]) in KINDS for geom, _ in self._geoms(owner)):
            masses = [self._mass(geom) for geom, _ in geoms]
            own = [geom_inertia(model, *geom, mass) for geom, mass in zip(geoms, masses, strict=True)]
            if own and agrees(combine_inertias(own), whole):
                return tuple(replace(s, mass=mass) for s, mass in zip(light, masses, strict=True)), None
        return tuple(light), described_inertia(whole)

    def looks(self, owner: int) -> tuple[Shape, ...]:
        """Return the visuals of a part: its meshes without contacts; empty if it has none."""
        found = [
            self._shape(owner, geom, frame, "fixture")
            for geom, frame in self._geoms(owner)
            if self._only_looks(geom)
        ]
        # Visuals of robots have to be opaque, see `Part`.
        return tuple(replace(shape, rgba=(*shape.rgba[:3], 1.0)) for shape in found)

    def _geoms(self, owner: int) -> list[tuple[int, Pose]]:
        """Return the geoms of a part, with the pose of each one's body in it."""
        first, count = self.model.body_geomadr, self.model.body_geomnum
        return [
            (geom, self._frame[body])
            for body in self._members(owner)
            for geom in range(first[body], first[body] + count[body])
        ]

    def grip(self, owner: int) -> bool:
        """Let the solids of a part grip the ground as wheels do; return whether they slid."""
        model = self.model
        slid = {model.body(body).name for body in self._members(owner)} & self._slippery
        self._slippery -= slid
        return bool(slid)

    def _only_looks(self, geom: int) -> bool:
        """Return whether a geom is a mesh for pictures, in a file whose other geoms collide."""
        model = self.model
        touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        return self._has_contacts and not touches and model.geom_type[geom] == MESH

    def _surface(self, geom: int, usual: str) -> str:
        """Return the surface of a geom."""
        model = self.model
        if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            return "fixture"
        return "caster" if model.body(model.geom_bodyid[geom]).name in self._slippery else usual

    def _shape(self, owner: int, geom: int, frame: Pose, surface: str) -> Shape:
        """Return a geom as a solid without mass: a mesh as its hull, or as a cylinder if it rolls."""
        model = self.model
        if model.geom_type[geom] != MESH:
            return shape_of(model, geom, frame, self._surface(geom, surface), 0.0)
        placed = frame.compose(model.geom_pos[geom], model.geom_quat[geom])
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        corners = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)
        like = Shape(kind="mesh", surface=self._surface(geom, surface), rgba=geom_colour(model, geom))
        if owner != self.owners[0] and self.turns_freely(owner):
            axis = np.array(model.jnt_axis[self.joint_of(owner)])
            drum = round_about(corners @ placed.mat.T + placed.pos, axis, np.zeros(3))
            if drum is not None:
                radius, half, middle = drum
                return replace(
                    like,
                    kind="cylinder",
                    size=(radius, half),
                    at=usarsim_vector(middle),
                    rotation=usarsim_angles(frame_along(axis)),
                )
        # Corners are in MuJoCo's axes, as those of all meshes; the shape's rotation brings them into ours.
        return replace(
            like,
            mesh=hull_mesh(np.ascontiguousarray(corners).tobytes()),
            at=usarsim_vector(placed.pos),
            rotation=usarsim_angles(placed.mat),
        )

    def _mass(self, geom: int) -> float:
        """Return the mass that a geom would contribute to its body."""
        described = self._described[geom]
        if np.isfinite(described.mass):
            return float(described.mass)
        return described.density * volume(self.model, geom)

    def _inertia(self, body: int) -> Inertia:
        model, frame = self.model, self._frame[body]
        placed = frame.compose(model.body_ipos[body], model.body_iquat[body])
        tensor = placed.mat @ np.diag(model.body_inertia[body]) @ placed.mat.T
        return Inertia(float(model.body_mass[body]), placed.pos, tensor)


def frame_along(axis: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) whose z axis is the given unit vector (3,)."""
    axis = np.asarray(axis, float)
    # The axis that is least parallel: the cross product cannot vanish.
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], -1)


SIDEWAYS, UPRIGHT = 0.9, 0.9
"""Smallest cosine of a wheel's axis to the lateral one, and of a steering axis to the vertical."""
MIN_ROTORS = 4
"""Smallest number of thrusters of a robot that flies."""
DEFAULT_SPIN = 6.2832
"""Default of the highest speed of a wheel [rad/s]: the wheel joint's in the UDK version."""
MIDDLE = 0.01
"""Distance from the middle plane within which a wheel is on neither side [m]."""
MAX_LIFT, LIFT_SHARE = 0.02, 0.25
"""Largest height of a wheel above the lowest point of its robot: [m], and as a share of its radius."""
OFF_CENTRE = 0.2
"""Largest distance of a wheel's middle from its axis, over its radius."""
FLIGHT_SPEED, FLIGHT_TURN, FLIGHT_TILT = 5.0, 2.0, math.radians(25)
"""Highest speed, turning rate and tilt of a robot with rotors [m/s], [rad/s], [rad] (chosen)."""
FLIGHT_DRAG = 1.0
"""Drag coefficient of its box (chosen)."""
THRUST_RATIO = 2.0
"""Thrust over weight of rotors without a limit (chosen)."""
MAX_SINKING = 1e-3
"""Depth to which a wheel may sink under its share of the weight [m]."""
STOCK_SLIP = Tyre().slip


@dataclass(frozen=True, kw_only=True, eq=False)
class RollingPart:
    """A part on a hinge that turns without end, as a candidate for a wheel.

    Attributes:
        owner: Its body.
        joint: Name of its joint.
        at: Position of the joint in the chassis, MuJoCo's axes [m] (3,).
        axis: Axis of the joint in the chassis (3,).
        radius: Radius of its round solid about the axis [m]; 0: none is round.
        bottom: Height of that solid's lowest point above the robot's lowest one [m].
        is_caster: Whether it hangs on another part that turns without end.
        bears: Whether a part hangs on it that is no roller: a leg turns with its motor, a wheel does not.
    """

    owner: int
    joint: str
    at: np.ndarray
    axis: np.ndarray
    radius: float
    bottom: float = 0.0
    is_caster: bool = False
    bears: bool = False

    @property
    def rolls(self) -> bool:
        """Whether it is round, bears nothing and reaches the ground, give or take its springs."""
        return self.radius > 0 and not self.bears and self.bottom <= max(MAX_LIFT, LIFT_SHARE * self.radius)


def rolling_parts(tree: BodyTree) -> list[RollingPart]:
    """Return all parts that may be wheels, in the file's order."""
    data = at_rest(tree)
    root = tree.owners[0]
    mat, pos = data.xmat[root].reshape(3, 3), data.xpos[root]
    found: list[RollingPart] = []
    free = {owner for owner in tree.owners[1:] if tree.turns_freely(owner)}
    lows = {owner: lowest_point_of_part(tree, owner, data) for owner in tree.owners}
    ground = min(lows.values())
    for owner in tree.owners[1:]:
        if owner in free:
            joint = tree.joint_of(owner)
            solids, _ = tree.solids(owner, "wheel")
            radius = max((_radius(solid, tree.axis(owner)) for solid in solids), default=0.0)
            at = mat.T @ (data.xanchor[joint] - pos)
            found.append(
                RollingPart(
                    owner=owner,
                    joint=tree.name(owner),
                    at=at,
                    axis=mat.T @ data.xaxis[joint],
                    radius=radius,
                    # A knee's drum does not reach the ground, though the foot below it does.
                    bottom=max(lows[owner], float(at[2]) - radius) - ground,
                    is_caster=tree.holder_of(owner) in free,
                    bears=_bears(tree, owner, data),
                )
            )
    return found


def at_rest(tree: BodyTree) -> mujoco.MjData:
    """Return the poses of a robot whose joints are at their zeros."""
    data = mujoco.MjData(tree.model)
    mujoco.mj_kinematics(tree.model, data)
    return data


def _bears(tree: BodyTree, owner: int, data: mujoco.MjData) -> bool:
    """Return whether a part hangs on another that is no roller: it has limits, or an axis parallel to its."""
    own = data.xaxis[tree.joint_of(owner)]
    held = [one for one in tree.owners[1:] if tree.holder_of(one) == owner]
    return any(
        not tree.turns_freely(one) or abs(float(data.xaxis[tree.joint_of(one)] @ own)) >= SIDEWAYS
        for one in held
    )


def lowest_point_of_part(tree: BodyTree, owner: int, data: mujoco.MjData) -> float:
    """Return the height of a part's lowest point in the chassis' axes [m]; infinite without solids."""
    model, root = tree.model, tree.owners[0]
    mat, pos = data.xmat[root].reshape(3, 3), data.xpos[root]
    lowest = math.inf
    for geom in tree.touching_geoms(owner):
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        turn = mat.T @ data.geom_xmat[geom].reshape(3, 3)
        at = mat.T @ (data.geom_xpos[geom] - pos) + turn @ middle
        # `geom_aabb` is a box in the geom's own axes: exact for boxes, too large for turned round bodies.
        kind, size = model.geom_type[geom], model.geom_size[geom]
        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            reach = float(size[0])
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            upright = abs(float(turn[2, 2]))
            # A tilted wheel does not reach as low as the box around it.
            reach = float(size[0]) * math.sqrt(max(0.0, 1 - upright**2)) + float(size[1]) * upright
        elif kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first = model.mesh_vertadr[mesh]
            corners = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
            # The third row of the turn gives heights: the corners need not be turned as a whole.
            reach = float(-((corners - middle) @ turn[2]).min())
        else:
            reach = float(np.abs(turn[2]) @ half)
        lowest = min(lowest, float(at[2]) - reach)
    return lowest


def _radius(solid: Shape, axis: np.ndarray) -> float:
    """Return the radius of a solid of a part that is round about the part's axis (3,); else 0."""
    if solid.kind not in ("cylinder", "sphere", "capsule"):
        return 0.0
    aside = float(np.linalg.norm(np.cross(solid.at, axis)))
    return solid.size[0] if aside <= OFF_CENTRE * solid.size[0] else 0.0


def find_drive(
    tree: BodyTree, source: RobotSource, speeds: dict[str, float], driven: set[str] | None
) -> Drive:
    """Return a robot's drive.

    Args:
        tree: Its bodies.
        source: Its file; notes say what is left out.
        speeds: Highest speed of joints that state one [rad/s].
        driven: Joints with a motor in the file; None: it names none.
    """
    parts = {part.joint: part for part in rolling_parts(tree)}
    for stated in source.drives:
        drive = _stated_drive(stated, tree, parts, speeds, source)
        if drive is not None:
            return drive
    wheels = [
        part for part in parts.values() if abs(part.axis[1]) >= SIDEWAYS and part.rolls and not part.is_caster
    ]
    moved = [part for part in wheels if driven is None or part.joint in driven]
    # Left is +y here: these are the file's axes, not USARSim's.
    left = [part.joint for part in moved if part.at[1] > MIDDLE]
    right = [part.joint for part in moved if part.at[1] < -MIDDLE]
    steering = _steering_joints(tree, {part.owner: part for part in wheels})
    # All wheels on one axle: turning these would not steer.
    has_axles = wheels and np.ptp([part.at[0] for part in wheels]) > MIDDLE
    if left and right and steering and has_axles:
        return _car(wheels, set(left + right), steering, speeds, math.inf)
    if left and right:
        return _skid(left, right, parts, speeds, StatedDrive(kind="skid"))
    sideways = [p.joint for p in parts.values() if abs(p.axis[0]) >= SIDEWAYS and p.rolls and not p.is_caster]
    if sideways:
        source.notes.append(
            f"{source.path}: wheels {listed(sideways)} roll along y: no drive; a robot's x axis points ahead"
        )
    return NoDrive()


def _stated_drive(
    stated: StatedDrive,
    tree: BodyTree,
    parts: dict[str, RollingPart],
    speeds: dict[str, float],
    source: RobotSource,
) -> Drive | None:
    """Return the drive that a plugin states; None, with a note, if the robot has not its joints."""
    lost = [name for name in (*stated.left, *stated.right) if name not in parts]
    if lost or not (stated.left and stated.right):
        said = f"joints {listed(lost)} are no wheels" if lost else "it names no wheels on both sides"
        source.notes.append(f"{stated.place}: drive is left out: {said}")
        return None
    if stated.kind == "ackermann":
        # Without the tests for roundness and ground: the plugin says which wheels drive.
        wheels = [part for part in parts.values() if abs(part.axis[1]) >= SIDEWAYS and not part.is_caster]
        steering = _steering_joints(tree, {part.owner: part for part in wheels})
        if steering:
            return _car(wheels, {*stated.left, *stated.right}, steering, speeds, stated.max_speed)
        source.notes.append(f"{stated.place}: no wheel hangs on a steering joint: the drive skids")
    return _skid([*stated.left], [*stated.right], parts, speeds, stated)


def _skid(
    left: list[str],
    right: list[str],
    parts: dict[str, RollingPart],
    speeds: dict[str, float],
    stated: StatedDrive,
) -> SkidSteer:
    wheels = [*left, *right]
    radius = next((parts[name].radius for name in wheels if parts[name].radius > 0), stated.radius)
    # The slowest wheel decides: a faster command would make the robot turn instead of going straight.
    spins = [speeds[name] for name in wheels if name in speeds]
    if math.isfinite(stated.max_speed) and radius > 0:
        spins.append(stated.max_speed / radius)
    lateral = [parts[name].at[1] for name in wheels]
    return SkidSteer(
        left=tuple(left),
        right=tuple(right),
        max_spin=min(spins, default=DEFAULT_SPIN),
        radius=radius or stated.radius,
        max_turn=stated.max_turn,
        # Only a controller that limits the turning rate uses it, see `SkidSteer`.
        lever=float(np.ptp(lateral)) if math.isfinite(stated.max_turn) else 0.0,
    )


def _steering_joints(tree: BodyTree, wheels: dict[int, RollingPart]) -> dict[str, tuple[str, float]]:
    """Return joints that steer a wheel: their name and largest angle, by the wheel's joint."""
    found: dict[str, tuple[str, float]] = {}
    data = at_rest(tree)
    upwards = data.xmat[tree.owners[0]].reshape(3, 3)[:, 2]
    for owner, wheel in wheels.items():
        steer = tree.holder_of(owner)
        if steer == tree.owners[0] or tree.turns_freely(steer):
            continue
        joint = tree.joint_of(steer)
        if tree.model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
            continue  # a suspension
        if abs(float(data.xaxis[joint] @ upwards)) >= UPRIGHT and tree.model.jnt_limited[joint]:
            # The smaller side, as a car steers equally far to both.
            found[wheel.joint] = (tree.name(steer), float(np.abs(tree.model.jnt_range[joint]).min()))
    return found


def _car(
    wheels: list[RollingPart],
    powered: set[str],
    steering: dict[str, tuple[str, float]],
    speeds: dict[str, float],
    max_speed: float,
) -> Ackermann:
    fore = max(part.at[0] for part in wheels)
    angles = {
        ahead: [angle for part in wheels if part.joint in steering and (part.at[0] > fore - MIDDLE) == ahead
                for _, angle in [steering[part.joint]]]
        for ahead in (True, False)
    }  # fmt: skip
    radius = next((part.radius for part in wheels if part.joint in powered and part.radius > 0), 0.0)
    spins = [speeds[name] for name in powered if name in speeds]
    if math.isfinite(max_speed) and radius > 0:
        spins.append(max_speed / radius)
    return Ackermann(
        wheels=tuple(
            Wheel(
                joint=part.joint,
                steer=steering[part.joint][0] if part.joint in steering else "",
                x=float(part.at[0]),
                # To USARSim's axes, whose y points right.
                y=-float(part.at[1]),
                powered=part.joint in powered,
            )
            for part in wheels
        ),
        max_spin=min(spins, default=DEFAULT_SPIN),
        radius=radius,
        # The smallest: each wheel of an axle has to reach the angle.
        max_front_steer=min(angles[True], default=0.0),
        max_rear_steer=min(angles[False], default=0.0),
    )


def wheel_torque(mass: float, radius: float, wheels: int, grip: float = 0.8) -> float:
    """Return the torque at which a robot's wheels begin to slip [N m], for motors without a limit."""
    # Each wheel is taken to bear the same share of the weight.
    return mass * GRAVITY * grip * radius / max(wheels, 1)


def rotor_drive(model: mujoco.MjModel, root: int, rotors: list[int], size: np.ndarray) -> RotaryWing:
    """Return the drive of a robot with thrusters on sites.

    Args:
        model: The compiled file.
        root: The chassis' body.
        rotors: Its actuators.
        size: Lengths of the robot's box [m] (3,).
    """
    mass = float(model.body_subtreemass[root])
    lift = 0.0
    for rotor in rotors:
        most = (
            float(np.abs(model.actuator_ctrlrange[rotor]).max())
            if model.actuator_ctrllimited[rotor]
            else np.inf
        )
        # The third number of a gear is the force along the site's z axis.
        lift += abs(float(model.actuator_gear[rotor, 2])) * float(model.actuator_gainprm[rotor, 0]) * most
    # Without limits, or with controls that are no newtons, the file does not tell the thrust.
    if not np.isfinite(lift) or lift <= mass * GRAVITY:
        lift = THRUST_RATIO * mass * GRAVITY
    x, y, z = size.tolist()
    # The drive divides by it, and a point mass in a file has none.
    inertia = np.maximum(model.body_inertia[root], 1e-9).tolist()
    # Rotors stand about half way between the middle and the corners of the box.
    arm = float(np.hypot(x, y)) / 4
    return RotaryWing(
        max_speeds=(FLIGHT_SPEED / 2, FLIGHT_SPEED, FLIGHT_SPEED),
        max_turn=FLIGHT_TURN,
        mass=mass,
        inertia=(inertia[0], inertia[1], inertia[2]),
        # The face of the box across each axis, times the coefficient [m2].
        drag_areas=(FLIGHT_DRAG * y * z, FLIGHT_DRAG * x * z, FLIGHT_DRAG * x * y),
        max_thrust=lift,
        max_torque=(lift * arm / 2, lift * arm / 2, lift * arm / 10),
        acceleration_tilt=FLIGHT_TILT,
    )


def borne_inertias(tree: BodyTree) -> dict[int, float]:
    """Return the inertia that each bearing joint moves while its feet stand [kg m2 or kg], by part.

    A robot whose chassis reaches the ground is borne by that, and by no joint.
    """
    data, model = at_rest(tree), tree.model
    lows = {owner: lowest_point_of_part(tree, owner, data) for owner in tree.owners}
    ground = min(lows.values())
    feet = {owner for owner, low in lows.items() if low <= ground + MAX_LIFT}
    # The ground holds it up: its joints carry arms and tools only.
    if tree.owners[0] in feet:
        return {}
    # Every foot bears the same: the distribution depends on the gait, which a file does not state.
    share = float(model.body_subtreemass[tree.owners[0]]) / len(feet)
    found: dict[int, float] = {}
    for foot in feet:
        place = np.mean([data.geom_xpos[geom] for geom in tree.touching_geoms(foot)], axis=0)
        up = data.xmat[tree.owners[0]].reshape(3, 3)[:, 2]
        # A foot stands on its underside, not at the middle of its geoms.
        place = place + up * (ground - float(up @ (place - data.xpos[tree.owners[0]])))
        owner = foot
        while owner != tree.owners[0]:
            joint = tree.joint_of(owner)
            lever = 1.0
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
                lever = float(np.linalg.norm(np.cross(data.xaxis[joint], place - data.xanchor[joint])))
            # Mass at a lever: the inertia that the joint feels; a slide's lever is 1.
            found[owner] = found.get(owner, 0.0) + share * lever**2
            owner = tree.holder_of(owner)
    return found


def with_firm_wheels(robot: RobotSpec, wheels: Collection[str]) -> RobotSpec:
    """Return a robot whose wheels on the ground sink at most by about `MAX_SINKING`.

    MuJoCo makes a contact as soft as the body is light that it touches, whatever rests on that body: under a
    force f the depth is (1 - d) f w t^2 d, for impedance d, inverse weight w of the body and time constant t.

    Args:
        robot: The robot.
        wheels: Names of the parts that roll.
    """
    parts = [part for part in robot.parts if part.name in wheels and part.shapes]
    if not parts:
        return robot
    model, data, own = robot_at_rest(robot)
    lows = {
        part.name: lowest_point(model, data, model.geom_bodyid == model.body(part.name).id) for part in parts
    }
    ground = lowest_point(model, data, own)
    borne = [part for part in parts if lows[part.name] <= ground + MAX_LIFT]
    if not borne:
        return robot
    force = float(np.sum(model.body_mass)) * float(np.abs(model.opt.gravity[2])) / len(borne)
    firm = {
        part.name: MAX_SINKING / depth
        for part in borne
        if (depth := _depth(part, force * float(model.body_invweight0[model.body(part.name).id, 0])))
        > MAX_SINKING
    }
    changed = tuple(_firmer(part, firm[part.name]) if part.name in firm else part for part in robot.parts)
    return replace(robot, parts=changed)


def _depth(part: Part, acceleration: float) -> float:
    """Return how deep a wheel sinks [m], from the acceleration of its free body by the same force [m/s2]."""
    surface = SURFACES[part.shapes[0].surface]
    impedance = surface.solimp[1]
    return (1.0 - impedance) * impedance * surface.solref[0] ** 2 * acceleration


def _firmer(part: Part, share: float) -> Part:
    """Return a wheel whose contact sinks to a share of its depth."""
    tyre = Tyre(min_slip=STOCK_SLIP * share)
    return replace(part, shapes=tuple(replace(shape, tyre=tyre) for shape in part.shapes))
