"""Composition of descriptions to MuJoCo: an arena and its robots as bodies of one MjSpec.

Every robot is a free body with the caller's name prefix ("r0/"); within it, `chassis`, one body per part
(wheels, flippers, legs, mission package links, fingers), each with one joint of the same name and, if it has
a motor, an actuator. Parts of one robot do not touch each other: joint limits keep them apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

import mujoco
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.transforms import Vec3, flip_angles, flip_vector, mat_from_angles, quat_from_angles
from usarmjx.models.compile.geoms import add_geom, arena_inertia, set_inertia, stated_inertia
from usarmjx.models.compile.parts import chassis_shapes, joint_names, parts_of
from usarmjx.models.compile.physics import CONES, SOLVERS, Physics
from usarmjx.models.compile.victims import segment_poses, victim_table
from usarmjx.models.compile.visuals import flipped
from usarmjx.models.types.arena import ArenaSpec, Door, LooseObject
from usarmjx.models.types.robot import CHASSIS, HOLD_SUFFIX, Motor, Part, RobotSpec
from usarmjx.models.types.shapes import OPAQUE, SURFACES, Shape, texture_code

DOOR_GAP = 0.01
"""Gap between a door and the floor [m]."""
FLOOR_SIZE = (0.0, 0.0, 1.0)
"""Size of an unbounded plane in MuJoCo: zero half sizes."""
FLOOR_RGBA = (0.87, 0.88, 0.88, 1.0)
"""Light grey, the colour of the floor beyond its checkers in pictures."""
ARENA_PREFIX, LOOSE_PREFIX, DOOR_PREFIX, VICTIM_PREFIX = "arena/", "loose/", "door/", "victim/"
"""Prefixes of the names of geoms: of fixed solids, loose objects, doors and victims' bones."""
WORLD, ARENA = "world", "arena"
"""Names of the bodies that do not move."""
HOLD_SOLREF, HOLD_SOLIMP = (0.01, 1.0), (0.999, 0.999, 0.001, 0.5, 2.0)
"""Stiffness of what holds an object in the air: 100 N move one of 18 kg by less than 1 mm."""
MAX_BOX_PIECES = 512
"""Largest number of pieces of an arena's boxes, for engines that need short boxes."""
MAX_BODY_SOLIDS = 256
"""Largest number of fixed solids of the body `arena`; more are geoms of the world. In each step MuJoCo
computes the bounds of all geoms of a body, but not the world's."""
REFERENCE_GEOMS = 7
"""Touching geoms of a P2AT, the reference of contacts_per_robot and pairs_per_robot."""
LOOSE_CONTACTS = 5
"""Capacity of contact buffers per touching geom of a loose object: a resting box has four contacts."""
CONTACT_FIELDS = ("friction", "priority", "contype", "conaffinity", "condim", "surfacevel")
"""Fields of a geom that its contacts depend on."""
Ids = tuple[int, ...]
"""Indices of a robot's items, in the order of `RobotIndex`."""


def door_panel(door: Door) -> Shape:
    """Return the panel of a door in the frame of its hinge, which has its x axis along the door."""
    width, thickness, height = door.size
    return Shape(
        kind="box",
        size=(width / 2, thickness / 2, (height - DOOR_GAP) / 2),
        at=(width / 2, 0.0, (height + DOOR_GAP) / 2),
        mass=door.mass,
        surface="wall",
        rgba=door.rgba,
    )


def door_boxes(arena: ArenaSpec, angles: Array, xp: ModuleType = np) -> tuple[Array, Array, np.ndarray]:
    """Return the poses of the panels of an arena's doors in the world, and their half lengths.

    Args:
        arena: The arena.
        angles: Angles of the hinges [rad] (doors,).
        xp: Array module of the angles.

    Returns:
        Centres [m] (doors, 3), orientations (doors, 3, 3), half lengths [m] (doors, 3).
    """
    panels = [door_panel(door) for door in arena.doors]
    foot = np.array([door.at for door in arena.doors], np.float32).reshape(-1, 3)
    offset = np.array([panel.at for panel in panels], np.float32).reshape(-1, 3)
    size = np.array([panel.size for panel in panels], np.float32).reshape(-1, 3)
    zero = xp.zeros_like(angles)
    mat = mat_from_angles(zero, zero, np.array([door.yaw for door in arena.doors], np.float32) + angles, xp)
    pos = foot + np.array([0.0, 0.0, arena.floor]) + (mat * offset[:, None]).sum(-1)
    return pos.astype(np.float32), mat.astype(np.float32), size


