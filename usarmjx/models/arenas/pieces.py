"""Parts that several arenas share: walls from drawn plans, building parts, debris, finishes, and elements.

Elements are those of the NIST arenas, later ASTM's standard test methods for response robots. All stand on a
grid of 1.2 m, the width of a sheet of plywood. Ramps of 15 degrees are ASTM E2826's (continuous) and E2827's
(crossing), stairs E2804's, step fields E2828's. Lengths that these leave open are marked chosen. Positions
are in the arena's axes, headings are counter-clockwise from x.
"""

import math
import random
from collections.abc import Iterable, Mapping
from dataclasses import replace

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import Vec3
from usarmjx.models.types.arena import LooseObject, SegmentMotion
from usarmjx.models.types.shapes import OPAQUE, ZERO, Position2D, Rgba, Shape

CELL = 1.2
"""Side of a grid cell [m]."""
RAMP_ANGLE = math.radians(15)
"""Slope of ramps [rad]."""
STEEP, STEEPER = math.radians(35), math.radians(40)
"""Slopes of the stairs of the orange arena, and of the steeper ones [rad]."""
RISE = 0.18
"""Rise of one stair [m] (chosen)."""
PLYWOOD_THICKNESS = 0.10
"""Thickness of decks and slabs with their joists [m] (chosen)."""

WOOD: Rgba = (0.7, 0.55, 0.35, 1.0)
STONE: Rgba = (0.6, 0.6, 0.6, 1.0)

UPHILL = {">": 0.0, "^": math.pi / 2, "<": math.pi, "v": -math.pi / 2}
"""Directions of climb of the arrows in a plan of ramps [rad]."""

POST = 0.10
"""Width of a post [m]."""

STEP_FIELDS = {
    "flat": """
211111112111
121111111211
112111111121
111211111112
111121111111
111112111111
111111211111
111111121111
211111112111
121111111211
112111111121
111211111112
""",
    "hill": """
112234432211
112234432211
122234432211
112234442211
112334432211
112234432211
112234432211
112234433211
112244432211
112234432221
112234432211
112234432211
""",
    "diagonal": """
443322110000
443322110000
334433221100
334433221100
223344332211
223344332211
112233443322
112233443322
001122334433
001122334433
000011223344
000011223344
""",
}
"""Heights of the posts in units, rows along y from the largest on; the hill's ridge lies along y."""

PostHeights = list[list[int]]
"""Heights of posts in units, rows along x, columns along y."""


def cell_center(origin: Position2D, column: float, row: float) -> Position2D:
    """Return the centre of a cell of the grid that has its lower left corner at `origin` [m]."""
    return (origin[0] + (column + 0.5) * CELL, origin[1] + (row + 0.5) * CELL)


