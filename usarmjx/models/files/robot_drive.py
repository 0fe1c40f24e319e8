"""Drives of robots from files: those of plugins, wheels or rotors; joints and wheels that bear the robot."""

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from usarmjx.base.transforms import GRAVITY
from usarmjx.models.compile.kinematic_tree import lowest_point, robot_at_rest
from usarmjx.models.drives import Ackermann, Drive, NoDrive, RotaryWing, SkidSteer
from usarmjx.models.drives.ground import Wheel
from usarmjx.models.files.body_tree import BodyTree
from usarmjx.models.files.robot_source import RobotSource, StatedDrive, listed
from usarmjx.models.types.robot import Part, RobotSpec
from usarmjx.models.types.shapes import SURFACES, Shape, Tyre

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
        kind, size = model.geom_type[geom], model.geom_size[geom]
        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            reach = float(size[0])
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            upright = abs(float(turn[2, 2]))
            reach = float(size[0]) * math.sqrt(max(0.0, 1 - upright**2)) + float(size[1]) * upright
        elif kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first = model.mesh_vertadr[mesh]
            corners = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
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
    left = [part.joint for part in moved if part.at[1] > MIDDLE]
    right = [part.joint for part in moved if part.at[1] < -MIDDLE]
    steering = _steering_joints(tree, {part.owner: part for part in wheels})
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
                y=-float(part.at[1]),
                powered=part.joint in powered,
            )
            for part in wheels
        ),
        max_spin=min(spins, default=DEFAULT_SPIN),
        radius=radius,
        max_front_steer=min(angles[True], default=0.0),
        max_rear_steer=min(angles[False], default=0.0),
    )


def wheel_torque(mass: float, radius: float, wheels: int, grip: float = 0.8) -> float:
    """Return the torque at which a robot's wheels begin to slip [N m], for motors without a limit."""
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
        lift += abs(float(model.actuator_gear[rotor, 2])) * float(model.actuator_gainprm[rotor, 0]) * most
    if not np.isfinite(lift) or lift <= mass * GRAVITY:
        lift = THRUST_RATIO * mass * GRAVITY
    x, y, z = size.tolist()
    inertia = np.maximum(model.body_inertia[root], 1e-9).tolist()
    arm = float(np.hypot(x, y)) / 4
    return RotaryWing(
        max_speeds=(FLIGHT_SPEED / 2, FLIGHT_SPEED, FLIGHT_SPEED),
        max_turn=FLIGHT_TURN,
        mass=mass,
        inertia=(inertia[0], inertia[1], inertia[2]),
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
    if tree.owners[0] in feet:
        return {}
    share = float(model.body_subtreemass[tree.owners[0]]) / len(feet)
    found: dict[int, float] = {}
    for foot in feet:
        place = np.mean([data.geom_xpos[geom] for geom in tree.touching_geoms(foot)], axis=0)
        up = data.xmat[tree.owners[0]].reshape(3, 3)[:, 2]
        place = place + up * (ground - float(up @ (place - data.xpos[tree.owners[0]])))
        owner = foot
        while owner != tree.owners[0]:
            joint = tree.joint_of(owner)
            lever = 1.0
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
                lever = float(np.linalg.norm(np.cross(data.xaxis[joint], place - data.xanchor[joint])))
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
