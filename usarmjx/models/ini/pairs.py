"""Parts from ini files: part-joint pairs (manual 14.4.2.4), and the links of mission packages.

Axes are in Unreal's axes (z up) regardless of bMountByUU (KRobot.uc does not convert them), positions in the
section's units.

Mission packages are `[USARMisPkg.X]` sections, which MisPkgs lines mount on robots. The manual shows no
section of USARMisPkg.ini, and the original's refers to classes of an Unreal package. Ours gives the links of
a package directly, close to the part-joint pairs; see `docs/robots.md`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from usarmjx.base.registry import Registry
from usarmjx.base.transforms import GRAVITY, Vec3, angles_from_mat
from usarmjx.models.ini.items import JOINT_IGNORED, LINK_IGNORED, WarningLog
from usarmjx.models.ini.parameters import DEFAULT_SUSPENSION_TRAVEL
from usarmjx.models.ini.parse import (
    IniFile,
    IniValue,
    Line,
    Struct,
    Units,
    as_bool,
    as_class,
    as_name,
    as_number,
    as_struct,
    as_vector,
    fail,
    key_text,
    number_of,
    reject_unknown,
    vector_of,
)
from usarmjx.models.robots.cars import STEER_ARMATURE, STEER_TORQUE
from usarmjx.models.robots.kit import BLACK, car_wheel, firm_motor, wheel
from usarmjx.models.robots.packages import PACKAGES, mount_package
from usarmjx.models.types.robot import CHASSIS, LEFT, UP, Link, MissionPackage, Motor, Part, RobotSpec, Spring
from usarmjx.models.types.shapes import ZERO, Shape

FIELDS = (
    "PartName", "PartClass", "JointClass", "bSteeringLocked", "bSuspensionLocked", "Parent", "ParentPos",
    "ParentAxis", "ParentAxis2", "SelfPos", "SelfAxis", "SelfAxis2", "BrakeTorque", *JOINT_IGNORED,
)  # fmt: skip
"""Fields of a pair in the original."""
OWN_FIELDS = ("Radius", "Width", "Size", "Mass", "MaxSpeed", "Torque", "MinRange", "MaxRange")
"""Additional fields: the original has them in the classes of wheels and parts."""
JOINT_CLASSES = {
    "kcarwheeljoint": "wheel",
    "kscarwheeljoint": "wheel",
    "kdhinge": "hinge",
    "kslider": "slide",
}
"""Kind of joint of each JointClass."""
AXES_TOLERANCE = 0.5
"""Largest difference between the angles of a wheel's own axes and its parent's [degrees]."""
MAX_PARTS = 500
"""Largest number of parts of a robot."""
CHASSIS_NAMES = ("", "none", CHASSIS.lower())
"""Names of the chassis as a Parent."""

MIN_ARMATURE = 0.03
"""Smallest armature of a wheel's motor, else the inertia of its load [kg m2] (a P2DX's)."""

STIFFNESS, DAMPING = 667.0, 33.0
"""Gains of servos over their inertia [1/s2], [1/s] (a P2AT's)."""

WHEEL_SPEED = 6.2832
"""Default speed of wheels [rad/s]: the wheel joint's in the UDK version. Their torque is for a friction
coefficient of 1."""

HINGE_SPEED, HINGE_TORQUE = 0.1745, 20.0
"""Default speed [rad/s] and torque [N m] of hinges: MotorSpeed, MotorTorque (manual 14.4.2.3)."""

STEER_SPEED = 15000 * np.pi / 32768
"""Default steering rate [rad/s]: SteerSpeed (manual 14.4.2.3)."""

SUSPENSION_RATE, SUSPENSION_SHARE = 2 * np.pi * 2.0, 0.4
"""Suspension (chosen): natural frequency [rad/s], and share of critical damping."""

WHEEL_SHARE, PART_MASS, HUB_SHARE = 0.07, 0.5, 0.3
"""Default masses (chosen): a wheel's share of the robot, a part [kg], a hub's share of its wheel."""


@dataclass(frozen=True)
class JointPair:
    """A part-joint pair.

    Attributes:
        line: Its line.
        struct: Its fields.
        units: Units of its positions.
        number: Its number among the pairs, the Number of its `Wheels` line.
        name: PartName.
        joint: Kind: wheel, hinge or slide.
        parent: Parent part, or `HARD`.
        at: Position of the joint in the axes of the parent's joint [m].
        middle: Position of the part's middle in the axes of its joint [m].
        chassis_position: Position of the joint on the chassis, with all joints at 0 [m].
    """

    line: Line
    struct: Struct
    units: Units
    number: int
    name: str
    joint: str
    parent: str
    at: Vec3
    middle: Vec3
    chassis_position: Vec3

    @property
    def steers(self) -> bool:
        """Whether the wheel's steering is free; as in Unreal, the default is False."""
        return not self._locked("bSteeringLocked")

    @property
    def sprung(self) -> bool:
        """Whether the wheel's suspension is free."""
        return not self._locked("bSuspensionLocked")

    @property
    def brake(self) -> float | None:
        """BrakeTorque: torque at commanded speed 0 [N m]; None: unspecified."""
        value = self.struct.get("BrakeTorque")
        # 0 is allowed: the limit itself is excluded.
        return None if value is None else as_number(self.line, value, "BrakeTorque", above=-1e-9)

    def _locked(self, name: str) -> bool:
        value = self.struct.get(name)
        return value is not None and as_bool(self.line, value, name)


def read_pairs(lines: Mapping[int, tuple[Line, Units]], notes: WarningLog) -> list[JointPair]:
    """Return the pairs in the order of their numbers.

    Raises:
        SpecError: A field that is missing, unknown or wrong, a repeated name, or a parent that is not defined
            before; names file and line.
    """
    pairs: dict[str, JointPair] = {}
    # By number, wherever the lines stand in the file: parents have to come first.
    for number, (line, units) in sorted(lines.items()):
        if len(pairs) == MAX_PARTS:
            fail(line, f"this is part {len(pairs) + 1}", f"a robot of at most {MAX_PARTS}")
        struct = as_struct(line)
        reject_unknown(line, struct, (*FIELDS, *OWN_FIELDS))
        for key, _ in struct.fields:
            if reason := {name.lower(): text for name, text in JOINT_IGNORED.items()}.get(key.lower()):
                notes.add(line, f"{key} is ignored: {reason}")
        name = as_name(line, struct.get("PartName"), "PartName")
        if name.lower() in (*pairs, *CHASSIS_NAMES):
            fail(line, f"there is a part {name} already", "another PartName")
        wanted = as_class(line, struct.get("JointClass"), "JointClass")
        if wanted.lower() not in JOINT_CLASSES:
            fail(line, f"unknown JointClass {wanted!r}", "KCarWheelJoint, KDHinge or KSlider")
        parent = _parent_of(line, struct, pairs)
        self_pos = units.position(vector_of(line, struct, "SelfPos"))
        # SelfPos is the joint in the part's own axes; here the part's middle in the joint's is needed.
        middle = _add(ZERO, self_pos, -1)
        at = units.position(vector_of(line, struct, "ParentPos"))
        # ParentPos is relative to the parent's middle, positions here to its joint.
        at = _add(at, parent.middle) if parent else at
        pairs[name.lower()] = JointPair(
            line=line,
            struct=struct,
            units=units,
            number=number,
            name=name,
            joint=JOINT_CLASSES[wanted.lower()],
            parent=parent.name if parent else CHASSIS,
            at=at,
            middle=middle,
            chassis_position=_add(parent.chassis_position, at) if parent else at,
        )
    return list(pairs.values())


def _parent_of(line: Line, struct: Struct, pairs: Mapping[str, JointPair]) -> JointPair | None:
    wanted = struct.get("Parent", "")
    name = "" if wanted == "" else as_name(line, wanted, "Parent")
    if name.lower() in CHASSIS_NAMES:
        return None
    if name.lower() not in pairs:
        known = ", ".join([CHASSIS, *(pair.name for pair in pairs.values())])
        fail(line, f"Parent {name} is not defined before", f"one of {known}")
    return pairs[name.lower()]


def _add(first: Vec3, second: Vec3, sign: int = 1) -> Vec3:
    x, y, z = (a + sign * b for a, b in zip(first, second, strict=True))
    return (x, y, z)


def spin_axis(pair: JointPair) -> Vec3:
    """Return a wheel's spin axis, which may lean, towards its left: positive turns roll it forward."""
    return _near(pair, "ParentAxis2", LEFT, 0.5)


def leaning(axis: Vec3) -> Vec3:
    """Return roll, pitch and yaw of the smallest rotation from the left to an axis on that side."""
    x, y, z = axis
    cross = np.array([[0.0, -x, 0.0], [x, 0.0, z], [0.0, -z, 0.0]])  # cross-product matrix of LEFT x axis
    # Rotation between unit vectors: 1 + K + K^2 / (1 + c) with c = LEFT . axis = -y.
    roll, pitch, yaw = (angles_from_mat(np.eye(3) + cross + cross @ cross / (1.0 - y)) + 0.0).tolist()
    return (roll, pitch, yaw)


def check_own_axes(pair: JointPair) -> None:
    """Check that the axes of a wheel's own fit its parent's; a round wheel needs no more of them.

    Raises:
        SpecError: Their angle to each other differs, so that they cannot both coincide.
    """
    if pair.struct.get("SelfAxis") is None and pair.struct.get("SelfAxis2") is None:
        return
    usual = {"Axis": UP, "Axis2": LEFT}
    steep, theirs = (
        float(np.degrees(np.arccos(np.clip(first @ second, -1.0, 1.0))))
        for first, second in (
            [
                np.array(usual[axis]) if pair.struct.get(side + axis) is None else unit_of(pair, side + axis)
                for axis in usual
            ]
            for side in ("Self", "Parent")
        )
    )
    # An axis may be given in either direction.
    if min(abs(steep - theirs), abs(180.0 - steep - theirs)) > AXES_TOLERANCE:
        fail(
            pair.line,
            f"SelfAxis and SelfAxis2 of wheel {pair.name} stand at {steep:.1f} degrees",
            f"{theirs:.1f} as ParentAxis and ParentAxis2 do",
        )


def steering_axis(pair: JointPair) -> Vec3:
    """Return a wheel's steering axis, which may lean, upwards: positive turns it to the left."""
    return _near(pair, "ParentAxis", UP, 0.5)


def _near(pair: JointPair, field: str, towards: Vec3, least: float) -> Vec3:
    if pair.struct.get(field) is None:
        return towards
    axis = unit_of(pair, field)
    along = float(axis @ towards)
    if abs(along) < least:
        expected = {LEFT: "(X=0,Y=1,Z=0)", UP: "one near (X=0,Y=0,Z=1)"}[towards]
        fail(pair.line, f"{field} of wheel {pair.name} is {tuple(axis.round(4).tolist())}", expected)
    # Adding 0.0 turns -0.0 into 0.0, which texts and digests would tell apart.
    x, y, z = (axis * np.sign(along) + 0.0).tolist()
    return (x, y, z)


def unit_of(pair: JointPair, field: str) -> np.ndarray:
    """Return a unit vector of a pair in USARSim's axes (3,)."""
    x, y, z = as_vector(pair.line, pair.struct.get(field), field)
    length = float(np.linalg.norm((x, y, z)))
    if length == 0:
        fail(pair.line, f"{field} has no length", "a direction, as (X=0,Y=1,Z=0)")
    # Unreal's z points up, USARSim's down.
    return np.array([x, y, -z]) / length


def part_rotation(pair: JointPair) -> Vec3:
    """Return a part's rotation on its parent, which makes its SelfAxis coincide with the ParentAxis."""
    struct = pair.struct
    if struct.get("SelfAxis") is None:
        return ZERO
    # One pair of axes leaves the turn about them open: a second pair fixes it.
    own, theirs = unit_of(pair, "SelfAxis"), unit_of(pair, "ParentAxis")
    if struct.get("SelfAxis2") is None or struct.get("ParentAxis2") is None:
        if np.allclose(own, theirs, atol=1e-6):
            return ZERO
        fail(
            pair.line, "SelfAxis is not ParentAxis", "ParentAxis2 and SelfAxis2 too, to say how it is turned"
        )
    mat = _frame(pair, theirs, "ParentAxis2") @ _frame(pair, own, "SelfAxis2").T
    # Plus 0.0: -0.0 becomes 0.0.
    roll, pitch, yaw = (angles_from_mat(mat) + 0.0).tolist()
    return (roll, pitch, yaw)


def _frame(pair: JointPair, first: np.ndarray, field: str) -> np.ndarray:
    """Return a right-handed frame (3, 3) whose x axis is `first` and whose y axis is nearest to a field's."""
    second = unit_of(pair, field)
    # Gram and Schmidt: files give the axes with few digits, so they are not quite at right angles.
    second = second - first * (first @ second)
    if np.linalg.norm(second) < 1e-3:
        fail(pair.line, f"{field} lies along the first axis", "one across it")
    second = second / np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], 1)


