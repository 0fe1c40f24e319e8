"""The roller table (manual 11.3): a row of driven rollers that convey objects along its x axis."""

from dataclasses import dataclass, replace
from typing import Annotated

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.settings import NOT_NEGATIVE
from usarmjx.models.effecters.base import EFFECTERS, NOP, RESET, Effect, Effecter, EffecterSettings, Opcode
from usarmjx.models.types.robot import Motor, Part
from usarmjx.models.types.shapes import ACROSS, Shape

# All measures are chosen: the manual gives none.
RADIUS, WIDTH = 0.03, 0.36
"""Radius and width of a roller [m]."""
ROLLERS, ROLLER_SPACING = 6, 0.08
"""Number of rollers, and their spacing [m]."""
PLATE = (0.23, 0.2, 0.01)
"""Half lengths of the base plate [m]; its top closes the gaps between rollers."""
MOTOR = Motor(max_speed=6.0, torque=2.0, stiffness=20.0, damping=1.0, armature=0.01)


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
        motor = replace(MOTOR, max_speed=self.settings.max_speed)
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
