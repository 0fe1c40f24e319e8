"""The kinematic tree of a robot class with its shapes and servos, as arrays; measurements of it.

Sensors need the poses of a robot's bodies and shapes. Computing them from the robot's own state with its own
tree, rather than reading an engine's arrays, makes sensors independent of the engine, of the other robots in
the model, and of the half step by which an engine's poses trail its state.
"""

from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from typing import NamedTuple

import mujoco
import numpy as np

from usarmjx.base.backend import Array, xp
from usarmjx.base.nodes import Node
from usarmjx.base.rotations import mat_from_quat, matmul, matvec
from usarmjx.base.transforms import Vec3
from usarmjx.models.compile.compose import RobotIndex, add_robot, index_robot, new_spec
from usarmjx.models.compile.parts import chassis_visuals, joint_names, parts_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.ray_geoms import ray_primitives_of
from usarmjx.models.compile.visuals import Solids, VisualModel, build_visual_model, flipped
from usarmjx.models.drives.base import RobotState
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import CHASSIS, Motor, RobotSpec

MEASUREMENT_DECIMALS = 6
"""Decimals of the measurements, micrometres and milligrams: kinematic trees are in single precision."""
ROUND = ("sphere", "capsule", "cylinder", "ellipsoid")
"""Kinds of shapes whose first size is the radius of a wheel."""


class BodyPoses(Node, kw_only=True):
    """Poses of a robot's bodies: chassis, then its parts.

    Attributes:
        pos: Origins in the world [m] (bodies, 3).
        mat: Orientations (bodies, 3, 3).
    """

    pos: Array
    mat: Array


class JointMotions(NamedTuple):
    """Motion of bodies in their parents for joints at q: a slide or a rotation.

    The origin is at `offset + q * slide`, the orientation is `fixed + sin(q) * sine + cos(q) * cosine`: that
    at rest times Rodrigues' formula.

    Attributes:
        offset: Body origins with the joints at 0 [m] (joints, 3).
        slide: Direction of prismatic joints, zero for hinges (joints, 3).
        fixed: Constant term of the orientation (joints, 3, 3).
        sine: Factor of the sine (joints, 3, 3).
        cosine: Factor of the cosine (joints, 3, 3).
    """

    offset: np.ndarray
    slide: np.ndarray
    fixed: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray


class BodyLevel(NamedTuple):
    """The bodies at one depth of the tree.

    Attributes:
        joints: Their joints (n,).
        parents: Indices of their parents within the level above (n,); None: the only one there.
    """

    joints: np.ndarray
    parents: np.ndarray | None


