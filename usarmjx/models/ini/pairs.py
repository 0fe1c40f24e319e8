"""Part-joint pairs of an ini file (manual 14.4.2.4), read and checked; `joints` makes parts of them.

Axes are written in Unreal's axes (z up) whatever bMountByUU says (KRobot.uc does not convert them),
positions as everything else.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from usarmjx.base.transforms import Vec3, angles_from_mat
from usarmjx.models.ini.items import WarningLog
from usarmjx.models.ini.keys import JOINT_IGNORED
from usarmjx.models.ini.parse import Line, Struct
from usarmjx.models.ini.read import (
    Units,
    as_bool,
    as_class,
    as_name,
    as_number,
    as_struct,
    as_vector,
    fail,
    reject_unknown,
    vector_of,
)
from usarmjx.models.spec.robot import CHASSIS, LEFT, UP
from usarmjx.models.spec.shapes import ZERO

FIELDS = (
    "PartName", "PartClass", "JointClass", "bSteeringLocked", "bSuspensionLocked", "Parent", "ParentPos",
    "ParentAxis", "ParentAxis2", "SelfPos", "SelfAxis", "SelfAxis2", "BrakeTorque", *JOINT_IGNORED,
)  # fmt: skip
OURS = ("Radius", "Width", "Size", "Mass", "MaxSpeed", "Torque", "MinRange", "MaxRange")
"""Fields that we add: the original has them in the classes of wheels and parts."""
JOINT_CLASSES = {
    "kcarwheeljoint": "wheel",
    "kscarwheeljoint": "wheel",
    "kdhinge": "hinge",
    "kslider": "slide",
}
AXES_TOLERANCE = 0.5
"""A wheel's own axes may stand so far from the angle of its parent's [degrees]."""
MOST_PARTS = 500
"""Of a robot."""
CHASSIS_NAMES = ("", "none", CHASSIS.lower())


@dataclass(frozen=True)
class JointPair:
    """A part-joint pair, read.

    Attributes:
        line: Where it stands.
        struct: Its fields.
        units: What its positions are in.
        number: Its number among the pairs, by which `Wheels` knows it.
        name: PartName.
        joint: Kind: wheel, hinge or slide.
        parent: The part it hangs on, or `HARD`.
        at: Where the joint is in the axes of the parent's joint [m].
        middle: Where the part's own middle is in the axes of its joint [m].
        chassis_position: Where the joint is on the chassis, parts unturned [m].
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
        """Whether the wheel's steering is free; as in Unreal, False is what is left out."""
        return not self._locked("bSteeringLocked")

    @property
    def sprung(self) -> bool:
        """Whether the wheel's suspension is free."""
        return not self._locked("bSuspensionLocked")

    @property
    def brake(self) -> float | None:
        """BrakeTorque: with what a wheel that is told to stand still is braked [N m]; None: not said."""
        value = self.struct.get("BrakeTorque")
        return None if value is None else as_number(self.line, value, "BrakeTorque", above=-1e-9)

    def _locked(self, name: str) -> bool:
        value = self.struct.get(name)
        return value is not None and as_bool(self.line, value, name)


def read_pairs(lines: Mapping[int, tuple[Line, Units]], notes: WarningLog) -> list[JointPair]:
    """Return the pairs in the order of their numbers.

    Raises:
        SpecError: A field that is missing, unknown or wrong, a name that is there twice, or a parent that is
            not defined before; names file and line.
    """
    pairs: dict[str, JointPair] = {}
    for number, (line, units) in sorted(lines.items()):
        if len(pairs) == MOST_PARTS:
            fail(line, f"this is part {len(pairs) + 1}", f"a robot of at most {MOST_PARTS}")
        struct = as_struct(line)
        reject_unknown(line, struct, (*FIELDS, *OURS))
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
        middle = _add(ZERO, self_pos, -1)
        at = units.position(vector_of(line, struct, "ParentPos"))
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
    """Return a wheel's spin axis, which may lean, on its left: positive turns roll it forward."""
    return _near(pair, "ParentAxis2", LEFT, 0.5)


def leaning(axis: Vec3) -> Vec3:
    """Return roll, pitch and yaw of the least turn that takes the left to an axis on that side."""
    x, y, z = axis
    cross = np.array([[0.0, -x, 0.0], [x, 0.0, z], [0.0, -z, 0.0]])  # of LEFT x axis
    roll, pitch, yaw = (angles_from_mat(np.eye(3) + cross + cross @ cross / (1.0 - y)) + 0.0).tolist()
    return (roll, pitch, yaw)


def check_own_axes(pair: JointPair) -> None:
    """Check that the axes of a wheel's own fit its parent's; being round, it needs no more of them.

    Raises:
        SpecError: They stand at another angle to each other, so that they cannot meet both.
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
    if min(abs(steep - theirs), abs(180.0 - steep - theirs)) > AXES_TOLERANCE:
        fail(
            pair.line,
            f"SelfAxis and SelfAxis2 of wheel {pair.name} stand at {steep:.1f} degrees",
            f"{theirs:.1f} as ParentAxis and ParentAxis2 do",
        )


def steering_axis(pair: JointPair) -> Vec3:
    """Return a wheel's steering axis, which may lean, on its upper side: positive turns it to the left."""
    return _near(pair, "ParentAxis", UP, 0.5)


def _near(pair: JointPair, field: str, towards: Vec3, least: float) -> Vec3:
    if pair.struct.get(field) is None:
        return towards
    axis = unit_of(pair, field)
    along = float(axis @ towards)
    if abs(along) < least:
        expected = {LEFT: "(X=0,Y=1,Z=0)", UP: "one near (X=0,Y=0,Z=1)"}[towards]
        fail(pair.line, f"{field} of wheel {pair.name} is {tuple(axis.round(4).tolist())}", expected)
    x, y, z = (axis * np.sign(along) + 0.0).tolist()
    return (x, y, z)


def unit_of(pair: JointPair, field: str) -> np.ndarray:
    """Return a unit vector of a pair in USARSim's axes (3,)."""
    x, y, z = as_vector(pair.line, pair.struct.get(field), field)
    length = float(np.linalg.norm((x, y, z)))
    if length == 0:
        fail(pair.line, f"{field} has no length", "a direction, as (X=0,Y=1,Z=0)")
    return np.array([x, y, -z]) / length


def part_rotation(pair: JointPair) -> Vec3:
    """Return how a part is turned on its parent: so that its SelfAxis meets the parent's ParentAxis."""
    struct = pair.struct
    if struct.get("SelfAxis") is None:
        return ZERO
    own, theirs = unit_of(pair, "SelfAxis"), unit_of(pair, "ParentAxis")
    if struct.get("SelfAxis2") is None or struct.get("ParentAxis2") is None:
        if np.allclose(own, theirs, atol=1e-6):
            return ZERO
        fail(
            pair.line, "SelfAxis is not ParentAxis", "ParentAxis2 and SelfAxis2 too, to say how it is turned"
        )
    mat = _frame(pair, theirs, "ParentAxis2") @ _frame(pair, own, "SelfAxis2").T
    roll, pitch, yaw = (angles_from_mat(mat) + 0.0).tolist()
    return (roll, pitch, yaw)


def _frame(pair: JointPair, first: np.ndarray, field: str) -> np.ndarray:
    """Return a right-handed frame (3, 3) whose x axis is `first` and whose y axis is nearest to a field's."""
    second = unit_of(pair, field)
    second = second - first * (first @ second)
    if np.linalg.norm(second) < 1e-3:
        fail(pair.line, f"{field} lies along the first axis", "one across it")
    second = second / np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], 1)
