"""Effecters: devices with which robots act on the world (manual 8, 11).

`base.Effecter` is an effecter of a robot, with its own parts, solids and operations; `standard` has
the manual's, found by type in `EFFECTERS`. `effect` runs on NumPy and, traced, on JAX: see
`usarmjx.base.backend`. Begin with `standard.Headlight`. Building a
scene refuses a type that is not registered here.
"""

from functools import cache

from usarmjx.base.errors import SpecError
from usarmjx.models.effecters.base import (
    EFFECTERS,
    MAX_DROPPED_TAGS,
    DroppedTags,
    Effect,
    Effecter,
    Opcode,
    no_dropped_tags,
)
from usarmjx.models.effecters.standard import Gripper, Headlight, RfidReleaser, RollerTable, Vacuum
from usarmjx.models.types.robot import RobotSpec, resolve_settings

__all__ = [
    "EFFECTERS",
    "MAX_DROPPED_TAGS",
    "DroppedTags",
    "Effect",
    "Effecter",
    "Gripper",
    "Headlight",
    "Opcode",
    "RfidReleaser",
    "RollerTable",
    "Vacuum",
    "effecters_of",
    "no_dropped_tags",
]


@cache
def effecters_of(robot: RobotSpec) -> tuple[Effecter, ...]:
    """Return the effecters of a robot class, in the order of their mounts.

    Raises:
        UnknownNameError: A mount of an unknown type or with an unknown setting.
        UsageError: A setting of the wrong kind.
        SpecError: Two effecters of one name.
    """
    names = [mount.name.lower() for mount in robot.effecters]
    if len(set(names)) < len(names):
        raise SpecError(f"robot {robot.name}: effecters of one name among {', '.join(names)}")
    effecters: list[Effecter] = []
    for mount in robot.effecters:
        kind = EFFECTERS.get(mount.kind)
        settings = resolve_settings(kind.settings_class, mount.all_options, f"{mount.kind} {mount.name}")
        effecters.append(kind(mount=mount, settings=settings).fitted(robot))
    return tuple(effecters)