def build_parts(pairs: Sequence[JointPair], weight: float, robots: Registry[RobotSpec]) -> tuple[Part, ...]:
    """Return the parts of a robot of that weight [kg]; every wheel has a motor."""
    wheels = sum(pair.joint == "wheel" for pair in pairs)
    parts: list[Part] = []
    for pair in pairs:
        if pair.joint == "wheel":
            parts += _wheel_parts(pair, weight, wheels, robots)
        else:
            parts.append(_hinge_part(pair))
    return tuple(parts)


def _wheel_parts(pair: JointPair, weight: float, wheels: int, robots: Registry[RobotSpec]) -> list[Part]:
    """Return suspension, steering and wheel, unless locked."""
    line, struct = pair.line, pair.struct
    check_own_axes(pair)
    model = _model_of(pair, robots)
    known = model.shapes[0] if model else None
    radius = number_of(line, struct, "Radius", known and known.size[0], above=0.0)
    width = number_of(line, struct, "Width", known and 2 * known.size[1], above=0.0)
    # Robots of many wheels: all of them together stay below half of the weight.
    usual = known.mass if known else weight * min(WHEEL_SHARE, 0.5 / wheels)
    mass = number_of(line, struct, "Mass", usual, above=0.0)
    load = weight / wheels
    motor = (model.motor if model else None) or _wheel_motor(load, radius)
    motor = replace(
        motor,
        max_speed=number_of(line, struct, "MaxSpeed", motor.max_speed, above=0.0),
        torque=number_of(line, struct, "Torque", motor.torque, above=0.0),
        brake=pair.brake,
        # A stated torque replaces the model's whole motor curve.
        stall_torque=motor.stall_torque if struct.get("Torque") is None else None,
    )
    upright = steering_axis(pair)
    spring = Spring(
        # k = m w^2 and c = 2 z m w for the mass on one wheel; the load is its weight along the suspension.
        stiffness=load * SUSPENSION_RATE**2,
        damping=2 * SUSPENSION_SHARE * load * SUSPENSION_RATE,
        load=load * GRAVITY * float(np.dot(upright, UP)),
    )
    tyre = wheel(pair.name, at=pair.at, size=(radius, width), mass=mass, motor=motor, parent=pair.parent)
    # A model's looks fit its own size only.
    if model and tyre.shapes[0].size == model.shapes[0].size:
        tyre = replace(tyre, looks=model.looks)
    tyre = replace(tyre, rotation=leaning(spin_axis(pair)))
    tyre = replace(tyre, shapes=_moved(tyre.shapes, pair.middle), looks=_moved(tyre.looks, pair.middle))
    parts = car_wheel(
        tyre,
        hub=mass * HUB_SHARE,
        spring=spring if pair.sprung else None,
        travel=DEFAULT_SUSPENSION_TRAVEL[1],
        steer=_steering_servo(weight, mass * radius**2 / 4) if pair.steers else None,
        lock=np.pi,
    )
    return [part if part.is_wheel else replace(part, axis=upright) for part in parts]


