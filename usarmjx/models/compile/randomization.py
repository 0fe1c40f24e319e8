"""Domain randomisation: values that differ between worlds, robots and episodes beside arenas and noise.

`DomainRandomization` holds the ranges, `RandomizedValues` one world's numbers. Physical ones reach the engine
as fields of its model that differ between worlds (`base.VariedModel`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, vmap, xp
from usarmjx.base.errors import SpecError
from usarmjx.base.nodes import Node
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting, validate
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.types.robot import RobotSpec

Range = tuple[float, float]
"""Lowest and highest value of a uniform distribution."""

MAX_LATENCY = 100
"""Largest latency that is accepted [control steps]; more is taken for a mistake."""


class QuantityRule(NamedTuple):
    """Allowed values of a quantity of `DomainRandomization`.

    Attributes:
        robots: Whether each robot has its own value; else the world has one.
        neutral: Value of a robot that does not vary.
        whole: Whether it is an integer.
    """

    robots: bool = False
    neutral: float = 1.0
    whole: bool = False


_ROBOT_FACTOR = QuantityRule(robots=True)
QUANTITY_RULES = {
    "friction": QuantityRule(),
    "mass": _ROBOT_FACTOR,
    "wheel": _ROBOT_FACTOR,
    "torque": _ROBOT_FACTOR,
    "speed": _ROBOT_FACTOR,
    "noise": _ROBOT_FACTOR,
    "latency": QuantityRule(robots=True, neutral=0.0, whole=True),
    "radio_pdo": QuantityRule(),
    "radio_n": QuantityRule(),
    "radio_cutoff": QuantityRule(),
    "radio_atten_fac": QuantityRule(),
}
"""Rules of the quantities.

New ones come last: the index of a quantity here is part of its random key.
"""


@dataclass(frozen=True, kw_only=True)
class DomainRandomization:
    """Ranges from which worlds and their robots draw at the start of each episode; None: no variation.

    Attributes:
        friction: Factor on the sliding friction of all surfaces, one per world.
        mass: Factor on mass and inertia of a robot's chassis, as of a load spread over it.
        wheel: Factor on the radius of a robot's wheels, which odometry does not know. Rays and pictures show
            the radius of the description.
        torque: Factor on the torque of a robot's motors.
        speed: Factor on the speed of a robot's motors, at any command and at most; for robots that fly or
            dive, on their commanded speeds.
        noise: Factor on the noise of a robot's sensors; 0 removes it.
        latency: Delay from command to motors [control steps].
        radio_pdo: Power received at the reference distance [dBm].
        radio_n: Path loss exponent of the radio.
        radio_cutoff: Lowest power at which a link holds [dBm].
        radio_atten_fac: Attenuation per solid [dB].
        classes: Robot classes that vary; empty: all classes of the roster.

    Raises:
        SpecError: A range that is not allowed; says what is.
    """

    friction: Annotated[Range | None, POSITIVE] = None
    mass: Annotated[Range | None, POSITIVE] = None
    wheel: Annotated[Range | None, POSITIVE] = None
    torque: Annotated[Range | None, POSITIVE] = None
    speed: Annotated[Range | None, POSITIVE] = None
    noise: Annotated[Range | None, NOT_NEGATIVE] = None
    latency: Annotated[tuple[int, int] | None, Setting(ge=0, le=MAX_LATENCY)] = None
    radio_pdo: Range | None = None
    radio_n: Annotated[Range | None, NOT_NEGATIVE] = None
    radio_cutoff: Range | None = None
    radio_atten_fac: Annotated[Range | None, NOT_NEGATIVE] = None
    classes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the ranges."""
        validate(self)

    def problem(self) -> str:
        """Return the range that ends below its start, in words; empty: there is none."""
        spans = [(name, self.range_of(name)) for name in QUANTITY_RULES]
        wrong = [f"{name} is {span}" for name, span in spans if span is not None and span[0] > span[1]]
        return f"{wrong[0]}, expected two numbers (lowest, highest)" if wrong else ""

    def range_of(self, name: str) -> Range | None:
        """Return the range of a quantity of `QUANTITY_RULES`."""
        return getattr(self, name)


