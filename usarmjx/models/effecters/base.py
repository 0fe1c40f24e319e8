"""The interface of effecters: the parts they add to a robot, their operations and effects (manual 8, 14.3).

An effecter acts in three ways only: it commands its joints, switches the headlight, or takes an item from its
stock and drops it. `effect` returns these as plain arrays; `usarmjx.sim.operate` applies them.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from usarmjx.base.backend import Array, xp
from usarmjx.base.nodes import Node
from usarmjx.base.registry import Registry
from usarmjx.base.settings import NOT_NEGATIVE, Parameters, Setting
from usarmjx.base.transforms import Vec3, mat_from_angles
from usarmjx.models.types.robot import Mount, Part, RobotSpec
from usarmjx.models.types.shapes import Shape

LIMIT_TOLERANCE = 1e-3
"""A parameter may be this far outside of its limits: CONF has them with 4 decimals, cut off."""
MAX_DROPPED_TAGS = 64
"""Capacity of a world for dropped RFID tags (the manual's releasers have IDs for 1001)."""


class DroppedTags(Node, kw_only=True):
    """RFID tags that releasers have dropped in one world since it began.

    The tag at index i has the ID i, so that IDs are unique and within those of releasers, 0 to 1000 (manual
    11.2.1).

    Attributes:
        pos: Positions [m] (MAX_DROPPED_TAGS, 3); only the first `count` are valid.
        count: Number of tags ().
    """

    pos: Array
    count: Array


def no_dropped_tags() -> DroppedTags:
    """Return the tags of a new world: none."""
    # Of full size from the start: arrays of a compiled step cannot grow with the count.
    return DroppedTags(pos=xp.zeros((MAX_DROPPED_TAGS, 3)), count=xp.zeros((), xp.int32))


@dataclass(frozen=True)
class Opcode:
    """An operation of an effecter.

    Attributes:
        name: Its name on the wire: the manual's vocabulary (8), or the type's own (11).
        max_val: Largest parameter; an operation whose limits are equal takes none.
        min_val: Smallest parameter.
        default_val: The parameter if a client gives none; None: the parameter is required.
    """

    name: str
    max_val: float = 0.0
    min_val: float = 0.0
    default_val: float | None = 0.0

    @property
    def takes_value(self) -> bool:
        """Whether its parameter has an effect."""
        return self.max_val > self.min_val

    @property
    def parameters(self) -> Parameters:
        """Form of its parameters; clients also send a number to an operation that takes none (manual 9.4)."""
        if not self.takes_value:
            return Parameters()
        limits = Setting(ge=self.min_val - LIMIT_TOLERANCE, le=self.max_val + LIMIT_TOLERANCE)
        return Parameters(1 if self.default_val is None else 0, 1, limits)


NOP = Opcode("NOP")
RESET = Opcode("Reset")


@dataclass(frozen=True, kw_only=True)
class Effect:
    """The result of a valid operation; arrays (...,).

    Attributes:
        target: Target of all of the effecter's joints, by way of `joint_target`; None leaves them unchanged.
        mode: Control mode of `target`: 0 for a position, 1 for a velocity.
        light: Whether the headlight is on; None leaves it unchanged.
        stock: Remaining stock; None: unchanged.
        drops: Whether an item is dropped on the ground below.
        possible: Whether it can be done now.
        reply_number: Number to answer in place of OK; None: OK.
    """

    target: Array | None = None
    mode: int = 0
    light: Array | None = None
    stock: Array | None = None
    drops: bool = False
    possible: Array | bool = True
    reply_number: Array | None = None


@dataclass(frozen=True)
class EffecterSettings:
    """Settings common to all effecters.

    Attributes:
        weight: Weight, part of the payload [kg] (manual 11.2.2).
    """

    weight: Annotated[float, NOT_NEGATIVE] = 0.4


@dataclass(frozen=True)
class Effecter(ABC):
    """One effecter of a robot class.

    Attributes:
        kind: Type as on the wire.
        settings_class: The class of its settings, a dataclass with the manual's ini keys.
        mount: Position and orientation on the robot.
        settings: Its settings with the mount's overrides.
    """

    kind: ClassVar[str]
    settings_class: ClassVar[type[Any]] = EffecterSettings

    mount: Mount
    settings: Any

    def fitted(self, robot: RobotSpec) -> Self:
        """Return the effecter adapted to a robot, for settings that depend on its parts."""
        del robot
        return self

    @property
    @abstractmethod
    def opcodes(self) -> tuple[Opcode, ...]:
        """Operations of this type."""

    @abstractmethod
    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return the effect of an operation.

        Args:
            opcode: One of `opcodes`.
            value: Parameter, within the operation's limits (...,).
            stock: Remaining stock (...,).
        """

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that it moves, all alike."""
        return ()

    def joint_target(self, part: Part, target: Array) -> Array:
        """Return the target of one of its joints [rad or m, or per second] for the common target (...,)."""
        del part
        return target

    @property
    def initial_stock(self) -> int:
        """Number of items to release at the start."""
        return 0

    def parts(self) -> tuple[Part, ...]:
        """Return its parts; those that the robot already has are not added."""
        return ()

    def shapes(self) -> tuple[Shape, ...]:
        """Return solids to add to its parent part, in that part's axes."""
        return ()

    def is_type(self, kind: str) -> bool:
        """Return whether it is of a type, case ignored; all are of the type Effecter (manual 9.4)."""
        return kind.lower() in (self.kind.lower(), "effecter")

    def opcode(self, name: str) -> Opcode | None:
        """Return the operation of that name, case ignored; None if unknown."""
        return next((opcode for opcode in self.opcodes if opcode.name.lower() == name.lower()), None)

    def to_parent(self, at: Vec3) -> Vec3:
        """Return a point of the effecter's axes in those of its parent [m]."""
        x, y, z = (np.array(self.mount.at) + mat_from_angles(*self.mount.direction) @ np.array(at)).tolist()
        return (x, y, z)

    def part_in_parent(self, part: Part) -> Part:
        """Convert a part from the effecter's axes to its parent's."""
        return replace(
            part, parent=self.mount.parent, at=self.to_parent(part.at), rotation=self.mount.direction
        )

    def shape_in_parent(self, shape: Shape) -> Shape:
        """Convert a solid, upright in the effecter's axes, to its parent's."""
        return replace(shape, at=self.to_parent(shape.at), rotation=self.mount.direction)


EFFECTERS: Registry[type[Effecter]] = Registry("effecter")
"""Classes of effecters by type."""