def block(
    at: tuple[float, float],
    size: Vec3,
    *,
    z: float = 0.0,
    yaw: float = 0.0,
    surface: str = "ground",
    rgba: Rgba = STONE,
) -> Shape:
    """Return a box of full lengths `size` that stands at height `z` [m]; `at` is its middle."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Shape(
        kind="box", size=half, at=(*at, z + half[2]), rotation=(0.0, 0.0, yaw), surface=surface, rgba=rgba
    )


def deck(
    low: tuple[float, float], high: tuple[float, float], top: float, *, thickness: float = PLYWOOD_THICKNESS
) -> Shape:
    """Return a floor between two corners whose upper face lies at `top` [m]."""
    middle = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
    size = (high[0] - low[0], high[1] - low[1], thickness)
    return block(middle, size, z=top - thickness, rgba=WOOD)


def slope(
    foot: Vec3,
    head: Vec3,
    width: float,
    *,
    thickness: float = PLYWOOD_THICKNESS,
    surface: str = "ground",
    rgba: Rgba = WOOD,
) -> Shape:
    """Return a slab whose upper face rises from the middle of its low edge to that of its high edge [m].

    Its ends are perpendicular to that face.
    """
    along, across, rise = (b - a for a, b in zip(foot, head, strict=True))
    run = math.hypot(along, across)
    angle, uphill = math.atan2(rise, run), math.atan2(across, along)
    # From the upper face, which is given, to the slab's centre half a thickness below it.
    back = thickness / 2 * math.sin(angle)
    x, y, z = ((a + b) / 2 for a, b in zip(foot, head, strict=True))
    return Shape(
        kind="box",
        size=(math.hypot(run, rise) / 2, width / 2, thickness / 2),
        at=(x + back * math.cos(uphill), y + back * math.sin(uphill), z - thickness / 2 * math.cos(angle)),
        rotation=(0.0, -angle, uphill),
        surface=surface,
        rgba=rgba,
    )


def ramp(
    at: tuple[float, float],
    uphill: float,
    *,
    run: float = 1.1,
    width: float = 1.1,
    angle: float = RAMP_ANGLE,
    thickness: float = 0.2,
) -> Shape:
    """Return a slab that rises out of the floor at `angle`, over `run` [m] towards `uphill` [rad].

    `at` is the slab's centre; its part below the floor has no contacts.
    """
    # Less what `slope` adds: the slab's centre is half a thickness below its upper face.
    back = run / 2 + thickness / 2 * math.sin(angle)
    x, y = at[0] - back * math.cos(uphill), at[1] - back * math.sin(uphill)
    head = (x + run * math.cos(uphill), y + run * math.sin(uphill), run * math.tan(angle))
    return slope((x, y, 0.0), head, width, thickness=thickness)


def ramps(
    plan: str, corner: tuple[float, float], *, side: float = CELL, angle: float = RAMP_ANGLE
) -> tuple[Shape, ...]:
    """Return ramps drawn as the arrows `>`, `^`, `<` and `v` of their climb; a blank or a dot is bare floor.

    `><` is a hill and `<>` a valley, which are continuous; arrows that cross make saw teeth. A full ramp is a
    cell long, a half ramp half a cell.

    Args:
        plan: Rows of arrows, that with the largest y first.
        corner: x and y of the plan's lower left corner [m].
        side: Length and width of each ramp [m].
        angle: Slope [rad].

    Raises:
        SpecError: The plan has other letters.
    """
    rows = plan.strip("\n").splitlines()
    slabs: list[Shape] = []
    # The last row of text is nearest to the corner, as y grows upwards on paper.
    for row, line in enumerate(reversed(rows)):
        for column, letter in enumerate(line):
            if letter in " .":
                continue
            if letter not in UPHILL:
                raise SpecError(f"a plan of ramps is made of {' '.join(UPHILL)} and blanks, not {letter!r}")
            x, y = corner[0] + (column + 0.5) * side, corner[1] + (row + 0.5) * side
            ahead = (math.cos(UPHILL[letter]) * side / 2, math.sin(UPHILL[letter]) * side / 2)
            head = (x + ahead[0], y + ahead[1], side * math.tan(angle))
            slabs.append(slope((x - ahead[0], y - ahead[1], 0.0), head, side))
    return tuple(slabs)


def stairs(
    head: tuple[float, float],
    uphill: float,
    count: int,
    *,
    rise: float = RISE,
    angle: float = STEEP,
    width: float = CELL,
) -> tuple[Shape, ...]:
    """Return a flight of `count` rises, the last of which is the edge of the floor that it leads to.

    Args:
        head: Middle of that edge [m].
        uphill: Direction of climb [rad].
        count: Number of rises.
        rise: Height of each [m].
        angle: Slope of the line through the edges of the steps [rad].
        width: Width of the flight [m].
    """
    going = rise / math.tan(angle)
    steps: list[Shape] = []
    # The last rise is the edge of the floor, which is there already.
    for i in range(1, count):
        back = (count - i - 0.5) * going
        at = (head[0] - back * math.cos(uphill), head[1] - back * math.sin(uphill))
        steps.append(block(at, (going, width, i * rise), yaw=uphill, rgba=WOOD))
    return tuple(steps)


def heights(pattern: str) -> PostHeights:
    """Return a pattern's heights, from the corner with the lowest x and y (rows along x, columns along y).

    Raises:
        SpecError: Its rows do not have the same length, or it has other letters than digits.
    """
    rows = pattern.split()
    if not rows or len({len(row) for row in rows}) != 1 or not all(row.isdigit() for row in rows):
        raise SpecError("a step field is drawn with rows of digits of the same length")
    # The last row of text has the lowest y.
    return [[int(row[column]) for row in reversed(rows)] for column in range(len(rows[0]))]


def cover_boxes(grid: PostHeights) -> list[tuple[int, int, int, int, int]]:
    """Return few boxes with the same top as one post per cell: (height, first and last row and column).

    A box may extend under higher ones, where it is hidden: a lone post on flat ground is one box more. The
    last row and column are one past the box, as in `range`.
    """
    boxes: list[tuple[int, int, int, int, int]] = []
    for height in range(1, max(map(max, grid)) + 1):
        bare = {(i, j) for i, row in enumerate(grid) for j, post in enumerate(row) if post == height}
        while bare:
            # Greedy: a partition into the fewest boxes is hard to find, and this comes near it.
            box = max(_boxes_at(grid, min(bare), height), key=lambda box: len(bare & _posts(box)))
            boxes.append((height, *box))
            bare -= _posts(box)
    return boxes


def _boxes_at(grid: PostHeights, post: tuple[int, int], height: int) -> list[tuple[int, int, int, int]]:
    """Return for every length along the rows the widest box from that post on with no lower post."""
    boxes: list[tuple[int, int, int, int]] = []
    first, column = post
    left, right = 0, len(grid[0])
    for last in range(first, len(grid)):
        row = grid[last]
        if row[column] < height:
            break
        # The box narrows from row to row to the nearest lower posts, or the edges, beside its column.
        left = max(left, *(j + 1 for j in range(-1, column) if j < 0 or row[j] < height))
        right = min(right, *(j for j in range(column, len(row) + 1) if j == len(row) or row[j] < height))
        boxes.append((first, last + 1, left, right))
    return boxes


def _posts(box: tuple[int, int, int, int]) -> set[tuple[int, int]]:
    return {(i, j) for i in range(box[0], box[1]) for j in range(box[2], box[3])}


def step_field(
    at: tuple[float, float], pattern: str = "flat", *, unit: float = POST, turns: int = 0
) -> tuple[Shape, ...]:
    """Return a pallet of posts.

    Args:
        at: Its middle [m].
        pattern: A key of `STEP_FIELDS`, or custom rows of digits.
        unit: Height of a unit [m]: a post's width in cubic fields, half of it in half cubic ones.
        turns: Quarter turns, counter-clockwise.

    Raises:
        SpecError: The pattern is invalid.
    """
    grid = heights(STEP_FIELDS.get(pattern, pattern))
    size, yaw = (len(grid) * POST, len(grid[0]) * POST), turns * math.pi / 2
    # Quarter turns by whole numbers, or posts would miss the grid by roundings.
    cos, sin = round(math.cos(yaw)), round(math.sin(yaw))
    shapes: list[Shape] = []
    for height, x0, x1, y0, y1 in cover_boxes(grid):
        x, y = (x0 + x1) / 2 * POST - size[0] / 2, (y0 + y1) / 2 * POST - size[1] / 2
        half = ((x1 - x0) * POST / 2, (y1 - y0) * POST / 2, height * unit / 2)
        middle = (at[0] + x * cos - y * sin, at[1] + x * sin + y * cos, half[2])
        shapes.append(
            Shape(kind="box", size=half, at=middle, rotation=(0.0, 0.0, yaw), surface="ground", rgba=WOOD)
        )
    return tuple(shapes)


WALL_RGBA = (0.85, 0.8, 0.6, 1.0)
CONCRETE: Rgba = (0.65, 0.65, 0.62, 1.0)
STEEL: Rgba = (0.45, 0.48, 0.52, 1.0)
BRICK: Rgba = (0.6, 0.28, 0.2, 1.0)
CARDBOARD: Rgba = (0.72, 0.55, 0.36, 1.0)
PANE: Rgba = (0.6, 0.8, 0.9, 0.35)
SILVER: Rgba = (0.8, 0.85, 0.9, 1.0)
MESHWORK: Rgba = (0.75, 0.75, 0.2, 0.6)
CINDER_SIZE: Vec3 = (0.39, 0.19, 0.19)
"""Size of a cement block [m]: 16 x 8 x 8 inches less the mortar."""
CINDER_MASS = 13.0
"""Mass of a cement block [kg]."""
PLYWOOD_DENSITY = 600.0
"""Density of plywood [kg/m3]."""
PAPER: Rgba = (0.92, 0.92, 0.88, 1.0)
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
"""Golden angle [rad], which spreads points evenly over a disc."""
TexturesByColour = Mapping[Rgba, str]
"""Names of textures (`types.shapes`) by colour."""
BARE: TexturesByColour = {WOOD: "wood", STONE: "concrete", CONCRETE: "concrete", BRICK: "brick"}
"""Textures of plywood, stone, concrete and bricks."""
PANELLED: TexturesByColour = {**BARE, WALL_RGBA: "wood"}
"""Finish with walls of boards, as in test halls."""
BRICKED: TexturesByColour = {**BARE, WALL_RGBA: "brick"}
"""Finish with walls of bricks."""
CAST: TexturesByColour = {**BARE, WALL_RGBA: "concrete"}
"""Finish with walls of concrete."""
PIPE_DIAMETER = 0.06
"""Outer diameter of a 2 inch pipe [m]."""
PIPE_MASS = 5.4
"""Mass of a 2 inch steel pipe per length [kg/m]."""
STEP_PIPE_DIAMETER = 0.11
"""Outer diameter of a 4 inch pipe [m]."""
OCTAGON_APOTHEM = math.cos(math.pi / 8)
"""Height of the axis of an octagonal pipe that lies on a side, over its radius."""


def _runs(cells: list[bool]) -> list[tuple[int, int]]:
    """Return (start, stop) of each run of true cells, so that a straight wall is one box."""
    runs: list[tuple[int, int]] = []
    start = None
    # The False at the end closes a run that reaches the last cell.
    for i, filled in enumerate([*cells, False]):
        if filled and start is None:
            start = i
        elif not filled and start is not None:
            runs.append((start, i))
            start = None
    return runs


def walls(
    plan: str, *, origin: tuple[float, float], cell: float = 1.2, height: float = 1.2, thickness: float = 0.05
) -> tuple[Shape, ...]:
    """Return the walls of a plan drawn with `+`, `--` and `|` as boxes on the floor.

    The first row of text is the far left (largest y), x grows along a row.

    Args:
        plan: Rows of `+--+  +` (walls along x) alternating with rows of `|  |   ` (walls along y).
        origin: x and y of the plan's lower left corner [m].
        cell: Side of a grid cell [m].
        height: Wall height [m].
        thickness: Wall thickness [m].

    Raises:
        SpecError: The rows do not have the same length.
    """
    rows = plan.strip("\n").splitlines()  # a row of blanks is a row of open cells
    if len({len(row) for row in rows}) != 1 or len(rows) % 2 == 0:
        raise SpecError("a floor plan needs an odd number of rows of the same length")
    # A cell is `+--`, three letters, and of two rows.
    columns, lines = (len(rows[0]) - 1) // 3, (len(rows) - 1) // 2
    boxes: list[Shape] = []

    def add(x0: float, y0: float, x1: float, y1: float) -> None:
        # Longer by a thickness, so that walls close at corners.
        half = ((x1 - x0 + thickness) / 2, (y1 - y0 + thickness) / 2, height / 2)
        centre = (origin[0] + (x0 + x1) / 2, origin[1] + (y0 + y1) / 2, height / 2)
        boxes.append(Shape(kind="box", size=half, at=centre, surface="wall", rgba=WALL_RGBA))

    for line in range(lines + 1):
        # Rows of text go down, y goes up.
        y = (lines - line) * cell
        along = [rows[2 * line][3 * column + 1] == "-" for column in range(columns)]
        for start, stop in _runs(along):
            add(start * cell, y, stop * cell, y)
    for column in range(columns + 1):
        across = [rows[2 * line + 1][3 * column] == "|" for line in range(lines)]
        for start, stop in _runs(across):
            add(column * cell, (lines - stop) * cell, column * cell, (lines - start) * cell)
    return tuple(boxes)


def span(
    low: Vec3, high: Vec3, rgba: Rgba = CONCRETE, *, surface: str = "wall", material: str = OPAQUE
) -> Shape:
    """Return the box between its lowest and its highest corner [m]."""
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    half_x, half_y, half_z = ((b - a) / 2 for a, b in zip(low, high, strict=True))
    return Shape(
        kind="box",
        size=(half_x, half_y, half_z),
        at=(x, y, z),
        surface=surface,
        material=material,
        rgba=rgba,
    )


def waving(arm: str = "RightArm", rate: float = 2.0) -> tuple[SegmentMotion, ...]:
    """Return the motion of a victim that waves with a raised arm, at a rate [rad/s]."""
    # Outwards is a roll of opposite signs on the two sides of a body.
    out = 0.5 if arm == "LeftArm" else -0.5
    move = SegmentMotion(
        name=arm, initial=(-2.7, 0.0, out), final=(-2.7, 0.0, -0.8 * out), rates=(0.0, 0.0, rate)
    )
    return (move,)


def table(at: tuple[float, float], size: Vec3, rgba: Rgba = WOOD) -> tuple[Shape, ...]:
    """Return a table of full lengths `size`: a top of 5 cm on two ends of 5 cm, open along x."""
    x, y = at
    length, width, height = size
    ends = (
        block((x + side * (length - 0.05) / 2, y), (0.05, width, height - 0.05), surface="wall", rgba=rgba)
        for side in (-1, 1)
    )
    return (block(at, (length, width, 0.05), z=height - 0.05, surface="wall", rgba=rgba), *ends)


def loose_box(
    name: str,
    at: tuple[float, float],
    size: Vec3,
    mass: float,
    *,
    z: float = 0.0,
    yaw: float = 0.0,
    rgba: Rgba = CARDBOARD,
) -> LooseObject:
    """Return a loose box of full lengths `size` [m] whose underside is at height `z`."""
    half_x, half_y, half_z = (length / 2 for length in size)
    shape = Shape(kind="box", size=(half_x, half_y, half_z), mass=mass, surface="loose", rgba=rgba)
    return LooseObject(name=name, at=(*at, z + half_z), rotation=(0.0, 0.0, yaw), shapes=(shape,))


def brick(name: str, at: tuple[float, float], *, z: float = 0.0, yaw: float = 0.0) -> LooseObject:
    """Return a loose clay brick of 215 x 102 x 65 mm (a common format) and 2.5 kg."""
    return loose_box(name, at, (0.215, 0.102, 0.065), 2.5, z=z, yaw=yaw, rgba=BRICK)


def drum(
    name: str, at: tuple[float, float], mass: float, radius: float = 0.2, height: float = 0.6
) -> LooseObject:
    """Return a loose upright drum as two boxes across each other, with eight corners.

    Engine `jax` has no contacts between cylinders.
    """
    # Corners of both boxes lie on the drum's circle.
    half = radius / math.sqrt(2)
    shapes = tuple(
        Shape(
            kind="box",
            size=(half, half, height / 2),
            rotation=(0.0, 0.0, yaw),
            mass=mass / 2,
            surface="loose",
            rgba=STEEL,
        )
        for yaw in (0.0, math.pi / 4)
    )
    return LooseObject(name=name, at=(*at, height / 2), shapes=shapes)


def cinder_block(at: Position2D, *, z: float = 0.0, yaw: float = 0.0) -> Shape:
    """Return a fixed cement block."""
    return block(at, CINDER_SIZE, z=z, yaw=yaw, rgba=STONE)


def loose_cinder_block(name: str, at: Position2D, *, z: float = 0.0, yaw: float = 0.0) -> LooseObject:
    """Return a loose cement block."""
    return loose_box(name, at, CINDER_SIZE, CINDER_MASS, z=z, yaw=yaw, rgba=STONE)


def loose_board(name: str, at: Position2D, size: Vec3, *, z: float = 0.0, yaw: float = 0.0) -> LooseObject:
    """Return a loose board of plywood of full lengths `size` [m]."""
    return loose_box(name, at, size, PLYWOOD_DENSITY * math.prod(size), z=z, yaw=yaw, rgba=WOOD)


def plank(at: Position2D, length: float, *, z: float = 0.0, yaw: float = 0.0) -> Shape:
    """Return a fixed plank of 38 x 89 mm, a 2 by 4."""
    return block(at, (length, 0.089, 0.038), z=z, yaw=yaw, rgba=WOOD)


def paper(at: Position2D, *, yaw: float = 0.0) -> Shape:
    """Return a stack of paper, 60 x 42 cm and 5 mm thick (chosen)."""
    return block(at, (0.6, 0.42, 0.005), yaw=yaw, rgba=PAPER)


def pallet(at: Position2D, *, z: float = 0.0, yaw: float = 0.0) -> tuple[Shape, ...]:
    """Return a pallet of 1200 x 800 x 144 mm (EN 13698-1) with a closed deck on three runners."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    # The outer runners end with the deck: 0.35 m and half a runner are half of 0.8 m.
    runners = (
        block(
            (at[0] - side * 0.35 * sin, at[1] + side * 0.35 * cos), (1.2, 0.1, 0.1), z=z, yaw=yaw, rgba=WOOD
        )
        for side in (-1, 0, 1)
    )
    return (block(at, (1.2, 0.8, 0.044), z=z + 0.1, yaw=yaw, rgba=WOOD), *runners)


