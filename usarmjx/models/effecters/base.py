"""What an effecter is: the parts it adds to its robot, its operations, what each does (manual 8, 14.3).

An effecter acts in three ways only: it gives its joints an order, it switches the headlight, or it takes
something from its stock and drops it. `effect` says which as plain arrays; `usarmjx.sim.operate` carries it
out.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.registry import Registry
from usarmjx.base.transforms import Vec3, mat_from_angles
from usarmjx.models.types.robot import Mount, Part, RobotSpec
from usarmjx.models.types.shapes import Shape

MAX_DROPPED_TAGS = 64
"""Most RFID tags that lie in one world (the manual's releasers have ids for 1001)."""


class DroppedTags(struct.PyTreeNode, kw_only=True):
    """RFID tags that releasers have dropped in one world since it began.

    The tag in place i has the ID i, so that IDs are unique and among those that releasers may give, 0 to
    1000 (manual 11.2.1).

    Attributes:
        pos: Where they lie [m] (TAG_ROOM, 3); only the first `count` are there.
        count: How many there are ().
    """

    pos: Array
    count: Array


def no_dropped_tags() -> DroppedTags:
    """Return the tags of a world in which none was dropped yet."""
    return DroppedTags(pos=xp.zeros((MAX_DROPPED_TAGS, 3)), count=xp.zeros((), xp.int32))


@dataclass(frozen=True)
class Opcode:
    """An operation that an effecter understands.

    Attributes:
        name: Its name on the wire: the manual's vocabulary (8), or the type's own (11).
        max_val: Largest parameter; an operation whose limits are equal takes none.
        min_val: Smallest parameter.
        default_val: The parameter of a client that gives none; None: it must give one.
    """

    name: str
    max_val: float = 0.0
    min_val: float = 0.0
    default_val: float | None = 0.0

    @property
    def takes_value(self) -> bool:
        """Whether its parameter means something."""
        return self.max_val > self.min_val


NOP = Opcode("NOP")
RESET = Opcode("Reset")


@dataclass(frozen=True, kw_only=True)
class Effect:
    """What a valid operation does; arrays (...,).

    Attributes:
        target: What all of the effecter's joints are told, by way of `joint_target`; None leaves them alone.
        mode: What `target` is: 0 for a position, 1 for a velocity.
        light: Whether the headlight is on; None leaves it alone.
        stock: What is left in stock; None: as much as before.
        drops: Whether something is dropped on the ground below.
        possible: Whether it can be done now.
        reply_number: What the answer is instead of OK; None: OK.
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
    """Settings that all effecters have.

    Attributes:
        weight: Adds to the payload [kg] (manual 11.2.2).
    """

    weight: float = 0.4


@dataclass(frozen=True)
class Effecter(ABC):
    """One effecter of a robot class.

    Attributes:
        kind: Type as on the wire.
        settings_class: The class of its settings, a dataclass with the manual's ini keys.
        mount: Where it sits.
        settings: Its settings with the mount's overrides.
    """

    kind: ClassVar[str]
    settings_class: ClassVar[type] = EffecterSettings

    mount: Mount
    settings: Any

    def fitted(self, robot: RobotSpec) -> Self:
        """Return it as it is on a robot, where its settings leave something to what that has."""
        del robot
        return self

    @property
    @abstractmethod
    def opcodes(self) -> tuple[Opcode, ...]:
        """The operations that it understands."""

    @abstractmethod
    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return what an operation does.

        Args:
            opcode: One of `opcodes`.
            value: Parameter, within the operation's limits (...,).
            stock: What is left in stock (...,).
        """

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that it moves, all alike."""
        return ()

    def joint_target(self, part: Part, target: Array) -> Array:
        """Return the target of one of its joints [rad or m, or per second] for that of all (...,)."""
        del part
        return target

    @property
    def initial_stock(self) -> int:
        """How much it carries to release."""
        return 0

    def parts(self) -> tuple[Part, ...]:
        """Return the parts that it consists of; those that the robot has already are not added."""
        return ()

    def shapes(self) -> tuple[Shape, ...]:
        """Return solids that it adds to the part it is mounted on, in that part's axes."""
        return ()

    def is_type(self, kind: str) -> bool:
        """Return whether it is of that type, case ignored; all are of the type Effecter (manual 9.4)."""
        return kind.lower() in (self.kind.lower(), "effecter")

    def opcode(self, name: str) -> Opcode | None:
        """Return the operation of that name, case ignored; None when there is none."""
        return next((opcode for opcode in self.opcodes if opcode.name.lower() == name.lower()), None)

    def to_parent(self, at: Vec3) -> Vec3:
        """Return a point of the effecter's axes in those of its parent [m]."""
        x, y, z = (np.array(self.mount.at) + mat_from_angles(*self.mount.direction) @ np.array(at)).tolist()
        return (x, y, z)

    def part_in_parent(self, part: Part) -> Part:
        """Return a part, described in the effecter's axes, as its parent has it."""
        return replace(
            part, parent=self.mount.parent, at=self.to_parent(part.at), rotation=self.mount.direction
        )

    def shape_in_parent(self, shape: Shape) -> Shape:
        """Return a solid, upright in the effecter's axes, as its parent has it."""
        return replace(shape, at=self.to_parent(shape.at), rotation=self.mount.direction)


EFFECTERS: Registry[type[Effecter]] = Registry("effecter")
