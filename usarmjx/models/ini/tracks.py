"""Tires of tracked flippers from an ini file: `[USARBot.TarantulaFrontTrack]` NumTires (manual 12.10.2)."""

import re
from collections.abc import Mapping
from dataclasses import replace

from usarmjx.models.drives import Tracks
from usarmjx.models.ini.parse import Line
from usarmjx.models.ini.read import as_whole, fail
from usarmjx.models.spec.robot import Part, RobotSpec

TRACKS = {"front": ("FRFlipper", "FLFlipper"), "rear": ("RRFlipper", "RLFlipper")}
"""The flippers at each end of a robot."""
MAX_TIRES = 12
"""Most tires of one flipper; more only cost time."""


def read_tracks(robot: RobotSpec, lines: Mapping[str, Line]) -> RobotSpec:
    """Return a robot with so many tires on the flippers of its ends.

    Args:
        robot: A robot whose flippers carry wheels named `FRFlipperWheel1` and so on, driven as tracks.
        lines: `NumTires` lines by end.

    Raises:
        SpecError: A robot without such flippers, or no whole number from 1 to 12; names file and line.
    """
    for end, line in lines.items():
        count = as_whole(line, 1, MAX_TIRES)
        for flipper in TRACKS[end]:
            wheels = [part for part in robot.parts if _belongs(part, flipper)]
            if not wheels or not isinstance(robot.drive, Tracks):
                fail(line, f"{robot.name} has no tires on {flipper}", "a robot with tracked flippers")
            robot = _retracked(robot, flipper, wheels, count)
    return robot


def _belongs(part: Part, flipper: str) -> bool:
    return (
        part.is_wheel
        and part.parent == flipper
        and re.fullmatch(rf"{flipper}Wheel\d+", part.name) is not None
    )


def _retracked(robot: RobotSpec, flipper: str, wheels: list[Part], count: int) -> RobotSpec:
    """Return a robot with the wheels of one flipper evenly spaced anew; their sizes shrink to the tip's.

    Together they weigh what they did.
    """
    last = wheels[-1]
    tip, first = last.shapes[0].size[0], robot.wheel_radius
    fresh = []
    for i in range(1, count + 1):
        share = i / count
        fresh.append(_scaled(last, f"{flipper}Wheel{i}", share, (first + (tip - first) * share) / tip))
    before, after = (sum(part.shapes[0].mass for part in row) for row in (wheels, fresh))
    fresh = [
        replace(p, shapes=(replace(p.shapes[0], mass=p.shapes[0].mass * before / after),)) for p in fresh
    ]
    at = robot.parts.index(wheels[0])
    kept = [part for part in robot.parts if part not in wheels]
    robot = replace(robot, parts=(*kept[:at], *fresh, *kept[at:]))
    return replace(robot, drive=_redriven(robot, {part.name for part in wheels}, [p.name for p in fresh]))


def _scaled(wheel: Part, name: str, share: float, size: float) -> Part:
    """Return a wheel nearer to the hinge, `size` times as large: same belt speed, same pull."""
    tyre, motor = wheel.shapes[0], wheel.motor
    radius, width = tyre.size[0] * size, tyre.size[1]
    if motor is not None:
        motor = replace(
            motor,
            max_speed=motor.max_speed / size,
            torque=motor.torque * size,
            stiffness=motor.stiffness * size**2,
            damping=motor.damping * size**2,
            armature=motor.armature * size**2,
        )
    x, y, z = (share * place for place in wheel.at)
    tyre = replace(tyre, size=(radius, width), mass=tyre.mass * size**2)
    return replace(wheel, name=name, at=(x, y, z), motor=motor, shapes=(tyre,))


def _redriven(robot: RobotSpec, gone: set[str], fresh: list[str]) -> Tracks:
    """Return the drive with wheels replaced in their places."""
    drive = robot.drive
    assert isinstance(drive, Tracks)
    radii = {part.name: part.shapes[0].size[0] for part in robot.wheels}

    def side(names: tuple[str, ...]) -> tuple[str, ...]:
        if not gone & set(names):
            return names
        return (*(name for name in names if name not in gone), *fresh)

    left, right = side(drive.left), side(drive.right)
    ratios = tuple(drive.radius / radii[name] for name in (*left, *right))
    return replace(drive, left=left, right=right, ratios=ratios)