def slab(at: Vec3, size: Vec3, rotation: Vec3 = (0.0, 0.0, 0.0)) -> Shape:
    """Return a plate of concrete of full lengths `size` [m], tilted by roll, pitch and yaw [rad]."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Shape(kind="box", size=half, at=at, rotation=rotation, surface="ground", rgba=CONCRETE)


def rubble(at: Position2D, radius: float, height: float, count: int, *, seed: int) -> tuple[Shape, ...]:
    """Return a pile of tilted chunks, cone-shaped and without voids; the same for the same seed.

    Args:
        at: Its middle [m].
        radius: Radius of the ring of the outermost chunks' middles [m].
        height: Approximate height [m].
        count: Number of chunks.
        seed: Seed of their sizes and tilts.
    """
    draw = random.Random(seed)
    chunks: list[Shape] = []
    for i in range(count):
        # By the square root, which spreads chunks evenly over the area.
        out = math.sqrt(i / count)
        x, y = (radius * out * turn(i * GOLDEN_ANGLE) for turn in (math.cos, math.sin))
        # Chunks reach into the ground: tilted, they leave no gap below.
        top, below = height * (1 - 0.85 * out), 0.15
        half = (draw.uniform(0.15, 0.3), draw.uniform(0.1, 0.2), (top + below) / 2)
        tilt = (draw.uniform(-0.3, 0.3), draw.uniform(-0.3, 0.3), draw.uniform(-math.pi, math.pi))
        middle = (at[0] + x, at[1] + y, (top - below) / 2)
        grey = draw.uniform(0.45, 0.7)
        chunks.append(
            Shape(
                kind="box",
                size=half,
                at=middle,
                rotation=tilt,
                surface="ground",
                rgba=(grey, grey, 0.95 * grey, 1.0),
                texture="concrete",
            )
        )
    return tuple(chunks)


def finished(shapes: Iterable[Shape], finish: TexturesByColour) -> tuple[Shape, ...]:
    """Return solids with the textures of their colours."""
    # A texture of its own counts: a sign keeps its picture whatever its colour.
    return tuple(
        shape if shape.texture else replace(shape, texture=finish.get(shape.rgba, "")) for shape in shapes
    )


def _bars(
    at: Vec3, length: float, diameter: float, yaw: float = 0.0, mass: float = 0.0, surface: str = "ground"
) -> tuple[Shape, ...]:
    """Return a pipe as two boxes across each other, with eight sides.

    Engine `jax` has no contacts of cylinders with boxes.
    """
    # Corners of both boxes lie on the pipe's circle.
    half = diameter / math.sqrt(8)
    return tuple(
        Shape(
            kind="box",
            size=(length / 2, half, half),
            at=at,
            rotation=(roll, 0.0, yaw),
            mass=mass / 2,
            surface=surface,
            rgba=STEEL,
        )
        # At these angles the octagon lies on a side, not on a corner.
        for roll in (math.pi / 8, 3 * math.pi / 8)
    )


def pipe(
    at: tuple[float, float],
    length: float,
    *,
    diameter: float = PIPE_DIAMETER,
    z: float = 0.0,
    yaw: float = 0.0,
) -> tuple[Shape, ...]:
    """Return a fixed pipe along `yaw` whose underside is at height `z` [m]; `at` is its middle."""
    return _bars((*at, z + diameter / 2 * OCTAGON_APOTHEM), length, diameter, yaw)


def loose_pipe(
    name: str, at: tuple[float, float], length: float, *, z: float = 0.0, yaw: float = 0.0
) -> LooseObject:
    """Return a loose pipe of steel along `yaw` whose underside is at height `z` [m]."""
    shapes = _bars(ZERO, length, PIPE_DIAMETER, mass=PIPE_MASS * length, surface="loose")
    return LooseObject(
        name=name, at=(*at, z + PIPE_DIAMETER / 2 * OCTAGON_APOTHEM), rotation=(0.0, 0.0, yaw), shapes=shapes
    )


def pipe_steps(
    foot: tuple[float, float], uphill: float, count: int, *, rise: float = 0.2, width: float = CELL
) -> tuple[Shape, ...]:
    """Return steps half a cell deep with edges of pipes, as those of ASTM E2802's hurdles (sizes chosen).

    The upper side of each pipe is level with its step.

    Args:
        foot: Middle of the first step's face [m].
        uphill: Direction of climb [rad].
        count: Number of steps.
        rise: Height of each [m].
        width: Width of the steps [m].
    """
    along = (math.cos(uphill), math.sin(uphill))
    shapes: list[Shape] = []
    for i in range(count):
        top, near, far = (i + 1) * rise, i * CELL / 2, count * CELL / 2
        middle = (near + far) / 2
        at = (foot[0] + middle * along[0], foot[1] + middle * along[1])
        edge = (foot[0] + near * along[0], foot[1] + near * along[1])
        # An octagon on its side is not as high as its circle.
        low = top - STEP_PIPE_DIAMETER * OCTAGON_APOTHEM
        shapes.append(block(at, (far - near, width, top), yaw=uphill, rgba=WOOD))
        shapes.extend(pipe(edge, width, diameter=STEP_PIPE_DIAMETER, z=low, yaw=uphill + math.pi / 2))
    return tuple(shapes)