def _steering_servo(weight: float, inertia: float) -> Motor:
    """Return the steering servo of a wheel with that inertia, as stiff as our cars'."""
    return firm_motor(STEER_SPEED, STEER_TORQUE * weight, inertia, STEER_ARMATURE * weight)


def _moved(shapes: Sequence[Shape], by: Vec3) -> tuple[Shape, ...]:
    x, y, z = by
    return tuple(replace(shape, at=(shape.at[0] + x, shape.at[1] + y, shape.at[2] + z)) for shape in shapes)


def _model_of(pair: JointPair, robots: Registry[RobotSpec]) -> Part | None:
    """Return the wheel of a PartClass, the first on its side: P2ATTire is a P2AT's."""
    written = pair.struct.get("PartClass")
    name = as_class(pair.line, written, "PartClass") if written is not None else ""
    owner = name.lower().removesuffix("tire")
    if owner != name.lower() and owner in robots:
        # Radius and width are read off the first solid, which has both only as a cylinder.
        wheels = [part for part in robots.get(owner).wheels if part.shapes[0].kind == "cylinder"]
        if wheels:
            side = pair.chassis_position[1]
            return next((wheel for wheel in wheels if wheel.at[1] * side > 0), wheels[0])
    given = [pair.struct.get(field) is not None for field in ("Radius", "Width")]
    if not all(given):
        tires = [f"{known}Tire" for known, robot in robots if robot.wheels]
        fail(
            pair.line,
            f"the size of wheel {pair.name} (PartClass {name or 'not given'}) is not known",
            f"Radius= and Width=, or a PartClass of {', '.join(tires)}",
        )
    return None


