"""Domain randomisation: what differs between worlds, robots and episodes beside arenas and noise, as data.

`DomainRandomization` says from which ranges, `RandomizedValues` has one world's numbers. Those that are
physics reach the engine as fields of its model that differ between worlds (`engines.varied`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from flax import struct

from usarmjx.base import random
from usarmjx.base.arrays import Array
from usarmjx.base.backend import vmap, xp
from usarmjx.base.errors import SpecError
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.types.robot import RobotSpec

Range = tuple[float, float]
"""The lowest and the highest value; in between all are as likely."""

LONGEST_LATENCY = 100
"""More control steps than this are no latency but a mistake."""


class QuantityRule(NamedTuple):
    """What a quantity of `DomainRandomization` may be.

    Attributes:
        robots: Whether each robot has its own; else the world has one.
        neutral: What a robot has that does not vary.
        positive: Whether it must be above 0.
        least: Else the lowest value allowed.
        most: The highest.
        whole: Whether it is a whole number.
    """

    robots: bool = False
    neutral: float = 1.0
    positive: bool = False
    least: float = -math.inf
    most: float = math.inf
    whole: bool = False


_FACTOR = QuantityRule(robots=True, positive=True)
QUANTITY_RULES = {
    "friction": QuantityRule(positive=True),
    "mass": _FACTOR,
    "wheel": _FACTOR,
    "torque": _FACTOR,
    "speed": _FACTOR,
    "noise": QuantityRule(robots=True, least=0.0),
    "latency": QuantityRule(robots=True, neutral=0.0, least=0.0, most=LONGEST_LATENCY, whole=True),
    "radio_pdo": QuantityRule(),
    "radio_n": QuantityRule(least=0.0),
    "radio_cutoff": QuantityRule(),
    "radio_atten_fac": QuantityRule(least=0.0),
}
"""The quantities. New ones come last: a quantity draws its numbers by its place here."""


@dataclass(frozen=True, kw_only=True)
class DomainRandomization:
    """Ranges that worlds, and the robots in them, draw from at the start of each episode; None: no variation.

    Attributes:
        friction: Factor on the sliding friction of everything, one for a world.
        mass: Factor on mass and inertia of a robot's chassis, as a load spread over it.
        wheel: Factor on the radius of a robot's wheels, which odometry does not know of. Rays and pictures
            show them as described.
        torque: Factor on what a robot's motors can exert.
        speed: Factor on how fast a robot's motors turn, at any command and at most; what flies or dives has
            its commanded speeds multiplied.
        noise: Factor on the noise of a robot's sensors; 0 is none.
        latency: Control steps by which a robot's motors hear of what it is told later; whole numbers.
        radio_pdo: Power received at the reference distance [dBm].
        radio_n: How fast power falls with distance.
        radio_cutoff: A link holds from this power on [dBm].
        radio_atten_fac: What each solid takes [dB].
        classes: Robot classes that vary; empty: all of the roster.

    Raises:
        SpecError: A range that is not allowed; says what is.
    """

    friction: Range | None = None
    mass: Range | None = None
    wheel: Range | None = None
    torque: Range | None = None
    speed: Range | None = None
    noise: Range | None = None
    latency: tuple[int, int] | None = None
    radio_pdo: Range | None = None
    radio_n: Range | None = None
    radio_cutoff: Range | None = None
    radio_atten_fac: Range | None = None
    classes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        for name, rule in QUANTITY_RULES.items():
            span = getattr(self, name)
            if span is not None:
                _check_range(name, span, rule)

    def range_of(self, name: str) -> Range | None:
        """Return the range of a quantity of `QUANTITY_RULES`."""
        return getattr(self, name)


def _check_range(name: str, span: object, rule: QuantityRule) -> None:
    kind = int if rule.whole else (int, float)
    pair = isinstance(span, Sequence) and len(span) == 2 and all(isinstance(x, kind) for x in span)
    if not pair or not all(map(math.isfinite, span)) or span[0] > span[1]:  # type: ignore - two numbers then
        what = "whole numbers" if rule.whole else "numbers"
        raise SpecError(f"vary: {name} is {span!r}, expected two {what} (lowest, highest)")
    low, high = span  # type: ignore - two numbers
    if (rule.positive and low <= 0) or low < rule.least or high > rule.most:
        least = "above 0" if rule.positive else f"from {rule.least:g}"
        most = "" if rule.most == math.inf else f" to {rule.most:g}"
        raise SpecError(f"vary: {name} is {span}, allowed is {least}{most}")


class RandomizedValues(struct.PyTreeNode, kw_only=True):
    """The numbers of one world in one episode, as `DomainRandomization` explains them; None: not varied.

    Attributes:
        friction: Factor ().
        mass: Factor, by roster slot (robots,).
        wheel: Factor, by roster slot (robots,).
        torque: Factor, by roster slot (robots,).
        speed: Factor, by roster slot (robots,).
        noise: Factor, by roster slot (robots,).
        latency: Control steps, by roster slot (robots,).
        radio_pdo: Power [dBm] ().
        radio_n: Exponent ().
        radio_cutoff: Power [dBm] ().
        radio_atten_fac: Loss [dB] ().
    """

    friction: Array | None = None
    mass: Array | None = None
    wheel: Array | None = None
    torque: Array | None = None
    speed: Array | None = None
    noise: Array | None = None
    latency: Array | None = None
    radio_pdo: Array | None = None
    radio_n: Array | None = None
    radio_cutoff: Array | None = None
    radio_atten_fac: Array | None = None


def sample_values(
    vary: DomainRandomization, varies: np.ndarray, key: Array, ranges: Mapping[str, Array] | None = None
) -> RandomizedValues:
    """Return the numbers of a world for an episode.

    A number depends on the key, the quantity and the robot's slot alone: neither on the other quantities nor
    on who else is there.

    Args:
        vary: The ranges.
        varies: Which robots vary, by slot (robots,).
        key: The world's and the episode's.
        ranges: The world's own ranges of some of these quantities, lowest and highest (2,).
    """
    drawn, given = {}, ranges or {}
    for place, (name, rule) in enumerate(QUANTITY_RULES.items()):
        if vary.range_of(name) is None:
            continue
        span = given.get(name, vary.range_of(name))
        own = random.fold_in(key, place)
        if not rule.robots:
            drawn[name] = _number(rule, span, own)
            continue
        numbers = vmap(partial(_number, rule, span))(random.fold_in(own, np.arange(len(varies))))
        drawn[name] = xp.where(varies, numbers, xp.asarray(rule.neutral, numbers.dtype))
    return RandomizedValues(**drawn)


def _number(rule: QuantityRule, span: Any, key: Array) -> Array:  # noqa: ANN401 - two numbers, traced or not
    low, high = span[0], span[1]
    if rule.whole:
        return random.randint(key, low, high + 1)
    return random.uniform(key, (), low, high)


@dataclass(frozen=True, eq=False)
class RandomizedBodies:
    """Where in a model the robots are that vary.

    Attributes:
        vary: The ranges.
        varies: Which robots vary, by slot (robots,).
        chassis: Bodies of their chassis, by slot (robots,).
        owner: Slot of the robot that a body belongs to, -1 for others (nbody,).
        wheel: Whether a body rolls (nbody,).
    """

    vary: DomainRandomization
    varies: np.ndarray
    chassis: np.ndarray
    owner: np.ndarray
    wheel: np.ndarray


def check_randomization(vary: DomainRandomization, robots: Sequence[RobotSpec], radio: bool) -> None:
    """Refuse a variation that would have no, or a wrong, effect on some robots of a scene.

    Args:
        vary: The ranges.
        robots: The robots of the roster.
        radio: Whether they have radios.

    Raises:
        SpecError: Names the quantity and the robots.
    """
    there = sorted({robot.name for robot in robots})
    lost = sorted(set(vary.classes) - set(there))
    if lost:
        raise SpecError(f"vary: no robots of class {', '.join(lost)} here; there are {', '.join(there)}")
    if not radio and any(vary.range_of(name) for name in QUANTITY_RULES if name.startswith("radio")):
        raise SpecError("vary: this scene has no radio: give build_scene a radio=RadioSettings(...)")
    for name, (why, lacks) in _LACKS.items():
        if vary.range_of(name) is None:
            continue
        bad = sorted({robot.name for robot in robots if is_randomized(vary, robot) and lacks(robot)})
        if bad:
            raise SpecError(
                f"vary: {name} does not go with {', '.join(bad)}, which {why}; "
                "name the classes that vary in classes=(...)"
            )


def is_randomized(vary: DomainRandomization, robot: RobotSpec) -> bool:
    """Return whether robots of a class vary."""
    return not vary.classes or robot.name in vary.classes


def _pushed(robot: RobotSpec) -> bool:
    return robot.drive.pushes


def _motors(robot: RobotSpec) -> bool:
    return any(part.motor is not None for part in parts_of(robot))


_LACKS = {
    "mass": ("is trimmed to its weight", _pushed),
    "wheel": ("has no wheels", lambda robot: max_wheel_radius(robot) == 0.0),
    "torque": ("has no motors at its joints to move by", lambda robot: _pushed(robot) or not _motors(robot)),
    "speed": ("has no motors", lambda robot: not _pushed(robot) and not _motors(robot)),
    "latency": ("has nothing to be told", lambda robot: not _pushed(robot) and not _motors(robot)),
}
"""What a robot lacks that a quantity is about."""


def max_wheel_radius(robot: RobotSpec) -> float:
    """Return the radius of a robot's largest wheel [m]; 0 without wheels."""
    rolling = (part for part in parts_of(robot) if part.is_wheel)
    return max((shape.size[0] for part in rolling for shape in part.shapes), default=0.0)
