"""The manual's effecters (8, 11): gripper, RFID releaser, headlight, roller table; the later vacuum.

The gripper's two fingers hold things by contact and friction; the roller table's driven rollers convey
objects along its x axis. Releaser and headlight have no joints.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Self

from usarmjx.base.backend import Array, xp
from usarmjx.base.settings import NOT_NEGATIVE
from usarmjx.models.effecters.base import EFFECTERS, NOP, RESET, Effect, Effecter, EffecterSettings, Opcode
from usarmjx.models.types.robot import CHASSIS, Motor, Part, RobotSpec
from usarmjx.models.types.shapes import ACROSS, Shape

TAGS_REMAINING = Opcode("TagsRemaining")

RELEASE = Opcode("Release")

ACTIVATE = Opcode("Activate", 1.0, 0.0, 1.0)


@dataclass(frozen=True)
class ReleaserSettings(EffecterSettings):
    """Manual 11.2.2.

    Attributes:
        num_tags: Number of tags at the start.
    """

    num_tags: Annotated[int, NOT_NEGATIVE] = 10


@dataclass(frozen=True)
class RfidReleaser(Effecter):
    """Drops RFID tags, one by one, on the ground below it."""

    kind = "RFIDReleaser"
    settings_class = ReleaserSettings

    @property
    def opcodes(self) -> tuple[Opcode, ...]:
        """Reset reloads (manual 8); the others are those of manual 11.2.1."""
        return (RELEASE, TAGS_REMAINING, RESET, NOP)

    @property
    def initial_stock(self) -> int:
        """Number of tags at the start."""
        return self.settings.num_tags

    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return the effect; a release without tags left is impossible."""
        del value
        if opcode == RELEASE:
            # `possible` masks the rest: a stock of -1 is never stored. A branch would not trace.
            return Effect(stock=stock - 1, drops=True, possible=stock > 0)
        if opcode == TAGS_REMAINING:
            return Effect(reply_number=stock)
        return Effect(stock=xp.full_like(stock, self.initial_stock) if opcode == RESET else None)


@dataclass(frozen=True)
class Headlight(Effecter):
    """Switches the robot's headlight, as DRIVE {Light} does (manual 11.5 makes it an effecter)."""

    kind = "Headlight"

    @property
    def opcodes(self) -> tuple[Opcode, ...]:
        """Activate with 1 or without a value is on, with 0 off; Reset and NOP are off."""
        return (ACTIVATE, RESET, NOP)

    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return on for values above 0.5."""
        del stock
        return Effect(light=value > 0.5 if opcode == ACTIVATE else xp.zeros_like(value, bool))


for _effecter in (RfidReleaser, Headlight):
    EFFECTERS.add(_effecter.kind, _effecter)


# All measures are chosen: the manual gives none.
LEVER = 0.12
"""Length of the linkage that carries a finger [m]; half the angle turns it outward."""
FINGER = (0.05, 0.006, 0.015)
"""Half lengths of a finger [m]."""
PALM = (0.01, 0.05, 0.02)
"""Half lengths of the plate that carries the fingers [m]."""
# 60 N hold 2 kg through a skid-steered turn. Gains are stable for a 0.6 kg slide at a time step of 5 ms.
FINGER_MOTOR = Motor(max_speed=0.1, torque=60.0, stiffness=2000.0, damping=60.0, armature=0.5)
GREY = (0.3, 0.3, 0.3, 1.0)
OWN_FINGERS = ("LeftFinger", "RightFinger")
"""Part names of a gripper's own fingers."""


@dataclass(frozen=True)
class GripperSettings(EffecterSettings):
    """Manual 11.1.2.

    Attributes:
        max_angle: Largest angle between the fingers [rad].
        min_angle: Smallest angle between the fingers [rad].
        left_finger: Name of the left finger's part; the gripper adds one if the robot has no such part.
            Empty: see `Gripper.fitted`.
        right_finger: The same of the right finger.
    """

    max_angle: float = 1.57
    min_angle: float = 0.0
    left_finger: str = ""
    right_finger: str = ""