def _wheel_motor(load: float, radius: float) -> Motor:
    return _servo(max(MIN_ARMATURE, load * radius**2), WHEEL_SPEED, load * GRAVITY * radius)


def _servo(armature: float, speed: float, torque: float) -> Motor:
    """Return a motor with gains in proportion to its inertia."""
    return Motor(
        max_speed=speed,
        torque=torque,
        stiffness=STIFFNESS * armature,
        damping=DAMPING * armature,
        armature=armature,
    )


def _hinge_part(pair: JointPair) -> Part:
    """Return a part on a hinge or a slider: a box of the given Size around its own middle."""
    line, struct = pair.line, pair.struct
    if struct.get("Size") is None:
        fail(line, f"{key_text(line)} has no Size", "Size=(X=length,Y=width,Z=height) of the part's box")
    # Without their signs: the conversion of units turns z over.
    x, y, z = (abs(edge) / 2 for edge in pair.units.position(vector_of(line, struct, "Size")))
    mass = number_of(line, struct, "Mass", PART_MASS, above=0.0)
    if min(x, y, z) == 0:
        fail(line, "Size has an edge of no length", "three lengths")
    # The inertia of its box about its joint: the gains are for a servo without further load.
    arm = float(np.linalg.norm(pair.middle)) + max(x, y, z)
    motor = _servo(max(0.1, mass * arm**2), HINGE_SPEED, HINGE_TORQUE)
    motor = replace(
        motor,
        max_speed=number_of(line, struct, "MaxSpeed", motor.max_speed, above=0.0),
        torque=number_of(line, struct, "Torque", motor.torque, above=0.0),
    )
    limits = None
    if struct.get("MinRange") is not None or struct.get("MaxRange") is not None:
        low, high = (number_of(line, struct, name) for name in ("MinRange", "MaxRange"))
        # Limits in the wrong order are none, as those of links.
        limits = None if low > high else (low, high)
    turn = part_rotation(pair)
    axis = unit_of(pair, "SelfAxis" if struct.get("SelfAxis") is not None else "ParentAxis")
    a, b, c = (axis + 0.0).tolist()
    return Part(
        name=pair.name,
        parent=pair.parent,
        at=pair.at,
        rotation=turn,
        axis=(a, b, c),
        joint="hinge" if pair.joint == "hinge" else "slide",
        motor=motor,
        limits=limits,
        shapes=(Shape(kind="box", size=(x, y, z), at=pair.middle, mass=mass, rgba=BLACK),),
    )


