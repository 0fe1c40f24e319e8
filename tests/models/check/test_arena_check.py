"""What the check of an arena says: one sentence for each thing that is wrong, none where nothing is."""

import re
from dataclasses import replace

import numpy as np
import pytest

from usarmjx.base.errors import UnknownNameError
from usarmjx.models.arenas import ARENAS
from usarmjx.models.check import check_arena
from usarmjx.models.types.arena import ArenaSpec, Door, LooseObject, StartPose, Tag, Victim, Water
from usarmjx.models.types.shapes import HeightField, Shape

START = StartPose(tag="A", at=(0, 0, 0.188))
ROOM = ArenaSpec(name="room", starts=(START,), extent=((-5, 5), (-5, 5)))
WALL = Shape(kind="box", size=(0.05, 5, 0.5), at=(2, 0, 0.5), surface="wall")
FLOOR = Shape(kind="box", size=(5, 5, 0.1), at=(0, 0, -0.1), surface="ground")
BRICK = LooseObject(
    name="brick",
    at=(1, 0, 0.051),
    shapes=(Shape(kind="box", size=(0.1, 0.1, 0.05), mass=2, surface="loose"),),
)
VICTIM = Victim(name="Anna", at=(3, 0, 0.11), rotation=(0, 0, np.pi / 2))
GAP = replace(WALL, size=(0.05, 2, 0.5), at=(2, 3, 0.5))


def start(*at, tag="A", yaw=0.0):
    return StartPose(tag=tag, at=at, yaw=yaw)


FINE = {
    "a plain floor": {},
    "no floor but a box": {"has_floor": False, "shapes": (FLOOR,)},
    "a ramp under the robot": {
        "shapes": (
            Shape(kind="box", size=(2, 2, 0.1), at=(0, 0, 0.2), rotation=(0, -0.2, 0), surface="ground"),
        ),
        "starts": (start(0, 0, 0.3 / np.cos(0.2) - 0.002 + 0.188),),
    },
    "a terrain": {
        "shapes": (
            Shape(
                kind="hfield",
                size=(4, 4, 0.1),
                heights=HeightField(0.5 * np.ones((9, 9)) + 0.001 * np.eye(9)),
                surface="ground",
            ),
        ),
        "starts": (start(0.3, 0.1, 0.5 + 0.188),),
    },
    "a way round the wall": {"shapes": (GAP,), "victims": (VICTIM,)},
    "a wall that is seen but never touched": {
        "shapes": (replace(WALL, surface="fixture"),),
        "victims": (VICTIM,),
    },
    "a door open to all": {"doors": (Door(name="d", at=(2, -0.45, 0), yaw=np.pi / 2),)},
    "a victim that leans on a wall": {
        "shapes": (replace(WALL, size=(0.05, 1, 0.5), at=(3.2, 0, 0.5)),),
        "victims": (replace(VICTIM, at=(3, 0, 0.12), rotation=(0, 0, np.pi), posture="sitting"),),
    },
    "starts side by side, as in a car park": {
        "starts": (start(0, 0, 0.188, yaw=np.pi / 2), start(0.6, 0, 0.188, tag="B", yaw=-np.pi / 2)),
    },
    "a door beside its wall": {
        "shapes": (GAP,),
        "doors": (Door(name="d", at=(2, 0.99, 0), yaw=-np.pi / 2),),
    },
    "bricks apart": {"loose": (BRICK, replace(BRICK, name="two", at=(1.21, 0, 0.051)))},
    "tags of both kinds": {"tags": (Tag(at=(1, 1, 0)), Tag(at=(1, 1, 0)), Tag(at=(1, 1, 0), id=1001))},
    "a robot in a pond": {
        "waters": (Water(low=(-4, -4, 0), high=(4, 4, 3)),),
        "starts": (start(0, 0, 2),),
        "robots": ("Submarine",),
    },
    "an outer wall": {"shapes": (replace(WALL, at=(5.05, 0, 0.5)),)},
}