@dataclass(frozen=True)
class Gripper(Effecter):
    """Opens and closes two fingers, which point along its x axis.

    Its own fingers stay parallel, as on a linkage, so that flat things are held by their faces: fingers that
    turned would squeeze things of all but one size out. The command is the angle of the linkage. Fingers that
    are parts of the robot turn by half the angle each, and open by positive angles.
    """

    kind = "Gripper"
    settings_class = GripperSettings

    def fitted(self, robot: RobotSpec) -> Self:
        """Return it with its fingers: of the parts on its base, the last on either side (manual 11.1.2).

        Wheels and parts on a chassis are no fingers. If two such parts are missing, the gripper adds fingers
        of its own, LeftFinger and RightFinger.
        """
        mount, own = self.mount, self.settings
        if own.left_finger and own.right_finger:
            return self
        on_base = [part for part in robot.parts if part.parent == mount.parent and not part.is_wheel]
        # y points to the right here: the left side is negative.
        left, right = (
            [part.name for part in on_base if side * (part.at[1] - mount.at[1]) > 0] for side in (-1, 1)
        )
        found = (left[-1], right[-1]) if left and right and mount.parent != CHASSIS else OWN_FINGERS
        # Names that are set take precedence over parts that were found.
        names = [
            name or usual for name, usual in zip((own.left_finger, own.right_finger), found, strict=True)
        ]
        return replace(self, settings=replace(own, left_finger=names[0], right_finger=names[1]))

    @property
    def opcodes(self) -> tuple[Opcode, ...]:
        """Open to an angle; Animate is the vocabulary's synonym; Reset closes, NOP stops."""
        high, low = self.settings.max_angle, self.settings.min_angle
        return (Opcode("Open", high, low, None), Opcode("Animate", high, low, None), RESET, NOP)

    @property
    def joints(self) -> tuple[str, ...]:
        """Left and right finger."""
        return (self.settings.left_finger, self.settings.right_finger)

    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return the target angle; on contact the servos press with their full force."""
        del stock
        if opcode == NOP:
            # A velocity of 0 stops the fingers; a position would have to be measured first.
            return Effect(target=xp.zeros_like(value), mode=1)
        return Effect(target=xp.full_like(value, self.settings.min_angle) if opcode == RESET else value)

    def joint_target(self, part: Part, target: Array) -> Array:
        """Return half of the angle, or the travel of a parallel finger for it."""
        return LEVER * xp.sin(target / 2) if part.joint == "slide" else target / 2

    def parts(self) -> tuple[Part, ...]:
        """Return two fingers, geared to each other, that meet at angle 0."""
        left, right = self.settings.left_finger, self.settings.right_finger
        return (self._finger(left, -1.0, None), self._finger(right, 1.0, left))

    def _finger(self, name: str, side: float, twin: str | None) -> Part:
        low, high = (LEVER * math.sin(a / 2) for a in (self.settings.min_angle, self.settings.max_angle))
        # Half a finger beside its joint, so that the inner faces meet at joint position 0.
        at = (FINGER[0], side * FINGER[1], 0.0)
        shape = Shape(kind="box", size=FINGER, at=at, mass=0.1, surface="finger", rgba=GREY)
        return self.part_in_parent(
            Part(
                name=name,
                at=(2 * PALM[0], 0.0, 0.0),
                axis=(0.0, side, 0.0),
                joint="slide",
                motor=FINGER_MOTOR,
                limits=(low, high),
                geared=twin,
                shapes=(shape,),
            )
        )

    def shapes(self) -> tuple[Shape, ...]:
        """Return the palm."""
        return (self.shape_in_parent(Shape(kind="box", size=PALM, at=(PALM[0], 0.0, 0.0), rgba=GREY)),)


EFFECTERS.add(Gripper.kind, Gripper)


# All measures are chosen: the manual gives none.
RADIUS, WIDTH = 0.03, 0.36
"""Radius and width of a roller [m]."""
ROLLERS, ROLLER_SPACING = 6, 0.08
"""Number of rollers, and their spacing [m]."""
PLATE = (0.23, 0.2, 0.01)
"""Half lengths of the base plate [m]; its top closes the gaps between rollers."""
ROLLER_MOTOR = Motor(max_speed=6.0, torque=2.0, stiffness=20.0, damping=1.0, armature=0.01)


@dataclass(frozen=True)
class RollerTableSettings(EffecterSettings):
    """Manual 11.3.2.

    Attributes:
        max_speed: Highest speed of the rollers in either direction [rad/s].
    """

    max_speed: Annotated[float, NOT_NEGATIVE] = 6.0


@dataclass(frozen=True)
class RollerTable(Effecter):
    """Turns all rollers at one speed; its mount is the middle of the plane of conveyance."""

    kind = "RollerTable"
    settings_class = RollerTableSettings

    @property
    def opcodes(self) -> tuple[Opcode, ...]:
        """Animate with a speed; Reset and NOP stop."""
        top = self.settings.max_speed
        return (Opcode("Animate", top, -top, None), RESET, NOP)

    @property
    def joints(self) -> tuple[str, ...]:
        """All rollers, rear to front."""
        return tuple(f"{self.mount.name}_{i}" for i in range(1, ROLLERS + 1))

    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return the speed; a positive one conveys along +x."""
        del stock
        return Effect(target=value if opcode.takes_value else xp.zeros_like(value), mode=1)

    def parts(self) -> tuple[Part, ...]:
        """Return the rollers."""
        motor = replace(ROLLER_MOTOR, max_speed=self.settings.max_speed)
        offsets = [(i - (ROLLERS - 1) / 2) * ROLLER_SPACING for i in range(ROLLERS)]
        # MuJoCo makes one contact point between a cylinder and a box, on which the box would rock: with two
        # halves it lies still.
        half = Shape(kind="cylinder", size=(RADIUS, WIDTH / 4), rotation=ACROSS, mass=0.15, surface="wheel")
        halves = tuple(replace(half, at=(0.0, side * WIDTH / 4, 0.0)) for side in (-1.0, 1.0))
        return tuple(
            self.part_in_parent(
                Part(name=name, at=(x, 0.0, RADIUS), motor=motor, is_wheel=True, shapes=halves)
            )
            for name, x in zip(self.joints, offsets, strict=True)
        )

    def shapes(self) -> tuple[Shape, ...]:
        """Return the base plate, its top half a radius below the plane of conveyance."""
        plate = Shape(
            kind="box", size=PLATE, at=(0.0, 0.0, RADIUS / 2 + PLATE[2]), rgba=(0.5, 0.5, 0.55, 1.0)
        )
        return (self.shape_in_parent(plate),)


