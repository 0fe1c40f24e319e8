"""Findings of an arena check, in sentences: plan, names, start poses, reachability and overlaps."""

from collections import Counter
from collections.abc import Iterator

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import is_name
from usarmjx.models.check.bodies import BodyProbe, check_close_starts
from usarmjx.models.check.probe import ArenaProbe, format_position, in_water, solid_name
from usarmjx.models.compile.compose import ARENA_PREFIX
from usarmjx.models.compile.reachability import footprint_of, reach_map, victims_reached
from usarmjx.models.compile.tags import MAX_RELEASED_ID
from usarmjx.models.files.content import corners_of
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import AUTOMATIC_TAG_ID, ArenaSpec, StartPose
from usarmjx.models.types.robot import RobotSpec

MAX_OVERHANG = 0.5
"""Largest overhang of a solid over the extent, as of an outer wall [m]."""
VICTIM_REACH = 1.0
"""Distance at which a victim counts as reached [m]."""
START_REACH = 0.3
"""Distance at which another start pose counts as reached [m]."""


def check_arena(arena: ArenaSpec, robot: str = "P2AT") -> list[str]:
    """Return the faults of an arena, a sentence each; empty: none was found.

    Checks: the plan (extent, names and IDs, items outside), each start pose for a robot of that class (ground
    under it, at the height of manual 5.3.5; no solid in the robot; room between two of them), reachability
    from the first start pose on ground (the others, the victims), loose objects and victims that lie in a
    solid or float in the air, doors that cannot turn, and water.

    Raises:
        UnknownNameError: No such robot class.
    """
    spec = find_robot(robot)
    found = [*_plan(arena), *_names(arena), *_tags(arena)]
    try:
        probe = ArenaProbe(arena, spec)
    except (SpecError, ValueError) as error:
        return [*found, f"it cannot be built: {error}"]
    found += [*probe.check_starts(), *probe.check_loose(), *probe.check_waters()]
    bodies = BodyProbe(arena)
    found += [*check_close_starts(arena, spec), *bodies.check_victims(), *bodies.check_doors()]
    dry = [start for start in arena.starts if not in_water(arena, start)]
    if not dry or any(fault.startswith(f"start {dry[0].tag!r}") for fault in found):
        return found  # reachability starts from that pose
    return [*found, *_reach(arena, spec, dry)]


def _plan(arena: ArenaSpec) -> Iterator[str]:
    """Yield faults of the extent, and items outside it."""
    (x0, x1), (y0, y1) = arena.extent
    for i, shape in enumerate(arena.shapes):
        low, high = corners_of(shape)
        over = max(x0 - low[0], high[0] - x1, y0 - low[1], high[1] - y1)
        if over > MAX_OVERHANG:
            yield f"{solid_name(arena, f'{ARENA_PREFIX}{i}')} reaches {over:.2f} m over the extent; widen it"
    items = [(f"start {s.tag!r}", s.at) for s in arena.starts]
    items += [(f"victim {v.name!r}", v.at) for v in arena.victims]
    items += [(f"false alarm {i} ({a.part})", a.at) for i, a in enumerate(arena.false_alarms)]
    items += [(f"tag {i} (ID {tag.id})", tag.at) for i, tag in enumerate(arena.tags)]
    for name, (x, y, _) in items:
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            yield f"{name} at {format_position(x, y)} is outside the extent"


def _names(arena: ArenaSpec) -> Iterator[str]:
    """Yield faults of names."""
    if not arena.starts:
        yield "it has no start pose"
    for tag, count in Counter(start.tag for start in arena.starts).items():
        if count > 1:
            yield f"{count} start poses are called {tag!r}"
        if not is_name(tag):
            yield f"start {tag!r}: a tag is one word of ASCII without braces: blanks separate them"
    for robot in arena.robots:
        if robot not in ROBOTS:
            yield f"recommended robot {robot!r} is unknown; `usarmjx list robots` shows them all"


def _tags(arena: ArenaSpec) -> Iterator[str]:
    """Yield faults of the IDs of tags."""
    given = Counter(tag.id for tag in arena.tags if tag.id != AUTOMATIC_TAG_ID)
    for number, count in given.items():
        if count > 1:
            yield f"{count} tags have the ID {number}"
        if number <= MAX_RELEASED_ID:
            yield f"a tag has the ID {number}; up to {MAX_RELEASED_ID} they belong to releasers"


def _reach(arena: ArenaSpec, robot: RobotSpec, dry: list[StartPose]) -> Iterator[str]:
    """Yield the starts and victims that a robot cannot reach from the first start pose on dry ground."""
    size = footprint_of(robot)
    found = reach_map(arena, size.radius, size.step, height=size.height, start=dry[0])
    if found.start_area < 0:
        yield f"start {dry[0].tag!r}: a {robot.name} has no room to turn there"
        return
    near = [found.reaches_within(*start.at, distance=START_REACH) for start in dry[1:]]
    far = [
        (f"start {s.tag!r}", s.at, START_REACH)
        for s, reached in zip(dry[1:], near, strict=True)
        if not reached
    ]
    touched = victims_reached(arena, found, VICTIM_REACH)
    far += [
        (f"victim {v.name!r}", v.at, VICTIM_REACH)
        for v, ok in zip(arena.victims, touched, strict=True)
        if not ok
    ]
    for name, (x, y, _), least in far:
        where = f"{name} at {format_position(x, y)}"
        yield f"{where}: a {robot.name} from {dry[0].tag!r} gets no nearer than {least} m"