class RandomizedValues(Node, kw_only=True):
    """Values of one world in one episode, as in `DomainRandomization`; None: not varied.

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
    """Return a world's values for an episode.

    A value depends on the key, the quantity and the robot's slot alone: neither on the other quantities nor
    on the other robots.

    Args:
        vary: The ranges.
        varies: Which robots vary, by slot (robots,).
        key: Random key of the world and the episode.
        ranges: The world's own ranges of some of these quantities, lowest and highest (2,).
    """
    drawn: dict[str, Any] = {}
    given = ranges or {}
    for index, (name, rule) in enumerate(QUANTITY_RULES.items()):
        if vary.range_of(name) is None:
            continue
        span = given.get(name, vary.range_of(name))
        # By its index, not by splitting: a quantity that is added leaves the draws of the others alone.
        own = random.fold_in(key, index)
        if not rule.robots:
            drawn[name] = _number(rule, span, own)
            continue
        # One key per slot, not one draw of all: a robot's value does not depend on the size of the roster.
        numbers = vmap(partial(_number, rule, span))(random.fold_in(own, np.arange(len(varies))))
        drawn[name] = xp.where(varies, numbers, xp.asarray(rule.neutral, numbers.dtype))
    return RandomizedValues(**drawn)


def _number(rule: QuantityRule, span: Any, key: Array) -> Array:  # noqa: ANN401 - two numbers, traced or not
    low, high = span[0], span[1]
    if rule.whole:
        # JAX excludes the upper end.
        return random.randint(key, low, high + 1)
    return random.uniform(key, (), low, high)


@dataclass(frozen=True, eq=False)
class RandomizedBodies:
    """Bodies of a model whose robots vary.

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
    """Refuse a variation that would have no effect, or a wrong one, on some robots of a scene.

    Args:
        vary: The ranges.
        robots: The robots of the roster.
        radio: Whether they have radios.

    Raises:
        SpecError: Names the quantity and the robots.
    """
    there = sorted({robot.name for robot in robots})
    lost = sorted(set(vary.classes) - set(there))
    # A misspelt class would vary nothing, without a word.
    if lost:
        raise SpecError(f"vary: no robots of class {', '.join(lost)} here; there are {', '.join(there)}")
    if not radio and any(vary.range_of(name) for name in QUANTITY_RULES if name.startswith("radio")):
        raise SpecError("vary: this scene has no radio: give build_scene a radio=RadioSettings(...)")
    for name, (why, lacks) in _INAPPLICABLE.items():
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
    return robot.drive.applies_wrench


def _motors(robot: RobotSpec) -> bool:
    return any(part.motor is not None for part in parts_of(robot))


_INAPPLICABLE: dict[str, tuple[str, Callable[[RobotSpec], bool]]] = {
    "mass": ("is trimmed to its weight", _pushed),
    "wheel": ("has no wheels", lambda robot: max_wheel_radius(robot) == 0.0),
    "torque": ("has no motors at its joints to move by", lambda robot: _pushed(robot) or not _motors(robot)),
    "speed": ("has no motors", lambda robot: not _pushed(robot) and not _motors(robot)),
    "latency": ("has no motors to command", lambda robot: not _pushed(robot) and not _motors(robot)),
}
"""Conditions under which a quantity does not apply to a robot, with the reason."""


def max_wheel_radius(robot: RobotSpec) -> float:
    """Return the radius of a robot's largest wheel [m]; 0 without wheels."""
    rolling = (part for part in parts_of(robot) if part.is_wheel)
    return max((shape.size[0] for part in rolling for shape in part.shapes), default=0.0)