EFFECTERS.add(RollerTable.kind, RollerTable)


GRIP, CLOSE, OPEN = Opcode("Grip", 1.0, 0.0, None), Opcode("Close"), Opcode("Open")
"""Operations of a vacuum (Gripper.uc of the later versions)."""


@dataclass(frozen=True)
class VacuumSettings(EffecterSettings):
    """Vacuum.uc of the later versions.

    Attributes:
        suction_length: Reach ahead for things to pick up, and their largest motion while they are held [m].
    """

    suction_length: Annotated[float, NOT_NEGATIVE] = 0.125


@dataclass(frozen=True)
class Vacuum(Effecter):
    """Holds the loose object that is ahead of it on its x axis, in single worlds of engine `c`.

    Pure functions cannot hold anything: in all other worlds its operations fail. On the wire it is a Gripper,
    as in the later versions.
    """

    kind = "Vacuum"
    settings_class = VacuumSettings

    @property
    def opcodes(self) -> tuple[Opcode, ...]:
        """Grip with 1 or Close to suck, Grip with 0 or Open to let go."""
        return (GRIP, CLOSE, OPEN)

    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return that it is impossible; see `sim.suction` for worlds in which it is not."""
        del opcode, value, stock
        return Effect(possible=False)

    def is_type(self, kind: str) -> bool:
        """Return whether it is of a type, case ignored; a vacuum is a Gripper too."""
        return super().is_type(kind) or kind.lower() == Gripper.kind.lower()

    @staticmethod
    def closes(opcode: Opcode, value: float) -> bool:
        """Return whether an operation lets it suck."""
        return opcode == CLOSE or (opcode == GRIP and value != 0.0)


EFFECTERS.add(Vacuum.kind, Vacuum)