@dataclass(frozen=True, eq=False)
class KinematicTree:
    """A robot class, resolved.

    Attributes:
        robot: The description.
        parts: Body names as the wire uses them: HARD, then its parts.
        parent: Parent body of each body; -1 for the chassis.
        offset: Body origin in its parent (bodies, 3).
        rest_mat: Orientation of the body in its parent with its joint at 0 (bodies, 3, 3).
        axis: Joint axis in the body (bodies, 3); zero for the chassis.
        slides: Whether the joint is prismatic (bodies,).
        rest_pos: Body origins on the chassis with all joints at 0 (bodies, 3).
        geom_type: MuJoCo geom types (geoms,); meshes are split into triangles, see `ray_geoms`.
        geom_body: The body each geom belongs to (geoms,).
        geom_size: MuJoCo sizes (geoms, 3).
        geom_pos: Geom centres in their body (geoms, 3).
        geom_mat: Geom orientations in their body (geoms, 3, 3).
        geom_rgb: Their colours (geoms, 3).
        actuated: Indices of the joints with a motor (actuators,).
        mass: Mass of the built model [kg].
        centre_of_mass: Centre of mass on the chassis with all joints at 0 [m].
        chassis_centre: Centre of mass of the chassis alone [m].
        inertia: Inertia about the centre of mass with all joints at 0, in the chassis' axes [kg m2] (3, 3).
        clearance: Height of the chassis origin above the lowest point of the robot at rest [m].
    """

    robot: RobotSpec
    parts: tuple[str, ...]
    parent: tuple[int, ...]
    offset: np.ndarray
    rest_mat: np.ndarray
    axis: np.ndarray
    slides: np.ndarray
    rest_pos: np.ndarray
    geom_type: np.ndarray
    geom_body: np.ndarray
    geom_size: np.ndarray
    geom_pos: np.ndarray
    geom_mat: np.ndarray
    geom_rgb: np.ndarray
    actuated: np.ndarray
    mass: float
    centre_of_mass: Vec3
    chassis_centre: Vec3
    inertia: np.ndarray
    clearance: float

    @cached_property
    def solids(self) -> Solids:
        """Its geoms, for contacts and the rays of sensors. Their frames are the bodies."""
        return Solids(
            kind=self.geom_type,
            frame=self.geom_body,
            size=self.geom_size,
            pos=self.geom_pos,
            mat=self.geom_mat,
            rgb=self.geom_rgb,
        )

    @cached_property
    def visuals(self) -> VisualModel:
        """Its visuals, for pictures only: their frames are the bodies.

        Raises:
            SpecError: A visual is not opaque.
        """
        looks = [chassis_visuals(self.robot), *(part.looks for part in parts_of(self.robot))]
        return build_visual_model([[flipped(shape) for shape in some] for some in looks])

    @cached_property
    def rest_frames(self) -> np.ndarray:
        """Orientations of the bodies on the chassis with all joints at 0 (bodies, 3, 3); see `rest_pos`."""
        frames = [np.eye(3, dtype=np.float32)]
        for parent, own in zip(self.parent[1:], self.rest_mat[1:], strict=True):
            frames.append(frames[parent] @ own)
        return np.stack(frames)

    @cached_property
    def joint_motions(self) -> JointMotions:
        """Motion of the bodies in their parents, see `forward_kinematics`."""
        # In double precision: only the products are rounded to single.
        rest, slides = self.rest_mat[1:].astype(float), self.slides[1:, None]
        x, y, z = self.axis[1:].astype(float).T
        zero = np.zeros_like(x)
        # K, the axis' cross-product matrix: R = 1 + sin(q) K + (1 - cos(q)) K^2 (Rodrigues).
        across = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
        # Slides keep their orientation, so their factors of sine and cosine are zero.
        twice = np.where(slides[:, None], 0.0, rest @ across @ across)
        motions = (
            self.offset[1:],
            np.where(slides, (rest @ self.axis[1:, :, None])[..., 0], 0.0),
            rest + twice,
            np.where(slides[:, None], 0.0, rest @ across),
            -twice,
        )
        return JointMotions(*(np.asarray(motion, np.float32) for motion in motions))

    @cached_property
    def levels(self) -> tuple[BodyLevel, ...]:
        """Bodies of the tree below the chassis, level by level."""
        levels, above = list[BodyLevel](), [0]
        while below := [body for body, parent in enumerate(self.parent) if parent in above]:
            # Indices within the level above, which is all that the loop over levels has at hand.
            parents = np.array([above.index(self.parent[body]) for body in below])
            levels.append(BodyLevel(np.array(below) - 1, parents if len(above) > 1 else None))
            above = below
        return tuple(levels)

    @cached_property
    def body_order(self) -> np.ndarray:
        """Index of each body in the concatenation of the chassis and the levels (bodies,)."""
        # The inverse of a permutation: the chassis counts as joint -1.
        return np.argsort(np.concatenate([[-1], *(level.joints for level in self.levels)]))

    def joint_index(self, name: str) -> int | None:
        """Return the index of a joint by its name, case ignored; None if unknown."""
        return self._joint_indices.get(name.lower())

    @cached_property
    def _joint_indices(self) -> dict[str, int]:
        return {part.lower(): joint for joint, part in enumerate(self.parts[1:])}