@pytest.mark.parametrize("change", FINE.values(), ids=FINE)
def test_nothing_is_said_of(change):
    assert check_arena(replace(ROOM, **change)) == []


WRONG = {
    "no start": ({"starts": ()}, "it has no start pose"),
    "a start in the air": (
        {"starts": (start(0, 0, 0.5),)},
        r"'A' is 0\.500 m above the ground under it, not 0\.188 \(manual 5\.3\.5\): its z should be 0\.188",
    ),
    "a start in a wall": (
        {"shapes": (WALL,), "starts": (start(1.9, 0, 0.188),)},
        r"start 'A': a P2AT stands 0\.\d\d m deep in shapes\[0\] \(box at 2, 0, 0\.5\)",
    ),
    "a start in a door": (
        {"doors": (Door(name="gate", at=(0.1, -0.45, 0), yaw=np.pi / 2),)},
        "start 'A': a P2AT stands 0.* m deep in door 'gate'",
    ),
    "a start in a brick": (
        {"loose": (replace(BRICK, at=(0.2, 0, 0.2)),)},
        "start 'A': a P2AT stands .* in loose object 'brick'",
    ),
    "a start in a victim": (
        {"victims": (replace(VICTIM, at=(0, 0, 0.11)),)},
        "start 'A': a P2AT stands .* in victim 'Anna'",
    ),
    "no ground": ({"has_floor": False}, "start 'A': there is no ground under it"),
    "a start outside": (
        {"starts": (START, start(6, 0, 0.188, tag="B"))},
        "start 'B' at 6, 0 is outside the extent",
    ),
    "a start behind a wall": (
        {"shapes": (WALL,), "starts": (START, start(4, 0, 0.188, tag="B"))},
        r"start 'B' at 4, 0: a P2AT from 'A' gets no nearer than 0\.3 m",
    ),
    "a start in a corner": (
        {"shapes": tuple(replace(WALL, at=(x, 0, 0.5)) for x in (-0.45, 0.45))},  # it can stand, not turn
        "start 'A': a P2AT has no room to turn there",
    ),
    "two starts of a name": (
        {"starts": (START, start(1, 0, 0.188))},
        "2 start poses are called 'A'",
    ),
    "a tag of two words": (
        {"starts": (start(0, 0, 0.188, tag="two words"),)},
        "start 'two words': a tag is one word",
    ),
    "a victim behind a wall": (
        {"shapes": (WALL,), "victims": (replace(VICTIM, at=(4, 0, 0.11)),)},
        r"victim 'Anna' at 4, 0: a P2AT from 'A' gets no nearer than 1\.0 m",
    ),
    "a victim inside a wall": (
        {"shapes": (replace(WALL, size=(0.3, 1, 0.5)),), "victims": (replace(VICTIM, at=(2.2, 0, 0.11)),)},
        r"victim 'Anna' is 0\.[12]\d m deep in shapes\[0\] \(box at 2, 0, 0\.5\)",
    ),
    "a thin wall through a victim": (
        {"shapes": (replace(WALL, size=(0.025, 1, 0.5)),), "victims": (replace(VICTIM, at=(2, 0, 0.11)),)},
        r"victim 'Anna' is 0\.\d\d m deep in shapes\[0\]",
    ),
    "a victim in the air": (
        {"victims": (replace(VICTIM, at=(2, 0, 2.11)),)},
        r"victim 'Anna' hangs in the air, 2\.0\d m above the ground",
    ),
    "a victim under the floor": (
        {"victims": (replace(VICTIM, at=(2, 0, -1)),)},
        r"victim 'Anna' is 1\.\d\d m below the floor|gets no nearer",
    ),
    "two starts side by side": (
        {"starts": (START, start(0.05, 0, 0.188, tag="B"))},
        r"starts 'A' and 'B' are 0\.05 m apart, .*: a P2AT is 0\.\d\d m long",
    ),
    "a door hinged in a wall": (
        {"shapes": (GAP,), "doors": (Door(name="gate", at=(2, 1.3, 0), yaw=-np.pi / 2),)},
        r"door 'gate' hangs 0\.\d\d m deep in shapes\[0\] .*: it cannot turn",
    ),
    "a door between two walls": (
        {
            "shapes": tuple(replace(WALL, size=(0.02, 0.6, 0.5), at=(x, 0, 0.5)) for x in (1.95, 2.05)),
            "doors": (Door(name="gate", at=(2, -0.45, 0), yaw=np.pi / 2, size=(0.9, 0.02, 1.0)),),
        },
        r"door 'gate' opens by \d degrees only",
    ),
    "a start on a wall": (
        {"shapes": (replace(WALL, size=(1, 1, 0.5), at=(0, 0, 0.5)),), "starts": (start(0, 0, 1.188),)},
        r"start 'A' is on top of shapes\[0\] .*, which is a wall",
    ),
    "a tag outside": ({"tags": (Tag(at=(0, 9, 0)),)}, r"tag 0 \(ID -1\) at 0, 9 is outside"),
    "IDs of releasers": ({"tags": (Tag(at=(0, 1, 0), id=7),)}, "ID 7; up to 1000 they belong to releasers"),
    "IDs twice": ({"tags": (Tag(at=(0, 1, 0), id=1007),) * 2}, "2 tags have the ID 1007"),
    "an extent too small": (
        {"shapes": (replace(WALL, at=(4, 2, 0.5)),)},
        r"shapes\[0\] \(box at 4, 2, 0\.5\) reaches 2\.00 m over the extent",
    ),
    "bricks in bricks": (
        {"loose": (BRICK, replace(BRICK, name="two", at=(1.19, 0, 0.051)))},
        "loose object '(brick|two)' lies 0.010 m deep in loose object '(brick|two)'",
    ),
    "a brick in the floor": (
        {"loose": (replace(BRICK, at=(1, 0, 0.04)),)},
        "loose object 'brick' lies 0.010 m deep in the floor",
    ),
    "a bottomless pond": (
        {"waters": (Water(low=(1, 1, -3), high=(2, 2, -1)),)},
        r"waters\[0\] has no ground under its middle",
    ),
    "a pond in the air": (
        {"waters": (Water(low=(1, 1, 1), high=(2, 2, 2)),)},
        r"waters\[0\] ends 1\.00 m above",
    ),
    "an unknown robot": ({"robots": ("P2AT", "Dalek")}, "recommended robot 'Dalek' is unknown"),
    "what cannot be built": ({"shapes": (replace(WALL, material="jelly"),)}, "it cannot be built: .*'jelly'"),
}


@pytest.mark.parametrize(("change", "says"), WRONG.values(), ids=WRONG)
def test_it_says_what_is_wrong_and_nothing_else(change, says):
    (sentence, *more) = check_arena(replace(ROOM, **change))
    assert re.search(says, sentence), sentence
    assert all(re.search(says, other) for other in more), more


def test_another_robot_may_pass_where_a_large_one_cannot():
    walls = tuple(replace(WALL, size=(0.05, 2.3, 0.5), at=(2, y, 0.5)) for y in (-2.7, 2.7))  # 0.8 m apart
    arena = replace(ROOM, shapes=walls, victims=(replace(VICTIM, at=(4, 0, 0.11)),))
    assert check_arena(arena, "P2DX") == []
    assert any("'Anna'" in sentence for sentence in check_arena(arena, "ATRVJr"))
    with pytest.raises(UnknownNameError, match="unknown robot 'Dalek'"):
        check_arena(arena, "Dalek")


@pytest.mark.parametrize("name", ARENAS.names())
def test_nothing_is_wrong_with_arenas_that_ship(name):
    assert check_arena(ARENAS.get(name)) == []