PACKAGE_PREFIX = "usarmispkg."
"""Prefix of sections of packages."""
LINK_FIELDS = (
    "Number", "Parent", "Location", "Orientation", "MaxSpeed", "MaxTorque", "MinRange", "MaxRange",
    "JointType", "Mass", "Size",
)  # fmt: skip
"""Fields of a `Links` line."""
SYNONYMS = {"linknumber": "Number", "parentlinknumber": "Parent"}
"""The original's names of two fields (KRobot.uc)."""
MAX_LINKS = 200
"""Largest number of links of a package."""
JOINT_TYPES = ("Revolute", "Prismatic")
# Defaults of a link: captured values of CameraPanTilt; size and mass chosen.
DEFAULT_LINK = Link(
    number=0, parent=-1, location=ZERO, orientation=ZERO, max_speed=0.17, max_torque=20.0, min_range=1.0,
    max_range=0.0, shapes=(Shape(kind="box", size=(0.02, 0.02, 0.02), mass=0.2, surface="fixture"),),
)  # fmt: skip


@dataclass(frozen=True)
class LinkLine:
    """One `Links=` line: its number, the line, its fields, and their units."""

    number: int
    line: Line
    fields: Struct
    units: Units


@dataclass(frozen=True)
class Definition:
    """Definition of a package class by a file: links, none if it leaves them, and its tip [m]."""

    links: tuple[LinkLine, ...] = ()
    tip: Vec3 | None = None