@cache
def kinematic_tree_of(robot: RobotSpec) -> KinematicTree:
    """Return the kinematic tree of a robot class, read off its compiled model."""
    # Read off the compiled model instead of computed: geoms, masses and axes are then MuJoCo's own.
    nowhere = ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0)))
    spec = new_spec(nowhere, Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    index = index_robot(model, robot, "")
    body = list(index.body_ids)
    local = {b: i for i, b in enumerate(body)}
    geoms = np.array([g for g in range(model.ngeom) if model.geom_bodyid[g] in local], int)
    mats = np.zeros((len(geoms), 9))
    for mat, g in zip(mats, geoms, strict=True):
        mujoco.mju_quat2Mat(mat, model.geom_quat[g])
    pieces = ray_primitives_of(model, geoms)
    piece_pos, piece_mat = pieces.world_poses(model.geom_pos[geoms], mats.reshape(-1, 3, 3))
    turns = np.zeros((len(body), 9))
    for mat, b in zip(turns, body, strict=True):
        mujoco.mju_quat2Mat(mat, model.body_quat[b])
    joints = np.array([model.body_jntadr[b] for b in body[1:]], int)
    x, y, z = (model.body_mass[body] @ data.xipos[body] / model.body_mass[body].sum()).tolist()
    return KinematicTree(
        robot=robot,
        parts=(CHASSIS, *joint_names(robot)),
        parent=tuple(local.get(int(model.body_parentid[b]), -1) for b in body),
        offset=model.body_pos[body].astype(np.float32),
        rest_mat=turns.reshape(-1, 3, 3).astype(np.float32),
        axis=np.concatenate([np.zeros((1, 3)), model.jnt_axis[joints]]).astype(np.float32),
        slides=np.array([False, *(model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE)]),
        rest_pos=data.xpos[body].astype(np.float32),
        geom_type=pieces.kind,
        geom_body=np.array([local[int(model.geom_bodyid[g])] for g in geoms[pieces.geom]]),
        geom_size=pieces.size,
        geom_pos=np.asarray(piece_pos, np.float32),
        geom_mat=np.asarray(piece_mat, np.float32),
        geom_rgb=model.geom_rgba[geoms[pieces.geom], :3].astype(np.float32),
        actuated=np.array([i for i, part in enumerate(parts_of(robot)) if part.motor is not None], int),
        mass=float(model.body_subtreemass[body[0]]),
        centre_of_mass=(x, y, z),
        chassis_centre=tuple(data.xipos[body[0]].tolist()),
        inertia=_inertia(model, data, body, np.array([x, y, z])).astype(np.float32),
        clearance=-lowest_point(
            model, data, model.geom_bodyid >= 2
        ),  # bodies 0 and 1 are the world and the arena
    )


def _inertia(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], centre: np.ndarray) -> np.ndarray:
    """Return the inertia of bodies about a point, with current kinematics [kg m2] (3, 3)."""
    total = np.zeros((3, 3))
    for body in bodies:
        axes, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - centre
        total += axes @ np.diag(model.body_inertia[body]) @ axes.T
        # Parallel axis theorem (Steiner).
        total += model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return total


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> float:
    """Return the height of the lowest point of the masked geoms (ngeom,) [m]; kinematics must be current.

    Solids are exact; other types, such as terrain, count as their bounding sphere.
    """
    return float(-_reach(model, data, geoms, np.array([0.0, 0.0, -1.0])))


