"""Descriptions to MuJoCo: an arena and its robots as bodies of one MjSpec.

Every robot is a free body with the name prefix that the caller gives ("r0/"); within it, `chassis`, one
body per wheel and one per mission package link, each with one joint of the same name and one actuator.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.models.spec import SURFACES, ArenaSpec, Link, MissionPackage, RobotSpec, Shape, Wheel
from usarmjx.transforms import Vec3, flip_angles, flip_vector, mat_from_angles, quat_from_angles

GEOM_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
}
FLOOR_SIZE = (0.0, 0.0, 1.0)
"""MuJoCo: a plane with zero half sizes is unbounded."""
FLOOR_RGBA = (0.9, 0.85, 0.4, 1.0)
WHEEL_RGBA = (0.15, 0.15, 0.15, 1.0)
LINK_STIFFNESS, LINK_DAMPING, LINK_ARMATURE = 40.0, 4.0, 0.02
"""Servo of a mission package joint [N m/rad], [N m s/rad], [kg m2]: stiff for parts of some 0.5 kg."""
AXLE = (-np.pi / 2, 0.0, 0.0)
"""Turns a cylinder's axis (z) to the left (y), so that a positive joint angle rolls forward."""


@dataclass(frozen=True)
class Physics:
    """Solver and time settings of a scene.

    The elliptic cone with friction impedance ratio 2 lets robots turn in place as rigid wheels do and
    hold slopes; CG is as fast as Newton for few robots, far faster for many, and free of the batched
    Cholesky factorisation. docs/design.md tables the measurements.

    Attributes:
        timestep: Physics step [s].
        substeps: Physics steps per control step.
        iterations: Cap on solver iterations.
        ls_iterations: Cap on line-search iterations.
        contacts_per_robot: Room in contact buffers, on average over a world's robots.
        pairs_per_robot: Geom pairs of one kind that `jax` looks at closely, likewise; the nearest by
            bounding spheres.
    """

    timestep: float = 0.005
    substeps: int = 4
    impratio: float = 2.0
    iterations: int = 10
    ls_iterations: int = 10
    contacts_per_robot: int = 16
    pairs_per_robot: int = 32

    @property
    def period(self) -> float:
        """The control step [s]."""
        return self.timestep * self.substeps


def new_spec(arena: ArenaSpec, physics: Physics) -> mujoco.MjSpec:
    """Return a model description with the arena, its floor and no robots.

    The arena's solids hang on one mocap body, so that a batch can place them differently in each world.
    """
    spec = mujoco.MjSpec()
    spec.modelname = arena.name
    option = spec.option
    option.timestep = physics.timestep
    # MJX-JAX's implicitfast goes on damping a servo that is at its force limit, C and Warp do not; with
    # Euler all three agree, and the servos' gains are low enough for it.
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.solver = mujoco.mjtSolver.mjSOL_CG
    option.impratio = physics.impratio
    # One contact per pair of convex geoms: with several, wheels stick at the edge of a 4 cm board.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
    option.iterations = physics.iterations
    option.ls_iterations = physics.ls_iterations
    floor = Shape(kind="box", size=FLOOR_SIZE, at=(0.0, 0.0, arena.floor), surface="ground", rgba=FLOOR_RGBA)
    _add_geom(spec.worldbody, "floor", floor, kind=mujoco.mjtGeom.mjGEOM_PLANE)
    body = spec.worldbody.add_body(name="arena", pos=[0.0, 0.0, arena.floor], mocap=True)
    for i, shape in enumerate(arena.shapes):
        _add_geom(body, f"arena/{i}", shape)
    return spec


def cap_contacts(spec: mujoco.MjSpec, physics: Physics, robots: int) -> None:
    """Bound what MJX-JAX computes, in the custom numbers that it reads; other engines ignore them."""
    room = max(1, robots)
    spec.add_numeric(name="max_contact_points", size=1, data=[room * physics.contacts_per_robot])
    spec.add_numeric(name="max_geom_pairs", size=1, data=[room * physics.pairs_per_robot])


def with_short_boxes(spec: mujoco.MjSpec, longest: float) -> mujoco.MjModel:
    """Return the model with the arena's boxes cut into pieces of at most `longest` [m] along each axis.

    For engines that look for contacts by bounding spheres, to which a long wall is near everything.
    """
    spec = spec.copy()
    arena = spec.body("arena")
    if arena is None:
        return spec.compile()
    for geom in list(arena.geoms):
        parts = [max(1, int(np.ceil(2 * half / longest - 1e-6))) for half in geom.size]
        if geom.type != mujoco.mjtGeom.mjGEOM_BOX or max(parts) == 1:
            continue
        mat = np.zeros(9)
        mujoco.mju_quat2Mat(mat, geom.quat)
        kept = ("type", "quat", "rgba", "friction", "priority", "contype", "conaffinity", "condim", "mass")
        shared = {name: getattr(geom, name) for name in kept}
        for piece in np.ndindex(*parts):
            offset = (2 * (np.array(piece) + 0.5) / parts - 1) * geom.size
            name = f"{geom.name}/{'.'.join(map(str, piece))}"
            pos = geom.pos + mat.reshape(3, 3) @ offset
            arena.add_geom(name=name, pos=pos, size=geom.size / parts, **shared)
        spec.delete(geom)
    return spec.compile()


