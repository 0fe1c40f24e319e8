"""The gripper (manual 11.1): two fingers that hold things by contact and friction."""

import math
from dataclasses import dataclass, replace
from typing import Self

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.effecters.base import EFFECTERS, NOP, RESET, Effect, Effecter, EffecterSettings, Opcode
from usarmjx.models.types.robot import CHASSIS, Motor, Part, RobotSpec
from usarmjx.models.types.shapes import Shape

# All measures are chosen: the manual gives none.
LEVER = 0.12
"""Length of the linkage that carries a finger [m]; half the angle turns it outward."""
FINGER = (0.05, 0.006, 0.015)
"""Half lengths of a finger [m]."""
PALM = (0.01, 0.05, 0.02)
"""Half lengths of the plate that carries the fingers [m]."""
# 60 N hold 2 kg through a skid-steered turn. Gains are stable for a 0.6 kg slide at a time step of 5 ms.
MOTOR = Motor(max_speed=0.1, torque=60.0, stiffness=2000.0, damping=60.0, armature=0.5)
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
        at = (FINGER[0], side * FINGER[1], 0.0)
        shape = Shape(kind="box", size=FINGER, at=at, mass=0.1, surface="finger", rgba=GREY)
        return self.part_in_parent(
            Part(
                name=name,
                at=(2 * PALM[0], 0.0, 0.0),
                axis=(0.0, side, 0.0),
                joint="slide",
                motor=MOTOR,
                limits=(low, high),
                geared=twin,
                shapes=(shape,),
            )
        )

    def shapes(self) -> tuple[Shape, ...]:
        """Return the palm."""
        return (self.shape_in_parent(Shape(kind="box", size=PALM, at=(PALM[0], 0.0, 0.0), rgba=GREY)),)


EFFECTERS.add(Gripper.kind, Gripper)