def add_arena(spec: mujoco.MjSpec, arena: ArenaSpec, *, moves: bool = False) -> None:
    """Add the arena and its floor to an empty description.

    Args:
        spec: The description.
        arena: The arena.
        moves: Whether the poses of its fixed solids are data: then all are on the body `arena`.

    Raises:
        SpecError: A solid that cannot be built; see `geoms.add_geom` and `victims.victim_table`.
    """
    if arena.has_floor:
        at = (0.0, 0.0, arena.floor)
        floor = Shape(kind="box", size=FLOOR_SIZE, at=at, surface="ground", rgba=FLOOR_RGBA)
        add_geom(spec, spec.worldbody, "floor", floor, kind=mujoco.mjtGeom.mjGEOM_PLANE)
    body = spec.worldbody.add_body(name=ARENA, pos=[0.0, 0.0, arena.floor], mocap=True)
    of_world = len(arena.shapes) > MAX_BODY_SOLIDS and not moves
    for i, shape in enumerate(arena.shapes):
        geom = add_geom(spec, spec.worldbody if of_world else body, f"{ARENA_PREFIX}{i}", shape)
        # Geoms of the world lack the lift of the body `arena`.
        geom.pos[2] += arena.floor if of_world else 0.0
    _add_victims(spec, body, arena)
    for loose in arena.loose:
        add_loose(spec, loose, arena.floor)
    for door in arena.doors:
        _add_door(spec, door, arena.floor)


def _add_victims(spec: mujoco.MjSpec, body: mujoco.MjsBody, arena: ArenaSpec) -> None:
    """Add the boxes of victims and false alarms in their initial poses."""
    table = victim_table(arena.victims, arena.false_alarms)
    pos, quat = segment_poses(table, np.zeros(()))
    for i in range(table.num_boxes):
        skin = Shape(kind="box", size=tuple(table.size[i]), surface="ground", rgba=tuple(table.rgba[i]))
        geom = add_geom(spec, body, f"{VICTIM_PREFIX}{i}", skin)
        geom.pos, geom.quat = pos[i], quat[i]


def add_loose(spec: mujoco.MjSpec, loose: LooseObject, floor: float, *, held: bool = False) -> None:
    """Add a loose object.

    Args:
        spec: The description.
        loose: The object.
        floor: Height of the arena's floor [m].
        held: Whether it hangs where it is, whatever touches it; then it does not touch floor and walls.
    """
    x, y, z = loose.at
    name = f"{LOOSE_PREFIX}{loose.name}"
    body = spec.worldbody.add_body(name=name, pos=(x, y, z + floor), quat=quat_from_angles(*loose.rotation))
    body.add_freejoint(name=name)
    for i, shape in enumerate(loose.shapes):
        add_geom(spec, body, f"{name}/{i}", shape)
    if loose.inertia is not None:
        set_inertia(body, arena_inertia(loose.inertia), loose.shapes)
    if held:
        # A weld is a soft constraint: under its weight the object would sag.
        body.gravcomp = 1.0
        add_weld(spec, name, WORLD, name, (body.pos, body.quat))
        # Contacts with what it hangs beside would work against the weld.
        for other in (WORLD, ARENA):
            spec.add_exclude(bodyname1=other, bodyname2=name)


def remove_loose(spec: mujoco.MjSpec, name: str) -> None:
    """Remove the loose object of that name, and what holds it."""
    body = f"{LOOSE_PREFIX}{name}"
    # A list of its own: deleting changes that of the description.
    for exclude in list(spec.excludes):
        if exclude.bodyname2 == body:
            spec.delete(exclude)
    for weld in list(spec.equalities):
        if weld.name == body:
            spec.delete(weld)
    spec.delete(spec.body(body))