Definitions = Mapping[str, Definition]
"""Definition of each package class, by its name in lower case."""


def read_packages(files: Sequence[IniFile], notes: WarningLog) -> Definitions:
    """Return the packages that `[USARMisPkg.X]` sections define; Links of a later file replace earlier ones.

    Raises:
        SpecError: An invalid link; names file and line.
    """
    found: dict[str, Definition] = {}
    for file in files:
        for name in dict.fromkeys(section.name.lower() for section in file.sections):
            if not name.startswith(PACKAGE_PREFIX):
                continue
            section = file.section(name)
            by_uu = section.last("bMountByUU")
            units = Units(by_uu is not None and as_bool(by_uu, by_uu.value, "bMountByUU"), file.uu_per_metre)
            for line in section.lines:
                if line.key.lower() not in ("links", "bmountbyuu", "tipoffset"):
                    notes.add(line, f"unknown key {line.key}; a package has Links, bMountByUU and TipOffset")
            links = tuple(_link_line(line, units, notes) for line in section.get_all("Links"))
            _check_tree(links)
            offset = section.last("TipOffset")
            own = name.removeprefix(PACKAGE_PREFIX)
            before = found.get(own, Definition())
            if links or offset is not None:
                tip = before.tip if offset is None else as_vector(offset, offset.value, "TipOffset")
                found[own] = Definition(links or before.links, tip)
    return found


def _link_line(line: Line, units: Units, notes: WarningLog) -> LinkLine:
    struct = as_struct(line)
    fields: list[tuple[str, IniValue]] = []
    for key, value in struct.fields:
        if reason := {name.lower(): text for name, text in LINK_IGNORED.items()}.get(key.lower()):
            notes.add(line, f"{key} is ignored: {reason}")
        else:
            fields.append((SYNONYMS.get(key.lower(), key), value))
    named = Struct(tuple(fields))
    reject_unknown(line, named, LINK_FIELDS)
    number = number_of(line, named, "Number")
    if number < 1 or number != int(number):
        fail(line, f"Number is {number:g}", "a whole number from 1")
    return LinkLine(int(number), line, named, units)


def _check_tree(links: Sequence[LinkLine]) -> None:
    """Refuse a link with a repeated number, or with a parent that is not defined before it."""
    # Number of what the package is mounted on.
    known = {-1}
    for link in links:
        if len(known) > MAX_LINKS:
            fail(link.line, f"this is link {len(known)} of a package", f"at most {MAX_LINKS}")
        if link.number in known:
            fail(link.line, f"link {link.number} is there twice", "one line for each link")
        parent = link.fields.get("Parent")
        if parent is not None and int(as_number(link.line, parent, "Parent")) not in known:
            fail(link.line, f"Parent {parent} is no link before this one", f"one of {sorted(known)}")
        known.add(link.number)


def _shapes(link: LinkLine, before: Link) -> tuple[Shape, ...]:
    """Return the previous solids, or one box of the given Size and Mass."""
    if link.fields.get("Size") is None and link.fields.get("Mass") is None:
        return before.shapes
    mass = number_of(link.line, link.fields, "Mass", sum(shape.mass for shape in before.shapes), above=0.0)
    if link.fields.get("Size") is None:
        share = mass / sum(shape.mass for shape in before.shapes)
        return tuple(replace(shape, mass=shape.mass * share) for shape in before.shapes)
    x, y, z = (abs(edge) / 2 for edge in link.units.position(vector_of(link.line, link.fields, "Size")))
    return (Shape(kind="box", size=(x, y, z), mass=mass, surface="fixture", rgba=(0.1, 0.1, 0.1, 1.0)),)


