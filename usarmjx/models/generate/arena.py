"""Generation of arenas on the NIST arenas' grid, reproducible from kind, size, difficulty and seed.

Clutter lies in a strip along one side of the cells, the same side in all of them, so that robots can pass on
the other side.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.random import RandomStream
from usarmjx.base.transforms import Vec3, mat_from_angles
from usarmjx.models.compile.raster import half_lengths
from usarmjx.models.compile.reachability import (
    DEFAULT_SLOPE,
    RobotFootprint,
    footprint_of,
    reach_map,
    shapes_in_arena,
    victims_reached,
)
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.generate.kinds import DEFAULT_STARTS, KINDS, ArenaKind, Difficulty, budget, counts
from usarmjx.models.generate.obstacles import (
    MAX_RIDGE_SLOPE,
    MIN_TWO_RAMP_COLUMNS,
    OBSTACLES,
    RIDGE_SLOPE_RATE,
    STONE,
    STOREY,
    STOREY_CELLS,
    STRUCTURE_SIZE,
    WOOD,
    block,
    highest_obstacle,
    lerp,
    obstacle_height,
    second_floor,
    void,
)
from usarmjx.models.generate.plan import (
    CELL,
    DIRECTIONS,
    START_CELL,
    THICKNESS,
    Cell,
    CellGrid,
    doubled,
    edge,
    middle,
)
from usarmjx.models.types.arena import (
    START_ELEVATION,
    ArenaSpec,
    HelpSound,
    LooseObject,
    SegmentMotion,
    StartPose,
    Tag,
    Victim,
    start_tag,
)
from usarmjx.models.types.shapes import Position2D, Rgba, Shape

HALF_CORRIDOR = (CELL - THICKNESS) / 2
"""Distance from the middle of a cell to its walls [m]."""
STRIP = 0.205
"""Width of the strip of clutter [m]."""
START_OFFSET = 0.1
"""Distance of start poses from the middle of a cell, away from the strips [m]."""
GAP = 0.005
"""Gap between a wall and clutter beside it [m]; loose objects start a fifth of it above the floor."""
MIN_TREE_CELLS = 4
"""Number of cells that always remain passable."""
MIN_CELLS_WITHOUT_BOARDS = 17
"""Number of cells without boards if there are as many, so that 16 robots can start."""
ROOF, LOW_ROOF = 1.0, 0.5
"""Height of the slabs over sitting and over lying victims [m]."""

MAX_SAFE_RIDGE = math.radians(25)
"""Steepest ridge of arenas without risk [rad]: steeper ones are hard on slick ground."""


def _loose_form(half: tuple[float, float, float], mass: float, rgba: Rgba) -> tuple[Shape, ...]:
    return (Shape(kind="box", size=half, mass=mass, surface="loose", rgba=rgba),)


FORMS = {
    "Brick": _loose_form((0.1, 0.05, 0.03), 2.5, (0.6, 0.3, 0.2, 1.0)),
    "CinderBlock": _loose_form((0.195, 0.095, 0.095), 13.0, STONE),
    "Plank": _loose_form((0.5, 0.045, 0.02), 1.8, WOOD),
}
"""Shapes of loose objects; their masses are those of clay, hollow concrete and spruce of that size."""


@dataclass
class ArenaBuilder:
    """An arena under construction.

    Attributes:
        plan: Walls and ways.
        kind: Kind of arena.
        difficulty: Difficulty of the arena.
        footprint: Room that the robot needs to pass.
        seed: Seed of the draws.
        robot: Its class; "" if only its footprint is known.
        most_starts: Largest number of start poses; a free cell has one.
        shapes: Solids other than walls.
        corner: Sides of cells with strips of clutter, along x and y; 0: none.
        clear: Cells without contents: access to victims or to a second floor.
        obstructed: Cells with obstacles that must be crossed.
    """

    plan: CellGrid
    kind: ArenaKind
    difficulty: Difficulty
    footprint: RobotFootprint
    seed: int
    robot: str = ""
    most_starts: int = DEFAULT_STARTS
    shapes: list[Shape] = field(default_factory=list[Shape])
    corner: Cell = (0, 0)
    clear: set[Cell] = field(default_factory=set[Cell])
    obstructed: set[Cell] = field(default_factory=set[Cell])
    victims: list[Victim] = field(default_factory=list[Victim])
    loose: list[LooseObject] = field(default_factory=list[LooseObject])
    tags: list[Tag] = field(default_factory=list[Tag])
    starts: list[StartPose] = field(default_factory=list[StartPose])

    def random_stream(self, purpose: str) -> RandomStream:
        """Return the random stream of a purpose."""
        return RandomStream(self.seed, purpose)

    def max_count(self, what: str) -> int:
        """Return the limit of a content for this size."""
        return counts(self.plan.size)[what]


@cache
def outline(posture: str) -> tuple[float, float]:
    """Return the extent of a victim along the x axis of its pelvis [m]: lowest and highest."""
    ends: list[float] = []
    for part in shapes_in_arena(Victim(name="one", at=(0.0, 0.0, 0.0), posture=posture)):
        mat = mat_from_angles(*np.array(part.rotation))
        reach = float(np.abs(mat[0]) @ half_lengths(part))
        ends += [part.at[0] - reach, part.at[0] + reach]
    return min(ends), max(ends)


def add_victim(
    builder: ArenaBuilder, at: Position2D, facing: int, posture: str, where: str, ground: float = 0.0
) -> None:
    """Add a victim with the middle of its body at a point; `facing` in quarter turns from x."""
    number = len(builder.victims) + 1
    ahead, (back, front) = DIRECTIONS[facing], outline(posture)
    shift = -(back + front) / 2
    waves = posture == "sitting" and number % 2 == 0
    segments = (
        SegmentMotion(
            name="LeftArm", initial=(-0.8, 0.0, 0.1), final=(-2.6, 0.0, 0.1), rates=(1.5, 0.0, 0.0)
        ),
    )
    builder.victims.append(
        Victim(
            name=f"Victim{number}",
            at=(at[0] + shift * ahead[0], at[1] + shift * ahead[1], ground + rest_height(posture)),
            rotation=(0.0, 0.0, facing * math.pi / 2),
            posture=posture,
            segments=segments if waves else (),
            help_sound=HelpSound() if number % 3 == 1 else None,
            state=f"{'waving' if waves else 'still'}, {where}",
        )
    )


def place_victims(builder: ArenaBuilder, count: int, reachable: float) -> None:
    """Put victims into leaves of the tree, which they block; unreachable ones into cells of four walls."""
    plan, draw, walled_in = builder.plan, builder.random_stream("victims"), 0
    while len(builder.victims) < count and len(plan.tree) > MIN_TREE_CELLS:
        tips = plan.leaves()
        if not tips:
            break
        # Always three draws, used or not: later victims do not depend on what became of this one.
        cell, lies, facing = draw.choice(tips), draw.randint(2), draw.randint(4)
        before = plan.remove_leaf(cell)
        number = len(builder.victims) + 1
        # In step with the wanted share, so that any number of victims comes as near to it as it can.
        if walled_in < number - round(reachable * number):
            walled_in += 1
            plan.seal(cell)
            add_victim(builder, middle(cell), facing, "sitting", "walled in")
            continue
        toward = DIRECTIONS.index((before[0] - cell[0], before[1] - cell[1]))
        # A slab only where the robot passes under it: else it would not come near the victim.
        highest = builder.footprint.height + builder.footprint.step if builder.kind.voids else math.inf
        if lies and before in plan.leaves() and len(plan.tree) > MIN_TREE_CELLS:
            last = plan.remove_leaf(before)
            (x0, y0), (x1, y1) = middle(cell), middle(before)
            at, posture, length, roof = (
                ((x0 + x1) / 2, (y0 + y1) / 2),
                "lying",
                STRUCTURE_SIZE + CELL,
                LOW_ROOF,
            )
        else:
            last = before
            at, posture, length, roof = middle(cell), "sitting", STRUCTURE_SIZE, ROOF
        low = highest < roof
        # The access to a victim must not be cut off by the next one.
        plan.kept.add(last)
        builder.clear.add(last)
        if low:
            builder.shapes += void(at, toward, length, roof)
        if low or posture == "lying":
            # Bodies fit under the slab lengthwise: towards the way in, those that lie also away from it.
            facing = (toward + 2 * (facing % 2) * (posture == "lying")) % 4
        add_victim(builder, at, facing, posture, "in a void" if low else "in the open")


def place_structures(builder: ArenaBuilder, count: int) -> None:
    """Put impassable structures into leaves of the tree."""
    maker, draw = builder.kind.structure, builder.random_stream("structures")
    for _ in range(count if maker else 0):
        tips = builder.plan.leaves()
        if not tips or len(builder.plan.tree) <= MIN_TREE_CELLS:
            return
        cell = draw.choice(tips)
        builder.plan.remove_leaf(cell)
        builder.shapes += maker(draw, middle(cell), builder.difficulty.roughness) if maker else []


def place_boards(builder: ArenaBuilder) -> set[Cell]:
    """Put boards across the ways, low enough for the robot; return their cells."""
    draw = builder.random_stream("boards")
    barred = {START_CELL, *builder.clear, *builder.obstructed}
    cells = [cell for cell in builder.plan.tree if cell not in barred]
    spare = len(builder.plan.tree) - len(builder.obstructed) - MIN_CELLS_WITHOUT_BOARDS
    count = max(0, min(builder.max_count("boards"), spare))
    height = lerp(0.25, 0.95, builder.difficulty.roughness) * builder.footprint.step
    # The first of a shuffled list: more boards keep the places of fewer.
    taken = draw.shuffled(cells)[:count]
    for cell in taken:
        size = (0.09, 1.0, height) if draw.randint(2) else (1.0, 0.09, height)
        builder.shapes.append(block(middle(cell), size))
    return set(taken)


def place_clutter(builder: ArenaBuilder, free: list[Cell]) -> None:
    """Put loose objects and fixed blocks into the strips; more clutter keeps that of less.

    The shapes of loose objects alternate, so that the arenas of a batch need few slots of each.
    """
    draw, clutter, corner = builder.random_stream("clutter"), builder.difficulty.clutter, builder.corner
    cells = draw.shuffled([cell for cell in free if cell not in builder.clear])
    height = lerp(0.1, 0.3, builder.difficulty.roughness)
    # Drawn for all cells before any is used, so that more clutter keeps the spots of less.
    spots = [_spot(builder, cell, draw) for cell in cells]
    for i in range(min(round(clutter * builder.max_count("loose")), len(cells))):
        form = tuple(FORMS)[i % len(FORMS)]
        # A brick alone is short enough for a corner without a strip.
        spot = next((spot for spot in spots if spot.strip or form == "Brick"), None)
        if spot is None:
            continue
        spots.remove(spot)
        half = FORMS[form][0].size
        x, y = _beside(spot.cell, corner, half, spot.turned, spot.along)
        at, yaw = (x, y, half[2] + GAP / 5), spot.turned * math.pi / 2
        builder.loose.append(
            LooseObject(name=f"{form}{i + 1}", at=at, rotation=(0.0, 0.0, yaw), shapes=FORMS[form])
        )
    # From the end of the list, while loose objects are taken from its beginning.
    for spot in spots[max(0, len(spots) - round(clutter * builder.max_count("blocks"))) :]:
        half = (0.15, 0.095, height / 2) if spot.strip else (0.1, 0.05, height / 2)
        at = _beside(spot.cell, corner, half, spot.turned, spot.along)
        builder.shapes.append(block(at, (2 * half[0], 2 * half[1], height), yaw=spot.turned * math.pi / 2))


class _ClutterSpot(NamedTuple):
    """Position of clutter in a cell: in a strip along a side without a way across, or in a corner."""

    cell: Cell
    strip: bool
    turned: int
    along: float


def _spot(site: ArenaBuilder, cell: Cell, draw: RandomStream) -> _ClutterSpot:
    corner = site.corner
    along = draw.randint(101) / 100
    sides = [k for k, d in enumerate(((0, corner[1]), (corner[0], 0))) if _closed(site.plan, cell, d)]
    turned = draw.choice(sides) if sides else 0
    return _ClutterSpot(cell, bool(sides), turned, along if sides else 1.0)


def _closed(plan: CellGrid, cell: Cell, side: Cell) -> bool:
    return (cell[0] + side[0], cell[1] + side[1]) not in plan.tree[cell]


def _beside(cell: Cell, corner: Cell, half: tuple[float, ...], turned: int, along: float) -> Position2D:
    """Return a position in a strip: `along` is 1 in the corner, 0 at the other end."""
    x, y = middle(cell)
    far = HALF_CORRIDOR - GAP - half[0]
    offset = (corner[0] * (2 * along - 1) * far, corner[1] * (HALF_CORRIDOR - GAP - half[1]))
    if turned:
        offset = (corner[0] * (HALF_CORRIDOR - GAP - half[1]), corner[1] * (2 * along - 1) * far)
    site_x, site_y = offset
    return x + site_x, y + site_y


def place_tags(builder: ArenaBuilder, free: list[Cell]) -> None:
    """Put tags on the floor beside the start poses, short of the strips."""
    draw = builder.random_stream("tags")
    # Strips of clutter leave less room beside the middle of a cell [m].
    side = 0.3 if any(builder.corner) else 0.42
    for cell in draw.shuffled(free)[: builder.max_count("tags")]:
        x, y = middle(cell)
        dx, dy = (way or draw.choice((-1, 1)) for way in builder.corner)
        builder.tags.append(Tag(at=(x + side * dx, y + side * dy, 0.0)))


def place_starts(builder: ArenaBuilder, free: list[Cell]) -> None:
    """Put the first start pose into the base, others into free cells, all facing along a way."""
    others = builder.random_stream("starts").shuffled([cell for cell in free if cell != START_CELL])
    for number, cell in enumerate([START_CELL, *others][: builder.most_starts]):
        x, y = middle(cell)
        x, y = x - START_OFFSET * builder.corner[0], y - START_OFFSET * builder.corner[1]
        toward = builder.plan.tree[cell][0] if builder.plan.tree[cell] else (cell[0] + 1, cell[1])
        # Quarter turns from -1 to 2, so that the yaw lies within half a turn to each side.
        yaw = (DIRECTIONS.index((toward[0] - cell[0], toward[1] - cell[1])) + 1) % 4 - 1
        builder.starts.append(
            StartPose(tag=start_tag(number), at=(x, y, START_ELEVATION), yaw=yaw * math.pi / 2)
        )


def place_obstacles(builder: ArenaBuilder) -> None:
    """Put obstacles into rings of cells; more obstacles keep those of fewer."""
    share, obstacle = builder.difficulty.obstacles, builder.kind.obstacle
    if not share:
        return
    # A stream for each purpose: another number of obstacles moves no victim.
    draw, away = builder.random_stream("obstacles"), distances(builder.plan)
    rings = draw.shuffled(_rings(builder, away))
    # Half the cells stay free, for start poses and clutter.
    left = min(builder.max_count("obstacles"), len(builder.plan.tree) // 2)
    heights = {name: ring_height(builder, name) for name in OBSTACLES.names()}
    for ring in rings[: math.ceil(share * len(rings))]:
        # A smaller ring later in the list may still fit.
        if len(ring) > left:
            continue
        left -= len(ring)
        for cell in ring:
            ways = _ways(builder.plan, cell)
            # Ways of one axis: boards and ridges lie across it; at corners and crossings only posts fit.
            straight = len({way % 2 for way in ways}) == 1
            name = obstacle if straight else "posts"
            builder.shapes += OBSTACLES.get(name)(draw, middle(cell), heights[name], ways[0])
        builder.obstructed.update(ring)


def ring_height(builder: ArenaBuilder, kind: str) -> float:
    """Return the height of obstacles of a kind [m]."""
    highest = highest_obstacle(builder.robot, kind, builder.difficulty.risk)
    height = obstacle_height(builder.footprint, builder.difficulty.roughness, highest)
    return (
        height
        if builder.difficulty.risk or kind != "ridge"
        else min(height, MAX_SAFE_RIDGE / RIDGE_SLOPE_RATE)
    )


def _rings(builder: ArenaBuilder, away: dict[Cell, int]) -> list[list[Cell]]:
    """Return the rings of cells that can have obstacles, no two of them adjacent.

    A ring is all cells of the tree at one distance from the base: the way outward crosses it.
    """
    farthest = max(away.values())
    rings: list[list[Cell]] = []
    # Every other distance: between two obstacles a robot has a free cell.
    for count in range(2, farthest, 2):
        cells = [cell for cell, found in away.items() if found == count and cell in builder.plan.tree]
        beyond = any(found > count for cell, found in away.items() if cell in builder.plan.tree)
        if cells and beyond and not builder.clear & set(cells):
            rings.append(cells)
    return rings


def distances(plan: CellGrid) -> dict[Cell, int]:
    """Return the number of steps from the base to each cell, around walls."""
    found: dict[Cell, int] = {START_CELL: 0}
    front: list[Cell] = [START_CELL]
    # The list grows while it is walked: breadth first.
    for cell in front:
        for other in plan.around(cell):
            if other not in found and edge(cell, other) not in plan.walls:
                found[other] = found[cell] + 1
                front.append(other)
    return found


def _ways(plan: CellGrid, cell: Cell) -> list[int]:
    """Return the directions in which a cell is open, in quarter turns."""
    ends = [(cell[0] + dx, cell[1] + dy) for dx, dy in DIRECTIONS]
    beside = plan.around(cell)
    return [i for i, end in enumerate(ends) if end in beside and edge(cell, end) not in plan.walls]


MIN_SIDE_CELLS, MAX_SIDE_CELLS = 3, 64
"""Smallest and largest number of cells along a side."""
DECIMALS = 6
"""Decimals of all numbers of an arena; further ones differ between machines."""
REACH_CELL_SIZES = (CELL / 18, 0.02)
"""Side of the squares of the reachability check [m]: the first, or for wide robots the second."""
STEP_MARGIN = 1.01
"""Step of a robot that climbs all obstacles, over the highest obstacle."""
MAX_ATTEMPTS = 8
"""Largest number of arenas that are made until the reachable victims are as stated."""


def generate(  # noqa: PLR0913 - all but the kind may be left out
    kind: str,
    size: tuple[int, int] = (8, 6),
    seed: int = 0,
    difficulty: Difficulty | None = None,
    robot: str | RobotFootprint = "P2AT",
    reachable: float = 1.0,
    victims: int | None = None,
    starts: int = DEFAULT_STARTS,
) -> ArenaSpec:
    """Return an arena, as DM-maze-8x6-0.

    The robot can drive between all start poses, and from them to within 1 m of a body part of the stated
    share of victims. The other victims sit in cells of four walls.

    Args:
        kind: A name of `KINDS`.
        size: Columns and rows of cells of 1.2 m.
        seed: Any integer from 0.
        difficulty: Difficulty; None: `Difficulty()`.
        robot: Robot that must pass: a class, or a footprint.
        reachable: Share of the victims that it can reach.
        victims: Number of victims; None: one for 12 cells, at most 16. There are fewer if they find no room.
        starts: Number of start poses, at least 1; fewer if there are fewer free cells.

    Raises:
        UnknownNameError: No such kind or robot.
        SpecError: A size, seed, share or number out of range; a robot too wide for the corridors.
    """
    made, difficulty = KINDS.get(kind), difficulty or Difficulty()
    name = robot if isinstance(robot, str) else ""
    needs = footprint_of(find_robot(robot)) if isinstance(robot, str) else robot
    _check(size, seed, needs, reachable)
    if starts < 1:
        raise SpecError(f"{starts} start poses, expected at least 1")
    most = budget(kind, size).victims
    count = min(most, max(1, size[0] * size[1] // 12)) if victims is None else victims
    if not 0 <= count <= most:
        raise SpecError(f"{count} victims, expected 0 to {most} in {size[0]}x{size[1]} cells")
    for attempt in range(MAX_ATTEMPTS):
        # One stream of draws per attempt: the shift by 2**64 keeps the seeds of attempts apart.
        builder = ArenaBuilder(
            plan=CellGrid(size),
            kind=made,
            difficulty=difficulty,
            footprint=needs,
            seed=seed + (attempt << 64),
            robot=name,
            most_starts=starts,
        )
        _fill(builder, count, reachable)
        arena = _arena(builder, f"DM-{_spelt(kind)}-{size[0]}x{size[1]}-{seed}", name)
        # A little steeper than the steepest ridge: rounding must not close one.
        slope = 1.01 * MAX_RIDGE_SLOPE if difficulty.risk else DEFAULT_SLOPE
        if _as_stated(arena, _climbing(builder), slope):
            return arena
    raise SpecError(
        f"no {kind} of {size[0]}x{size[1]} cells in {MAX_ATTEMPTS} tries that a robot of {needs} passes"
    )


def generate_many(  # noqa: PLR0913 - as above
    kind: str,
    count: int,
    seed: int = 0,
    *,
    size: tuple[int, int] = (8, 6),
    difficulty: Difficulty | None = None,
    robot: str | RobotFootprint = "P2AT",
    reachable: float = 1.0,
    starts: int = DEFAULT_STARTS,
) -> list[ArenaSpec]:
    """Return arenas of seeds derived from one; see `generate`."""
    # Not seed + i: batches of neighbouring seeds would share all arenas but one.
    seeds = np.random.SeedSequence(seed).generate_state(count, np.uint32).tolist()
    return [generate(kind, size, each, difficulty, robot, reachable, starts=starts) for each in seeds]


def _check(size: tuple[int, int], seed: int, needs: RobotFootprint, reachable: float) -> None:
    if not all(MIN_SIDE_CELLS <= n <= MAX_SIDE_CELLS for n in size):
        raise SpecError(
            f"size {size[0]}x{size[1]}, expected {MIN_SIDE_CELLS} to {MAX_SIDE_CELLS} cells along each side"
        )
    if seed < 0:
        raise SpecError(f"seed {seed}, expected 0 or more")
    if not 0.0 <= reachable <= 1.0:
        raise SpecError(f"reachable {reachable}, expected from 0 to 1")
    if not _passes(needs, REACH_CELL_SIZES[-1]):
        widest = (CELL - THICKNESS - 3 * REACH_CELL_SIZES[-1]) / 2
        raise SpecError(
            f"the robot turns in a circle of radius {needs.radius:.2f} m; the arenas' corridors take "
            f"{widest:.2f} m (give robot=Size(...) for one that need not turn)"
        )


def _passes(needs: RobotFootprint, square: float, strip: float = 0.0) -> bool:
    """Return whether a robot passes a corridor at that resolution; see `reach_map`."""
    return 2 * needs.radius + 3 * square + strip <= CELL - THICKNESS


def _spelt(kind: str) -> str:
    return next(name for name in KINDS.names() if name.lower() == kind.lower())


def _fill(builder: ArenaBuilder, count: int, reachable: float) -> None:
    """Lay out the walls and add the contents."""
    plan, kind = builder.plan, builder.kind
    if kind.second_floor and plan.size[0] >= STOREY_CELLS + 2:
        _upstairs(builder, round(reachable * count) > 0)
    else:
        kind.layout(plan, builder.random_stream("plan"), builder.difficulty)
    place_victims(builder, count, reachable)
    place_structures(builder, kind.structures(plan.size))
    place_obstacles(builder)
    boards = place_boards(builder)
    free = [cell for cell in plan.tree if cell not in boards and cell not in builder.obstructed]
    # A wide robot needs the whole corridor, which leaves no strip for clutter.
    if _passes(builder.footprint, REACH_CELL_SIZES[0], STRIP):
        draw = builder.random_stream("corner")
        builder.corner = (draw.choice((-1, 1)), draw.choice((-1, 1)))
        place_clutter(builder, free)
    place_tags(builder, free)
    place_starts(builder, free)


def _upstairs(builder: ArenaBuilder, victim: bool) -> None:
    """Lay out an arena with a second floor along its last row."""
    columns, rows = builder.plan.size
    step = builder.random_stream("floor").choice((-1, 1))
    landing = (0 if step > 0 else columns - 1, rows - 1)
    landings = [landing]
    if columns >= MIN_TWO_RAMP_COLUMNS:
        landings.append((columns - 1 - landing[0], rows - 1))
    barred = tuple((column, rows - 1) for column in range(columns) if (column, rows - 1) not in landings)
    builder.kind.layout(builder.plan, builder.random_stream("plan"), builder.difficulty, barred=barred)
    builder.plan.kept.update(landings)
    builder.clear.update(landings)
    for k, cell in enumerate(landings):
        foot: Cell = (cell[0] + (step if k == 0 else -step), cell[1])
        builder.plan.walls.discard(edge(cell, foot))
    slabs = second_floor(landing, step, columns)
    builder.shapes += slabs
    if victim:
        deck = slabs[-1].at
        add_victim(
            builder, (deck[0], deck[1]), 0 if step < 0 else 2, "sitting", "on the second floor", STOREY
        )


def _arena(builder: ArenaBuilder, name: str, robot: str) -> ArenaSpec:
    """Return the finished arena, with all numbers rounded."""
    outer, inner = builder.plan.wall_shapes()
    # The first of a shuffled list: more radio shadow keeps the walls of less.
    inner = builder.random_stream("shadow").shuffled(inner)
    twice = round(builder.difficulty.radio_shadow * len(inner))
    sheets = [sheet for wall in inner[:twice] for sheet in doubled(wall)]
    columns, rows = builder.plan.size
    return ArenaSpec(
        name=name,
        about=builder.kind.about,
        shapes=_rounded([*outer, *sheets, *inner[twice:], *builder.shapes]),
        starts=tuple(replace(s, at=_round(s.at), yaw=round(s.yaw, DECIMALS)) for s in builder.starts),
        extent=((0.0, round(columns * CELL, DECIMALS)), (0.0, round(rows * CELL, DECIMALS))),
        loose=tuple(replace(o, at=_round(o.at), rotation=_round(o.rotation)) for o in builder.loose),
        victims=tuple(replace(v, at=_round(v.at), rotation=_round(v.rotation)) for v in builder.victims),
        tags=tuple(replace(t, at=_round(t.at)) for t in builder.tags),
        robots=(robot,) if robot else (),
    )


def _round(values: Vec3) -> Vec3:
    x, y, z = (round(float(value), DECIMALS) + 0.0 for value in values)  # no -0.0
    return (x, y, z)


def _rounded(shapes: list[Shape]) -> tuple[Shape, ...]:
    numbers = np.array([(*shape.at, *shape.size, *shape.rotation) for shape in shapes])
    rows = (np.round(numbers, DECIMALS) + 0.0).tolist()
    return tuple(
        Shape(
            kind="box",
            at=(*row[:3],),
            size=(*row[3:6],),
            rotation=(*row[6:],),
            surface=s.surface,
            rgba=s.rgba,
        )
        for s, row in zip(shapes, rows, strict=True)
    )


def _climbing(builder: ArenaBuilder) -> RobotFootprint:
    """Return the robot's footprint with a step over the highest obstacle."""
    if not builder.difficulty.risk:
        return builder.footprint
    highest = max(ring_height(builder, kind) for kind in OBSTACLES.names())
    return replace(builder.footprint, step=max(builder.footprint.step, STEP_MARGIN * highest))


def _as_stated(arena: ArenaSpec, needs: RobotFootprint, slope: float) -> bool:
    """Return whether the robot reaches all starts and exactly the stated victims."""
    square = REACH_CELL_SIZES[0] if _passes(needs, REACH_CELL_SIZES[0]) else REACH_CELL_SIZES[1]
    there = reach_map(arena, needs.radius, needs.step, height=needs.height, slope=slope, cell=square)
    meant = ["walled in" not in victim.state for victim in arena.victims]
    if victims_reached(arena, there) != meant:
        return False
    return all(there.reachable(start.at[0], start.at[1]) for start in arena.starts)
