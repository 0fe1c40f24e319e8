"""The gripper (manual 11.1): two fingers that hold things by contact and friction."""

import math
from dataclasses import dataclass
from types import ModuleType

from usarmjx.models.effecters.base import EFFECTERS, NOP, RESET, Effect, Effecter, EffecterSettings, Opcode
from usarmjx.models.spec import UP, Motor, Part, Shape
from usarmjx.transforms import Array, Vec3

# All measures are chosen: the manual gives none.
FINGER_LENGTH = 0.12
"""From hinge to tip [m]."""
HINGE = 0.03
"""How far each hinge is from the middle [m]: half of the object that lies flat between the pads."""
PAD = (0.006, 0.015)
"""Half thickness and half height of a finger's pad [m]."""
PALM = (0.01, 0.05, 0.02)
"""Half lengths of the plate that the fingers hinge on [m]."""
TOE_IN = math.asin(HINGE / FINGER_LENGTH)
"""By how much a pad is turned inward on its finger, so that closed fingers meet at their tips [rad]. A thing
thinner than 6 cm is then pushed toward the palm, not out."""
# A closed finger presses with some 30 N at its middle: enough to lift a 2 kg brick by friction.
MOTOR = Motor(max_speed=1.0, torque=2.0, stiffness=40.0, damping=2.0, armature=0.02)
DOWN: Vec3 = (0.0, 0.0, 1.0)
GREY = (0.3, 0.3, 0.3, 1.0)


@dataclass(frozen=True)
class GripperSettings(EffecterSettings):
    """Manual 11.1.2.

    Attributes:
        max_angle: Largest angle between the fingers [rad].
        min_angle: Smallest angle between the fingers [rad].
        left_finger: Name of the left finger's part; the gripper brings it along if the robot has none such.
        right_finger: The same of the right finger.
    """

    max_angle: float = 1.57
    min_angle: float = 0.0
    left_finger: str = "LeftFinger"
    right_finger: str = "RightFinger"


@dataclass(frozen=True)
class Gripper(Effecter):
    """Opens and closes two fingers about its x axis; each has half of the angle between them.

    Fingers that are parts of the robot open by positive angles, as the gripper's own do.
    """

    kind = "Gripper"
    defaults = GripperSettings

    @property
    def opcodes(self) -> tuple[Opcode, ...]:
        """Open to an angle; Animate is the vocabulary's word for it; Reset closes, NOP stops."""
        high, low = self.settings.max_angle, self.settings.min_angle
        return (Opcode("Open", high, low, None), Opcode("Animate", high, low, None), RESET, NOP)

    @property
    def joints(self) -> tuple[str, ...]:
        """Left and right finger."""
        return (self.settings.left_finger, self.settings.right_finger)

    def effect(self, opcode: Opcode, value: Array, stock: Array, xp: ModuleType) -> Effect:
        """Closing on a thing, the servos press with their full torque."""
        del stock
        if opcode == NOP:
            return Effect(target=xp.zeros_like(value), order=1)
        angle = xp.full_like(value, self.settings.min_angle) if opcode == RESET else value
        return Effect(target=angle / 2, order=0)

    def parts(self) -> tuple[Part, ...]:
        """Two fingers, parallel when closed."""
        return (
            self.part(self._finger(self.settings.left_finger, -1.0)),
            self.part(self._finger(self.settings.right_finger, 1.0)),
        )

    def shapes(self) -> tuple[Shape, ...]:
        """The palm."""
        return (self.shape(Shape(kind="box", size=PALM, at=(PALM[0], 0.0, 0.0), rgba=GREY)),)

    def _finger(self, name: str, side: float) -> Part:
        """Return the finger on one side (-1 left, 1 right), in the gripper's axes."""
        half, thickness = FINGER_LENGTH / 2, PAD[0]
        along, across = (math.cos(TOE_IN), -side * math.sin(TOE_IN)), (math.sin(TOE_IN), math.cos(TOE_IN))
        pad = Shape(
            kind="box",
            size=(half, *PAD),
            # The pad's inner face goes from the hinge to the tip; its body lies outside of that.
            at=(half * along[0] + thickness * across[0], half * along[1] + side * thickness * across[1], 0.0),
            rotation=(0.0, 0.0, -side * TOE_IN),
            mass=0.1,
            surface="finger",
            rgba=GREY,
        )
        limits = (self.settings.min_angle / 2, self.settings.max_angle / 2)
        axis = UP if side < 0 else DOWN
        return Part(
            name=name,
            at=(2 * PALM[0], side * HINGE, 0.0),
            axis=axis,
            motor=MOTOR,
            limits=limits,
            geared=None if True else self.settings.left_finger if side > 0 else None,
            shapes=(pad,),
        )


EFFECTERS.add(Gripper.kind, Gripper)