def _link(link: LinkLine, before: Link | None, base: Vec3) -> Link:
    """Return a link with the changes of its line; `base` is the position of the package."""
    line, fields, units = link.line, link.fields, link.units
    parent = int(number_of(line, fields, "Parent", before.parent if before else -1))
    before = before or replace(DEFAULT_LINK, location=base if parent == -1 else ZERO)
    location = before.location
    if fields.get("Location") is not None:
        own = units.position(vector_of(line, fields, "Location"))
        location = _sum(base, own) if parent == -1 else own
    orientation = before.orientation
    if fields.get("Orientation") is not None:
        orientation = units.angles(vector_of(line, fields, "Orientation"))
    joint = as_name(line, fields.get("JointType", before.joint), "JointType").capitalize()
    if joint not in JOINT_TYPES:
        fail(line, f"JointType is {joint}", " or ".join(JOINT_TYPES))
    speed = number_of(line, fields, "MaxSpeed", before.max_speed, above=0.0)
    torque = number_of(line, fields, "MaxTorque", before.max_torque, above=0.0)
    motor = before.motor
    if motor is not None:
        if fields.get("MaxSpeed") is not None:
            motor = replace(motor, max_speed=speed)
        # MaxTorque is in the original's units: the motor's own follows in proportion.
        motor = replace(motor, torque=motor.torque * torque / before.max_torque)
    return Link(
        number=link.number,
        parent=parent,
        location=location,
        orientation=orientation,
        max_speed=speed,
        max_torque=torque,
        min_range=number_of(line, fields, "MinRange", before.min_range),
        max_range=number_of(line, fields, "MaxRange", before.max_range),
        shapes=_shapes(link, before),
        joint="Revolute" if joint == "Revolute" else "Prismatic",
        motor=motor,
        # The old looks do not fit a box of another size.
        looks=before.looks if fields.get("Size") is None else (),
    )


def redefine(package: MissionPackage, definitions: Definitions) -> MissionPackage:
    """Return a package with the links of an ini file; fields without a value stay."""
    found = definitions.get(package.name.lower(), Definition())
    tip = package.tip if found.tip is None else found.tip
    if not found.links:
        return replace(package, tip=tip)
    base = base_of(package)
    before = {link.number: link for link in package.links}
    links = tuple(_link(line, before.get(line.number), base) for line in found.links)
    return replace(package, links=links, tip=tip)


def base_of(package: MissionPackage) -> Vec3:
    """Return the position of a package on the chassis, that of its first link."""
    return next((link.location for link in package.links if link.parent == -1), ZERO)


def _sum(first: Vec3, second: Vec3, sign: int = 1) -> Vec3:
    x, y, z = (a + sign * b for a, b in zip(first, second, strict=True))
    return (x, y, z)


def templates(packages: Iterable[MissionPackage], definitions: Definitions) -> dict[str, MissionPackage]:
    """Return packages by class name in lower case, with the ini files' changes, mounted at the origin."""
    found: dict[str, MissionPackage] = {}
    for package in packages:
        # A MisPkgs line gives the whole position: the class's own would be added to it.
        bare = mount_package(package, _sum(ZERO, base_of(package), -1))
        found[package.name.lower()] = redefine(bare, definitions)
    return found


def known_packages(robots: Registry[RobotSpec], definitions: Definitions) -> dict[str, MissionPackage]:
    """Return all packages: the robots', those of `PACKAGES`, and new ones of the ini files."""
    new = [MissionPackage(name=name, links=()) for name, found in definitions.items() if found.links]
    others = [package for _, robot in robots for package in robot.packages]
    # Later ones win: `PACKAGES` over the robots' own, and both over names that only a file defines.
    return templates([*new, *others, *(package for _, package in PACKAGES)], definitions)


def read_package(line: Line, known: Mapping[str, MissionPackage]) -> MissionPackage:
    """Return the package that a MisPkgs line mounts (manual 10.15.2).

    Location is in metres and z down regardless of bMountByUU (KRobot.uc).

    Raises:
        SpecError: No such package class; names file and line, and the known classes.
    """
    struct = as_struct(line)
    reject_unknown(line, struct, ("PkgName", "Location", "PkgClass"))
    name = as_name(line, struct.get("PkgName"), "PkgName")
    kind = as_class(line, struct.get("PkgClass", name), "PkgClass")
    if kind.lower() not in known:
        names = sorted({package.name for package in known.values()})
        fail(line, f"unknown PkgClass {kind!r}", f"one of {', '.join(names)}")
    return mount_package(known[kind.lower()], vector_of(line, struct, "Location"), name)