def add_weld(spec: mujoco.MjSpec, name: str, one: str, other: str, pose: tuple[Array | Vec3, Array]) -> None:
    """Hold a body at a pose in the axes of another one: position [m], orientation (4,)."""
    weld = spec.add_equality(name=name, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    weld.name1, weld.name2 = one, other
    weld.solref, weld.solimp = HOLD_SOLREF, HOLD_SOLIMP
    set_weld(weld.data, *pose)


def remove_weld(spec: mujoco.MjSpec, name: str) -> None:
    """Remove the weld of that name, if there is one."""
    weld = spec.equality(name)
    if weld is not None:
        spec.delete(weld)


def set_weld(data: np.ndarray, pos: Array | Vec3, quat: Array) -> None:
    """Set the numbers of a weld so that it holds an object at a pose: position [m], orientation (4,)."""
    # MuJoCo's layout: anchor, relative position, relative quaternion, torque scale.
    data[:11] = (0.0, 0.0, 0.0, *pos, *quat, 1.0)


def _add_door(spec: mujoco.MjSpec, door: Door, floor: float) -> None:
    x, y, z = door.at
    body = spec.worldbody.add_body(
        name=f"{DOOR_PREFIX}{door.name}", pos=(x, y, z + floor), quat=quat_from_angles(0.0, 0.0, door.yaw)
    )
    body.add_joint(
        name=f"{DOOR_PREFIX}{door.name}",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=(0.0, 0.0, 1.0),
        limited=True,
        range=door.limits,
        # A polynomial of the speed, of which only the linear coefficient is wanted.
        damping=[door.friction, 0.0, 0.0],
    )
    add_geom(spec, body, f"{DOOR_PREFIX}{door.name}", door_panel(door))


def split_long_boxes(spec: mujoco.MjSpec, longest: float) -> mujoco.MjModel:
    """Return the model with the arena's boxes cut into pieces of at most `longest` [m] along each axis.

    For engines whose broad phase compares bounding spheres: that of a long wall overlaps everything. If an
    arena would give more than `MAX_BOX_PIECES`, the pieces are longer.
    """
    # Other engines compile the same description with whole boxes.
    spec = spec.copy()
    arena = spec.body(ARENA)
    if arena is None:
        return spec.compile()
    owned = [(body, geom) for body in (spec.worldbody, arena) for geom in body.geoms]
    touching = [geom for _, geom in owned if geom.type == mujoco.mjtGeom.mjGEOM_BOX and geom.contype]
    boxes = np.array([geom.size for geom in touching])
    while len(boxes) and np.ceil(2 * boxes / longest - 1e-6).prod(-1).sum() > MAX_BOX_PIECES:
        longest *= 1.25
    for body, geom in owned:
        # The margin keeps a box of exactly n lengths at n pieces.
        parts = [max(1, int(np.ceil(2 * half / longest - 1e-6))) for half in geom.size]
        fixed = geom.name.startswith(ARENA_PREFIX) and geom.contype
        if geom.type != mujoco.mjtGeom.mjGEOM_BOX or max(parts) == 1 or not fixed:
            continue
        mat = np.zeros(9)
        mujoco.mju_quat2Mat(mat, geom.quat)
        kept = ("type", "quat", "rgba", "mass", *CONTACT_FIELDS)
        shared = {name: getattr(geom, name) for name in kept}
        for piece in np.ndindex(*parts):
            offset = (2 * (np.array(piece) + 0.5) / parts - 1) * geom.size
            name = f"{geom.name}/{'.'.join(map(str, piece))}"
            pos = geom.pos + mat.reshape(3, 3) @ offset
            body.add_geom(name=name, pos=pos, size=geom.size / parts, **shared)
        # The loop runs over a list that was made beforehand: deleting changes the body's own.
        spec.delete(geom)
    return spec.compile()


def new_spec(arena: ArenaSpec, physics: Physics, *, moves: bool = False) -> mujoco.MjSpec:
    """Return a model description with the arena, its floor and no robots; for `moves` see `add_arena`."""
    spec = mujoco.MjSpec()
    spec.modelname = arena.name
    spec.compiler.degree = False  # joint limits are radians, as everything here
    option = spec.option
    option.timestep = physics.timestep
    # MJX-JAX's implicitfast goes on damping a servo that is at its force limit, C and Warp do not; with
    # Euler all three agree, and the servos' gains are low enough for it.
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = CONES[physics.cone]
    option.solver = SOLVERS[physics.solver]
    option.impratio = physics.impratio
    # One contact per pair of convex geoms: with several, wheels stick at the edge of a 4 cm board.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
    option.iterations = physics.iterations
    option.ls_iterations = physics.ls_iterations
    add_arena(spec, arena, moves=moves)
    return spec


def cap_contacts(
    spec: mujoco.MjSpec, physics: Physics, arena: ArenaSpec, robots: Sequence[RobotSpec]
) -> None:
    """Set the capacity of the batch engines' contact buffers, in custom numbers that only MJX reads."""
    geoms = sum(_touching(shapes) for robot in robots for shapes in _solids(robot))
    loose = sum(_touching(thing.shapes) for thing in arena.loose)
    # Settings are per P2AT: scenes of smaller robots still get the room of one.
    contacts = max(1.0, geoms / REFERENCE_GEOMS) * physics.contacts_per_robot + loose * LOOSE_CONTACTS
    pairs = max(1.0, (geoms + loose) / REFERENCE_GEOMS) * physics.pairs_per_robot
    for name, room in (("max_contact_points", contacts), ("max_geom_pairs", pairs)):
        spec.add_numeric(name=name, size=1, data=[int(np.ceil(room))])


def _solids(robot: RobotSpec) -> list[tuple[Shape, ...]]:
    return [chassis_shapes(robot), *(part.shapes for part in parts_of(robot))]


def _touching(shapes: tuple[Shape, ...]) -> int:
    return sum(bool(SURFACES[shape.surface].contype) for shape in shapes)


def add_robot(spec: mujoco.MjSpec, robot: RobotSpec, prefix: str, pos: Vec3, yaw: float = 0.0) -> None:
    """Add a robot of that class whose chassis origin starts at `pos`, with prefixed names."""
    chassis = spec.worldbody.add_body(name=f"{prefix}chassis", pos=pos, quat=quat_from_angles(0, 0, yaw))
    chassis.add_freejoint(name=f"{prefix}root")
    solids = [flipped(shape) for shape in chassis_shapes(robot)]
    for i, shape in enumerate(solids):
        add_geom(spec, chassis, f"{prefix}chassis/{i}", shape)
    if robot.inertia is not None:
        set_inertia(chassis, stated_inertia(robot.inertia), solids)
    # Parents come first in `parts_of`, so each finds its body here.
    bodies = {CHASSIS: chassis}
    for part in parts_of(robot):
        bodies[part.name] = _add_part(spec, bodies[part.parent], part, prefix)
        if part.geared is not None:
            gear = spec.add_equality(name=prefix + part.name, type=mujoco.mjtEq.mjEQ_JOINT)
            gear.name1, gear.name2 = prefix + part.name, prefix + part.geared
            # MuJoCo's polynomial of the other joint: its constant and linear coefficients.
            gear.data[:2] = part.gear_offset, part.gear_ratio
    names = [body.name for body in bodies.values()]
    # Parts may overlap at rest, as the wheels of a track do.
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            # MuJoCo skips contacts of a parent with its child only; siblings need an exclusion.
            spec.add_exclude(bodyname1=first, bodyname2=second)


def remove_robot(spec: mujoco.MjSpec, prefix: str) -> None:
    """Remove the robot with that prefix, with its joints, gears, actuators and exclusions."""
    for exclude in list(spec.excludes):
        if exclude.bodyname1.startswith(prefix):
            spec.delete(exclude)
    for gear in list(spec.equalities):
        if gear.name.startswith(prefix):
            spec.delete(gear)
    for actuator in list(spec.actuators):
        if actuator.name.startswith(prefix):
            spec.delete(actuator)
    spec.delete(spec.body(f"{prefix}chassis"))


def _add_part(spec: mujoco.MjSpec, parent: mujoco.MjsBody, part: Part, prefix: str) -> mujoco.MjsBody:
    name = prefix + part.name
    turn = quat_from_angles(*flip_angles(part.rotation))
    body = parent.add_body(name=name, pos=flip_vector(part.at), quat=turn)
    kind = mujoco.mjtJoint.mjJNT_HINGE if part.joint == "hinge" else mujoco.mjtJoint.mjJNT_SLIDE
    joint = body.add_joint(name=name, type=kind, axis=flip_vector(part.axis))
    solids = [flipped(shape) for shape in part.shapes]
    for i, shape in enumerate(solids):
        add_geom(spec, body, f"{name}/{i}", shape)
    if part.inertia is not None:
        set_inertia(body, stated_inertia(part.inertia), solids)
    if part.motor is not None:
        joint.armature = part.motor.armature
        _add_servo(spec, joint, part.motor)
    elif part.limits is not None:
        joint.limited, joint.range = True, part.limits
    if part.spring is not None:
        spring = part.spring
        # Both are polynomials in MuJoCo, of which only the linear coefficient is wanted.
        joint.stiffness, joint.damping = [spring.stiffness, 0, 0], [spring.damping, 0, 0]
        # MuJoCo's spring exerts stiffness * (springref - position): -load at position 0.
        joint.springref = -spring.load / spring.stiffness
    return body


def _add_servo(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, motor: Motor) -> None:
    """Add a servo of limited torque as two actuators: one pulls towards its target, one holds back.

    Together they are MuJoCo's integrated-velocity servo, kp (target - position) - kv velocity. Without the
    second, whose input is 1 or 0, the first is a motor that exerts exactly kp times its target.
    """
    pull = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    pull.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
    # Its activation is the integral of its input: the target's position, of which ctrl is the speed.
    pull.gainprm[0] = motor.stiffness
    hold = spec.add_actuator(
        name=joint.name + HOLD_SUFFIX, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
    )
    hold.gaintype = mujoco.mjtGain.mjGAIN_AFFINE
    # MuJoCo's affine gain: constant, factor of the joint's position, factor of its velocity.
    hold.gainprm[:3] = [0.0, -motor.stiffness, -motor.damping]
    # The limit is on the joint and not on either actuator: only their sum is the servo's torque.
    joint.actfrclimited = True
    joint.actfrcrange = [-motor.strongest, motor.strongest]


@dataclass(frozen=True)
class RobotIndex:
    """Indices of one robot in an MjModel.

    Bodies are in the order chassis, then parts (`models.compile.parts.parts_of`); joints in that order
    without the chassis; actuators likewise, but only of the parts with a motor.

    Attributes:
        body_ids: Body ids.
        root_qposadr: Address of the free joint's 7 numbers in qpos.
        root_dofadr: Address of its 6 numbers in qvel.
        qposadr: qpos addresses of the joints.
        dofadr: qvel addresses of the joints.
        actuator_ids: Ids of the actuators that pull towards a target.
        actadr: Addresses of their activations: the targets.
        hold_actuator_ids: Ids of the actuators that hold the joints; input 1, or 0 in torque mode.
    """

    body_ids: Ids
    root_qposadr: int
    root_dofadr: int
    qposadr: Ids
    dofadr: Ids
    actuator_ids: Ids
    actadr: Ids
    hold_actuator_ids: Ids


def index_robot(model: mujoco.MjModel, robot: RobotSpec, prefix: str) -> RobotIndex:
    """Resolve the names of the robot that was composed with `prefix`."""
    names = [prefix + name for name in joint_names(robot)]
    joints = [model.joint(name) for name in names]
    motors = [prefix + part.name for part in parts_of(robot) if part.motor is not None]
    pulls = [model.actuator(name).id for name in motors]
    return RobotIndex(
        body_ids=(model.body(f"{prefix}chassis").id, *(model.body(name).id for name in names)),
        root_qposadr=int(model.joint(f"{prefix}root").qposadr[0]),
        root_dofadr=int(model.joint(f"{prefix}root").dofadr[0]),
        qposadr=tuple(int(joint.qposadr[0]) for joint in joints),
        dofadr=tuple(int(joint.dofadr[0]) for joint in joints),
        actuator_ids=tuple(pulls),
        actadr=tuple(int(model.actuator_actadr[pull]) for pull in pulls),
        hold_actuator_ids=tuple(model.actuator(name + HOLD_SUFFIX).id for name in motors),
    )


def materials_of(model: mujoco.MjModel, arena: ArenaSpec) -> list[str]:
    """Return the material of every geom of a model of that arena, one of `shapes.MATERIALS`.

    The arena's fixed solids and loose objects have their own; its floor, doors and victims, and all robots
    are opaque.
    """
    known = {f"{ARENA_PREFIX}{i}": shape.material for i, shape in enumerate(arena.shapes)}
    for loose in arena.loose:
        known |= {f"{LOOSE_PREFIX}{loose.name}/{i}": shape.material for i, shape in enumerate(loose.shapes)}
    return [known.get(model.geom(i).name, OPAQUE) for i in range(model.ngeom)]


def textures_of(model: mujoco.MjModel, arena: ArenaSpec) -> np.ndarray:
    """Return the texture codes of a model's geoms (ngeom,): those of the arena's fixed solids."""
    known = {
        f"{ARENA_PREFIX}{i}": texture_code(shape.texture)
        for i, shape in enumerate(arena.shapes)
        if shape.texture
    }
    if not known:
        return np.zeros(model.ngeom, np.int32)
    return np.array([known.get(model.geom(i).name, 0) for i in range(model.ngeom)], np.int32)
