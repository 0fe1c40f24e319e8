"""Generation of arenas on the NIST arenas' grid, reproducible from kind, size, difficulty and seed."""

from dataclasses import replace

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import Vec3
from usarmjx.models.compile.reachability import (
    DEFAULT_SLOPE,
    RobotFootprint,
    footprint_of,
    reach_map,
    victims_reached,
)
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.generate import contents
from usarmjx.models.generate.contents import ArenaBuilder, add_victim, place_obstacles, ring_height
from usarmjx.models.generate.kinds import DEFAULT_STARTS, KINDS, Difficulty, budget
from usarmjx.models.generate.obstacles import (
    MAX_RIDGE_SLOPE,
    MIN_TWO_RAMP_COLUMNS,
    OBSTACLES,
    STOREY,
    STOREY_CELLS,
    second_floor,
)
from usarmjx.models.generate.plan import (
    CELL,
    THICKNESS,
    Cell,
    CellGrid,
    doubled,
    edge,
)
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import Shape

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
    contents.place_victims(builder, count, reachable)
    contents.place_structures(builder, kind.structures(plan.size))
    place_obstacles(builder)
    boards = contents.place_boards(builder)
    free = [cell for cell in plan.tree if cell not in boards and cell not in builder.obstructed]
    if _passes(builder.footprint, REACH_CELL_SIZES[0], contents.STRIP):
        draw = builder.random_stream("corner")
        builder.corner = (draw.choice((-1, 1)), draw.choice((-1, 1)))
        contents.place_clutter(builder, free)
    contents.place_tags(builder, free)
    contents.place_starts(builder, free)


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
