"""DM-USAR_yellow, modelled on NIST's yellow arena.

The manual (3.2.1.1): the simplest arena, a large flat floor with perpendicular walls and moderately
difficult obstacles. The plan is ours, on the 1.2 m grid of the NIST arenas. The floor lies 2.08 m below
the wire's origin, so that the manual's start position (Table 2: 4.5,1.9,1.8, z down) puts a P2AT, whose
origin is 0.26 m above the ground (5.3.6), 2 cm above the floor.
"""

import math

from usarmjx.models.arena_spec import ArenaSpec, StartPose
from usarmjx.models.arenas.floorplan import walls
from usarmjx.models.spec import Shape

FLOOR = -2.08
CELL = 1.2
ORIGIN = (-2.4, -4.8)
START_HEIGHT = 0.188  # manual 5.3.5: where the Unreal editor puts every PlayerStart

PLAN = """
+--+--+--+--+--+--+--+--+--+--+--+--+
|           |              |        |
+  +--+  +  +  +--+--+  +  +  +--+  +
|  |        |     |           |     |
+  +  +--+  +--+  +  +--+--+  +  +--+
|        |        |        |        |
+--+  +  +--+--+  +  +--+  +--+--+  +
|     |           |                 |
+  +--+  +--+  +--+--+  +--+--+  +  +
|              |           |     |  |
+  +--+--+  +  +  +  +--+  +  +--+  +
|        |  |        |        |     |
+--+--+  +  +--+--+  +  +--+--+  +  +
|                    |           |  |
+  +--+--+--+  +--+  +--+--+  +--+  +
|           |                       |
+--+--+--+--+--+--+--+--+--+--+--+--+
"""

WOOD = (0.7, 0.55, 0.35, 1.0)
STONE = (0.6, 0.6, 0.6, 1.0)
RAMP_ANGLE = math.radians(15)  # the NIST arenas' ramps


def _cell(column: int, row: int) -> tuple[float, float]:
    """Return the centre of a grid cell, row 0 being the last line of the plan [m]."""
    return (ORIGIN[0] + (column + 0.5) * CELL, ORIGIN[1] + (row + 0.5) * CELL)


def _block(
    column: int, row: int, size: tuple[float, float, float], offset: tuple[float, float] = (0, 0)
) -> Shape:
    """A box of full lengths `size` standing on the floor, in reach of wheels."""
    x, y = _cell(column, row)
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Shape(
        kind="box", size=half, at=(x + offset[0], y + offset[1], half[2]), surface="ground", rgba=STONE
    )


def _ramp(column: int, row: int, uphill: float, width: float = 1.1, run: float = 1.1) -> Shape:
    """A 15 degree slope that rises out of the floor; `uphill` is the direction of climb [rad]."""
    x, y = _cell(column, row)
    length, thickness = run / math.cos(RAMP_ANGLE), 0.2
    # The upper face meets the floor at its low edge, so the centre lies half a length up the slope and
    # half a thickness below it; what lies under the floor meets nothing.
    rise = math.sin(RAMP_ANGLE) * length / 2 - math.cos(RAMP_ANGLE) * thickness / 2
    return Shape(
        kind="box",
        size=(length / 2, width / 2, thickness / 2),
        at=(x, y, rise),
        rotation=(0.0, -RAMP_ANGLE, uphill),
        surface="ground",
        rgba=WOOD,
    )


OBSTACLES = (
    _block(1, 6, (0.39, 0.19, 0.19)),  # cinder blocks
    _block(9, 1, (0.19, 0.39, 0.19), (0.2, -0.1)),
    _block(4, 2, (0.39, 0.19, 0.19), (-0.1, 0.2)),
    _block(7, 5, (0.10, 0.10, 1.2), (0.25, 0.25)),  # posts
    _block(3, 4, (0.10, 0.10, 1.2), (0.2, 0.3)),
    _block(2, 0, (0.10, 0.10, 1.2), (0.0, 0.2)),
    _block(6, 0, (0.09, 1.0, 0.04)),  # boards on the floor to drive over
    _block(8, 3, (0.09, 1.0, 0.04)),
    _block(10, 4, (1.0, 1.0, 0.06)),  # a low platform
    _block(1, 4, (0.60, 0.40, 0.45), (0.0, 0.3)),  # a crate
    _block(10, 6, (0.50, 0.50, 0.50), (0.2, 0.2)),
    _ramp(2, 7, 0.0),  # up and down again
    _ramp(3, 7, math.pi),
    _ramp(10, 0, 0.0),
)

# The first is the manual's. 47 more on cell centres and beside them, so that a team of any usual size
# has places of its own; all at least 0.6 m from the next and clear of walls and obstacles.
START_CELLS = (
    (0, 0), (1, 0), (4, 0), (5, 0), (7, 0), (8, 0), (11, 0),
    (0, 1), (1, 1), (2, 1), (3, 1), (5, 1), (6, 1), (8, 1), (11, 1),
    (0, 2), (1, 2), (2, 2), (3, 2), (6, 2), (7, 2), (8, 2), (10, 2),
    (0, 3), (1, 3), (2, 3), (3, 3), (4, 3), (5, 3), (6, 3), (7, 3), (9, 3), (11, 3),
    (0, 4), (5, 4), (6, 4), (7, 4), (8, 4), (11, 4),
    (0, 5), (2, 5), (4, 5), (5, 5), (6, 5), (9, 5), (10, 5), (11, 5),
)  # fmt: skip

YELLOW = ArenaSpec(
    name="DM-USAR_yellow",
    aliases=("yellow",),
    floor=FLOOR,
    shapes=(*walls(PLAN, origin=ORIGIN, cell=CELL), *OBSTACLES),
    starts=(
        StartPose(tag="PlayerStart", at=(4.5, -1.9, START_HEIGHT)),
        *(
            StartPose(tag=f"Start{i}", at=(*_cell(*cell), START_HEIGHT), yaw=math.pi / 2 * (i % 4 - 1))
            for i, cell in enumerate(START_CELLS, start=1)
        ),
    ),
    extent=((ORIGIN[0], ORIGIN[0] + 12 * CELL), (ORIGIN[1], ORIGIN[1] + 8 * CELL)),
)