def bounding_corners(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest corner (3,) of the box around the masked geoms; see `lowest_point`."""
    axes = np.eye(3)
    low = np.array([-_reach(model, data, geoms, -axis) for axis in axes])
    return low, np.array([_reach(model, data, geoms, axis) for axis in axes])


def _reach(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray, way: np.ndarray) -> float:
    """Return the largest coordinate of the masked geoms along a direction (3,) [m]."""
    # The direction in each geom's own axes, where its extent is known.
    local = data.geom_xmat.reshape(-1, 3, 3).swapaxes(1, 2) @ way
    up = np.abs(local)
    radius, length = model.geom_size[:, 0], model.geom_size[:, 1]
    kinds = mujoco.mjtGeom
    reach = np.select(
        [
            model.geom_type == kind
            for kind in (kinds.mjGEOM_BOX, kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE, kinds.mjGEOM_ELLIPSOID)
        ],
        [
            (up * model.geom_size).sum(-1),
            radius,
            radius + length * up[:, 2],
            # Support function of an ellipsoid: length of the direction, scaled by the half axes.
            np.sqrt(((up * model.geom_size) ** 2).sum(-1)),
        ],
        np.where(
            model.geom_type == kinds.mjGEOM_CYLINDER,
            radius * np.sqrt(np.maximum(0.0, 1 - up[:, 2] ** 2)) + length * up[:, 2],
            model.geom_rbound,
        ),
    )
    for geom in np.nonzero(geoms & (model.geom_type == kinds.mjGEOM_MESH))[0]:
        mesh = model.geom_dataid[geom]
        corners = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        reach[geom] = (corners @ local[geom]).max()
    return (data.geom_xpos @ way + reach)[geoms].max()


def robot_state(index: RobotIndex, qpos: Array, qvel: Array) -> RobotState:
    """Pick a robot's state out of its world's qpos (..., nq) and qvel (..., nv)."""
    q, v = index.root_qposadr, index.root_dofadr
    return RobotState(
        pos=qpos[..., q : q + 3],
        quat=qpos[..., q + 3 : q + 7],
        linear=qvel[..., v : v + 3],
        angular=qvel[..., v + 3 : v + 6],
        joint_pos=qpos[..., np.array(index.qposadr, int)],
        joint_vel=qvel[..., np.array(index.dofadr, int)],
    )


def forward_kinematics(tree: KinematicTree, state: RobotState) -> BodyPoses:
    """Return the poses of robots' bodies, with the leading axes of their state.

    One step per level of the tree, not per body: fewer and larger operations compile and run faster.
    """
    move, q = tree.joint_motions, state.joint_pos[..., None]
    angle = q[..., None]
    # For all joints at once, slides too, whose factors are zero: no branch by kind.
    turned = move.fixed + xp.sin(angle) * move.sine + xp.cos(angle) * move.cosine
    away = move.offset + q * move.slide
    pos, mat = [state.pos[..., None, :]], [mat_from_quat(state.quat)[..., None, :, :]]
    for joints, parents in tree.levels:
        below, frame = pos[-1], mat[-1]
        if parents is not None:
            below, frame = below[..., parents, :], frame[..., parents, :, :]
        pos.append(below + matvec(frame, away[..., joints, :]))
        mat.append(matmul(frame, turned[..., joints, :, :]))
    return BodyPoses(
        pos=xp.concatenate(pos, -2)[..., tree.body_order, :],
        mat=xp.concatenate(mat, -3)[..., tree.body_order, :, :],
    )


def geom_poses(tree: KinematicTree, bodies: BodyPoses) -> tuple[Array, Array]:
    """Return the world poses of robots' geoms: centres (..., geoms, 3), orientations (..., geoms, 3, 3)."""
    return tree.solids.poses(bodies.pos, bodies.mat)


@dataclass(frozen=True, eq=False)
class Servos:
    """Constants of a robot's joint servos (joints,); joints without a motor have zeros and ones.

    Attributes:
        speed: Highest speed.
        torque: Highest torque.
        stiffness: Gain on the position.
        damping: Gain on the velocity.
        armature: Inertia of the motor.
        low: Lowest position.
        high: Highest position.
        lead: Distance of a servo's target ahead of its joint per joint speed, without torque.
        windup_limit: Further distance of the target, just enough for full torque. Without the bound a stalled
            wheel would have to unwind first, and a braked one would roll back.
        brake_limit: The same for a joint at commanded speed 0.
        has_brake: Whether the braking torque differs from the driving torque.
        stall_limit: Additional distance at standstill.
        surge: Acceleration by its torque of a joint with a stall torque and its share of the robot [rad/s^2].
    """

    speed: np.ndarray
    torque: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    armature: np.ndarray
    low: np.ndarray
    high: np.ndarray
    lead: np.ndarray
    windup_limit: np.ndarray
    surge: np.ndarray
    brake_limit: np.ndarray
    has_brake: np.ndarray
    stall_limit: np.ndarray

    @cached_property
    def brakes(self) -> bool:
        """Whether any joint has a brake."""
        return bool(self.has_brake.any())

    @cached_property
    def stalls(self) -> bool:
        """Whether any joint has a stall torque."""
        return bool(self.stall_limit.any())


@cache
def servos_of(robot: RobotSpec) -> Servos:
    """Return the servo constants of a robot class."""
    parts = parts_of(robot)
    # Stiffness and armature are divisors: ones keep the constants of joints without a motor finite.
    no_motor = Motor(max_speed=0.0, torque=0.0, stiffness=1.0, damping=0.0, armature=1.0)
    motors = [part.motor or no_motor for part in parts]
    limits = [part.limits or (-np.inf, np.inf) for part in parts]

    def row(values: list[float]) -> np.ndarray:
        return np.array(values, np.float32)

    return Servos(
        speed=row([m.max_speed for m in motors]),
        torque=row([m.torque for m in motors]),
        stiffness=row([m.stiffness for m in motors]),
        damping=row([m.damping for m in motors]),
        armature=row([m.armature for m in motors]),
        low=row([low for low, _ in limits]),
        high=row([high for _, high in limits]),
        lead=row([m.damping / m.stiffness for m in motors]),
        windup_limit=row([m.torque / m.stiffness for m in motors]),
        brake_limit=row([(m.torque if m.brake is None else m.brake) / m.stiffness for m in motors]),
        stall_limit=row([((m.stall_torque or m.torque) - m.torque) / m.stiffness for m in motors]),
        surge=row([_surge(robot, m, motors) for m in motors]),
        has_brake=np.array([m.brake is not None for m in motors], bool),
    )


def _surge(robot: RobotSpec, motor: Motor, motors: list[Motor]) -> float:
    if motor.stall_torque is None:
        return 0.0
    # A wheel that pushes its share of the robot has this mass at its rim.
    share = robot.mass / sum(one.stall_torque is not None for one in motors)
    return motor.torque / (motor.armature + share * robot.wheel_radius**2)


@cache
def actuated_servos(tree: KinematicTree) -> tuple[np.ndarray | slice, Servos]:
    """Return the joints of a robot class with a motor, and the constants of these alone (actuators,)."""
    servos, here = servos_of(tree.robot), tree.actuated
    own = Servos(**{field.name: getattr(servos, field.name)[here] for field in fields(servos)})
    # A slice where all joints have a motor: it saves a gather at every step.
    return slice(None) if len(here) == len(servos.speed) else here, own


def with_measurements(robot: RobotSpec) -> RobotSpec:
    """Return a robot with dimensions, mass, height and wheel measurements of its parts.

    `dimensions` are those of the box around it at rest, `wheel_separation` and `wheel_base` the largest
    distances of its wheels.

    Raises:
        SpecError: It cannot be built.
    """
    tree = kinematic_tree_of(robot)
    low, high = bounding_box(robot)
    wheels = [i for i, part in enumerate(tree.parts) if part in {wheel.name for wheel in robot.wheels}]
    spread = np.ptp(tree.rest_pos[wheels], axis=0) if wheels else np.zeros(3)
    # MuJoCo's first size of all round kinds is the radius.
    radii = [shape.size[0] for part in robot.wheels for shape in part.shapes if shape.kind in ROUND]
    length, width, height = (high - low).round(MEASUREMENT_DECIMALS).tolist()
    return replace(
        robot,
        dimensions=(length, width, height),
        mass=round(tree.mass, MEASUREMENT_DECIMALS),
        origin_height=round(tree.clearance, MEASUREMENT_DECIMALS),
        wheel_radius=radii[0] if radii else 0.0,
        wheel_separation=round(float(spread[1]), MEASUREMENT_DECIMALS),
        wheel_base=round(float(spread[0]), MEASUREMENT_DECIMALS),
    )


def bounding_box(robot: RobotSpec) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner of the box around a robot at rest [m] (3,), MuJoCo's axes."""
    return bounding_corners(*robot_at_rest(robot))


def robot_at_rest(robot: RobotSpec) -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray]:
    """Return the model of a robot in an empty arena, its data at rest, and which geoms are its own (n,)."""
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data, model.geom_bodyid >= 2  # bodies 0 and 1 are the world and the arena


def chassis_heights(robot: RobotSpec) -> np.ndarray:
    """Return how high the lowest point of each of the chassis' solids is above that of the robot [m] (n,)."""
    model, data, own = robot_at_rest(robot)
    lows = np.zeros(len(robot.chassis))
    for i in range(len(lows)):
        lows[i] = lowest_point(model, data, np.arange(model.ngeom) == model.geom(f"chassis/{i}").id)
    return lows - lowest_point(model, data, own)