def add_robot(spec: mujoco.MjSpec, robot: RobotSpec, prefix: str, pos: Vec3, yaw: float = 0.0) -> None:
    """Add a robot of that class whose chassis origin starts at `pos`, with names starting with `prefix`."""
    chassis = spec.worldbody.add_body(name=f"{prefix}chassis", pos=pos, quat=quat_from_angles(0, 0, yaw))
    chassis.add_freejoint(name=f"{prefix}root")
    for i, shape in enumerate(robot.chassis):
        _add_geom(chassis, f"{prefix}chassis/{i}", _flip(shape))
    for wheel in robot.wheels:
        _add_wheel(spec, chassis, robot, wheel, prefix)
    for package in robot.packages:
        _add_package(spec, chassis, package, prefix)


def remove_robot(spec: mujoco.MjSpec, prefix: str) -> None:
    """Remove the robot with that prefix, with its joints, actuators and exclusions."""
    for exclude in list(spec.excludes):
        if exclude.bodyname1.startswith(prefix):
            spec.delete(exclude)
    for actuator in list(spec.actuators):
        if actuator.name.startswith(prefix):
            spec.delete(actuator)
    spec.delete(spec.body(f"{prefix}chassis"))


def part_name(package: MissionPackage, link: Link) -> str:
    """Return the wire's name of a mission package part (captured: `CameraPanTilt_Link2`)."""
    return f"{package.name}_Link{link.number}"


def _flip(shape: Shape) -> Shape:
    """Return a robot's shape in MuJoCo's axes."""
    return Shape(**{**vars(shape), "at": flip_vector(shape.at), "rotation": flip_angles(shape.rotation)})


def _add_geom(body: mujoco.MjsBody, name: str, shape: Shape, kind: mujoco.mjtGeom | None = None) -> None:
    surface = SURFACES[shape.surface]
    body.add_geom(
        name=name,
        type=GEOM_TYPES[shape.kind] if kind is None else kind,
        size=[*shape.size, 0.0, 0.0][:3],
        pos=shape.at,
        quat=quat_from_angles(*shape.rotation),
        mass=shape.mass,
        rgba=shape.rgba,
        friction=[surface.friction, 0.005, 0.0001],
        priority=surface.priority,
        contype=surface.contype,
        conaffinity=surface.conaffinity,
        condim=3,
    )


def _add_wheel(
    spec: mujoco.MjSpec, chassis: mujoco.MjsBody, robot: RobotSpec, wheel: Wheel, prefix: str
) -> None:
    body = chassis.add_body(name=prefix + wheel.name, pos=flip_vector(wheel.at))
    drive = robot.drive
    body.add_joint(name=prefix + wheel.name, axis=[0, 1, 0], armature=drive.armature)
    size = (wheel.radius, wheel.width / 2)
    tyre = Shape(kind="cylinder", size=size, rotation=AXLE, mass=wheel.mass, surface="wheel", rgba=WHEEL_RGBA)
    _add_geom(body, prefix + wheel.name, tyre)
    _add_servo(spec, prefix + wheel.name, drive.stiffness, drive.damping, drive.torque)


def _add_servo(spec: mujoco.MjSpec, name: str, stiffness: float, damping: float, torque: float) -> None:
    actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_intvelocity(kp=stiffness, kv=damping)
    actuator.forcerange = [-torque, torque]
    actuator.forcelimited = True
    actuator.actlimited = False


def link_frames(package: MissionPackage) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return each link's position (3,) and matrix (3, 3) in the chassis frame, USARSim's axes."""
    frames = {-1: (np.zeros(3), np.eye(3))}
    for link in package.links:
        at, mat = frames[link.parent]
        frames[link.number] = (at + mat @ link.location, mat @ mat_from_angles(*np.array(link.orientation)))
    return frames


def _add_package(spec: mujoco.MjSpec, chassis: mujoco.MjsBody, package: MissionPackage, prefix: str) -> None:
    """Parts are parallel to the chassis at rest (captured mounts show it); joints turn about link z."""
    frames = link_frames(package)
    bodies = {-1: chassis}
    for link in package.links:
        name = prefix + part_name(package, link)
        offset = frames[link.number][0] - frames[link.parent][0]
        body = bodies[link.parent].add_body(name=name, pos=flip_vector(tuple(offset)))
        bodies[link.number] = body
        kind = mujoco.mjtJoint.mjJNT_HINGE if link.joint == "Revolute" else mujoco.mjtJoint.mjJNT_SLIDE
        axis = flip_vector(tuple(frames[link.number][1][:, 2]))
        body.add_joint(name=name, type=kind, axis=axis, armature=LINK_ARMATURE)
        for i, shape in enumerate(link.shapes):
            _add_geom(body, f"{name}/{i}", _flip(shape))
        _add_servo(spec, name, LINK_STIFFNESS, LINK_DAMPING, link.max_torque)
        if link.parent != -1:  # MuJoCo itself leaves out parent and child
            spec.add_exclude(bodyname1=f"{prefix}chassis", bodyname2=name)
