"""Generated arenas: what they promise of reach, overlap, budgets and difficulty; the same everywhere."""

import hashlib
import itertools
import math
from dataclasses import fields, replace

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.rig import Rig
from usarmjx.base.errors import SpecError, UnknownNameError
from usarmjx.base.random import RandomStream
from usarmjx.comms.walls import arena_solids, count_walls
from usarmjx.models.compile.arena_set import arena_set
from usarmjx.models.compile.compose import ARENA_PREFIX, LOOSE_PREFIX, VICTIM_PREFIX, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.reachability import footprint_of, reach_map, shapes_in_arena, victims_reached
from usarmjx.models.generate import KINDS, Difficulty, budget, generate, generate_many
from usarmjx.models.generate.arena import FORMS
from usarmjx.models.generate.obstacles import STOREY
from usarmjx.models.generate.plan import CELL, WALL_HEIGHT
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT

NAMES = KINDS.names()
LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
SEEDS = range(4)
FEW = settings(max_examples=12, deadline=None)
SMALL = st.tuples(st.integers(3, 8), st.integers(3, 6))
UNIT = st.integers(0, 10).map(lambda tenths: tenths / 10)
DIFFICULTIES = st.builds(Difficulty, **{one.name: UNIT for one in fields(Difficulty) if one.name != "risk"})
"""With a risk some places are not reached: see test_obstacles.py."""
NEED = footprint_of(P2AT)
EXACT = 1e-6  # m: all numbers are rounded to that


def digest(arena):
    """A hash of all places, sizes and angles in an arena."""
    rows = [(*s.at, *s.size, *s.rotation) for s in arena.shapes]
    rows += [(*s.at, s.yaw) for s in arena.starts]
    rows += [(*thing.at, *thing.rotation) for thing in (*arena.loose, *arena.victims)]
    rows += [tag.at for tag in arena.tags]
    text = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in rows)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


GOLDEN = {
    "building": "a63a0dc3547a2f25",
    "collapsed": "af00007d2b13ebc2",
    "maze": "6362bd2446c96aad",
    "ramps": "5773f95add694852",
    "rubble": "8c052d53e66084c7",
    "steps": "cc02687e17a114d2",
}


@pytest.mark.parametrize("kind", NAMES)
def test_the_same_seed_is_the_same_arena_on_every_machine(kind):
    assert digest(generate(kind, (8, 6), seed=7, reachable=0.75)) == GOLDEN[kind]


def test_draws_are_those_of_the_bit_generator():
    bits = np.random.PCG64(np.random.SeedSequence([5, 0xD87F7E0C]))  # CRC-32 of "test"
    expected = bits.random_raw(512).tolist()[::-1]
    draw = RandomStream(5, "test")
    assert [draw.randint(10**6) for _ in range(8)] == [value % 10**6 for value in expected[:8]]
    assert sorted(RandomStream(5, "test").shuffled(range(9))) == list(range(9))


def test_names_say_kind_size_and_seed_and_kinds_match_without_case():
    assert generate("MAZE", (5, 4), seed=12).name == "DM-maze-5x4-12"
    assert generate("maze", (5, 4), seed=12) == generate("Maze", (5, 4), seed=12)
    assert generate("maze", (5, 4), seed=13) != generate("maze", (5, 4), seed=12)


@pytest.mark.parametrize("kind", NAMES)
def test_arenas_fit_into_one_batch(kind):
    arenas = generate_many(kind, 5, seed=3, size=(6, 5))
    assert arenas == generate_many(kind, 5, seed=3, size=(6, 5))
    assert len({arena.name for arena in arenas}) == 5
    for arena in arenas:
        assert {shape.kind for shape in arena.shapes} == {"box"}
        assert {shape.surface for shape in arena.shapes} <= {"ground", "wall"}
        assert {shape.material for shape in arena.shapes} == {"opaque"}
        assert {loose.shapes for loose in arena.loose} <= set(FORMS.values())
        assert (arena.floor, arena.doors, arena.waters) == (0.0, (), ())
    batch = arena_set(arenas)
    assert len(batch.arenas) == 5
    assert batch.states.pos.shape[1] <= budget(kind, (6, 5)).shapes


@FEW
@given(kind=st.sampled_from(NAMES), size=SMALL, seed=st.integers(0, 2**64), hard=DIFFICULTIES)
def test_budgets_are_kept(kind, size, seed, hard):
    most = budget(kind, size)
    arena = generate(kind, size, seed, hard, victims=most.victims, reachable=0.5)
    for name in ("shapes", "loose", "victims", "starts", "tags"):
        assert len(getattr(arena, name)) <= getattr(most, name), name


@FEW
@given(
    kind=st.sampled_from(NAMES),
    size=SMALL,
    seed=st.integers(0, 999),
    hard=DIFFICULTIES,
    share=st.sampled_from([0.0, 0.5, 1.0]),
    robot=st.sampled_from(["P2AT", "P2DX", "ATRVJr", "Talon"]),
)
def test_the_stated_share_of_victims_and_all_starts_are_reached(kind, size, seed, hard, share, robot):
    arena = generate(kind, size, seed, hard, robot=robot, reachable=share)
    need = footprint_of(ROBOTS.get(robot))
    # Other squares than the generator's.
    there = reach_map(arena, need.radius, need.step, height=need.height, cell=0.018)
    assert sum(victims_reached(arena, there)) == round(share * len(arena.victims))
    assert all(there.reachable(start.at[0], start.at[1], 0.0) for start in arena.starts)


def test_16_robots_can_start_where_there_is_room():
    for kind in NAMES:
        starts = generate(kind, (8, 6), seed=2, difficulty=Difficulty.of(1.0)).starts
        assert starts[0].tag == "PlayerStart"
        assert len({start.tag for start in starts}) == len(starts) >= 16
        assert {start.at[2] for start in starts} == {0.188}  # manual 5.3.5
        spots = [start.at for start in starts]
        assert min(math.dist(a, b) for a, b in itertools.combinations(spots, 2)) > CELL - EXACT


def test_a_larger_team_has_more_start_poses_in_the_same_arena():
    usual, more = generate("maze", (8, 6), seed=2), generate("maze", (8, 6), seed=2, starts=36)
    assert (len(usual.starts), len(more.starts)) == (24, 36)
    assert more.starts[:24] == usual.starts
    assert more.shapes == usual.shapes
    spots = [start.at for start in more.starts]
    assert min(math.dist(a, b) for a, b in itertools.combinations(spots, 2)) > CELL - EXACT


def solids(arena):
    """The compiled arena with an upright cylinder in each start's place and a ball in each tag's."""
    spec = new_spec(arena, Physics())
    for i, start in enumerate(arena.starts):
        at = (start.at[0], start.at[1], 0.3)
        kind = mujoco.mjtGeom.mjGEOM_CYLINDER
        spec.worldbody.add_geom(name=f"start{i}", type=kind, size=(NEED.radius, 0.29, 0.0), pos=at)
    for i, tag in enumerate(arena.tags):
        at = (tag.at[0], tag.at[1], 0.03)
        spec.worldbody.add_geom(name=f"tag{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.02, 0, 0), pos=at)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def overlaps(arena):
    """Pairs of things that reach into each other by more than rounding, by C MuJoCo."""
    model, data = solids(arena)
    groups = {ARENA_PREFIX: [], VICTIM_PREFIX: [], LOOSE_PREFIX: [], "start": [], "tag": []}
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        for group, members in groups.items():
            if name.startswith(group):
                members.append(geom)
    assert [len(members) for members in groups.values()] == [
        len(arena.shapes),
        11 * len(arena.victims),
        len(arena.loose),
        len(arena.starts),
        len(arena.tags),
    ]
    found = []
    for one, two in itertools.combinations_with_replacement(groups, 2):
        for a, b in itertools.product(groups[one], groups[two]):
            if one == two and (a >= b or one in (ARENA_PREFIX, VICTIM_PREFIX)):
                continue
            reach = model.geom_rbound[a] + model.geom_rbound[b]
            if np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b]) > reach:
                continue
            if mujoco.mj_geomDistance(model, data, a, b, 0.01, None) < -1e-5:
                found.append((model.geom(a).name, model.geom(b).name))
    return found


@pytest.mark.parametrize("kind", NAMES)
@pytest.mark.parametrize("seed", [0, 1])
def test_nothing_overlaps_at_full_clutter(kind, seed):
    arena = generate(kind, (7, 6), seed, Difficulty.of(1.0), reachable=0.7)
    assert len(arena.loose) >= 8
    assert overlaps(arena) == []


def test_victims_of_one_arena_do_not_overlap_each_other():
    arena = generate("collapsed", (8, 6), 1, victims=6)
    lows, highs = [], []
    for victim in arena.victims:
        spots = np.array([part.at for part in shapes_in_arena(victim)])
        lows.append(spots.min(0) - 0.08)  # half a hand, and less than half a limb
        highs.append(spots.max(0) + 0.08)
    for a, b in itertools.combinations(range(len(lows)), 2):
        assert (lows[a] > highs[b]).any() or (lows[b] > highs[a]).any()


def test_the_check_for_overlaps_above_can_fail():
    arena = generate("maze", (4, 4), 0)
    moved = replace(arena.starts[0], at=(0.2, 0.2, 0.188))
    assert overlaps(replace(arena, starts=(moved, *arena.starts[1:])))
    stacked = [replace(loose, at=arena.tags[0].at) for loose in arena.loose[:1]]
    assert overlaps(replace(arena, loose=(*stacked, *arena.loose[1:])))


def test_loose_objects_lie_still():
    arena = generate("rubble", (6, 5), 1, Difficulty.of(1.0))
    model = new_spec(arena, Physics()).compile()
    data = mujoco.MjData(model)
    start = data.qpos.reshape(-1, 7)[:, :3].copy()
    mujoco.mj_step(model, data, nstep=200)  # 1 s
    moved = np.abs(data.qpos.reshape(-1, 7)[:, :3] - start).max()
    assert moved < 0.005  # they start 1 mm above the floor


def edges(arena):
    """The inner places for walls, and at which of them there is one."""
    columns, rows = (round(high / CELL) for _, high in arena.extent)
    walls = [shape for shape in arena.shapes if shape.surface == "wall"]
    found = {}
    for c, r, (dx, dy) in itertools.product(range(columns), range(rows), ((1, 0), (0, 1))):
        if c + dx < columns and r + dy < rows:
            spot = ((c + (1 + dx) / 2) * CELL, (r + (1 + dy) / 2) * CELL)
            found[c, r, c + dx, r + dy] = any(
                all(abs(spot[i] - wall.at[i]) < wall.size[i] + 0.01 for i in (0, 1)) for wall in walls
            )
    return found


def wall_length(arena):
    return CELL * sum(edges(arena).values())


def dead_ends(arena):
    """Cells with one open side."""
    sides = {}
    for (c0, r0, c1, r1), wall in edges(arena).items():
        for cell in ((c0, r0), (c1, r1)):
            sides[cell] = sides.get(cell, 0) + (not wall)
    return sum(open_sides == 1 for open_sides in sides.values())


def mean_height(arena):
    """Of the highest points of what stands on the floor, walls left out."""
    tops = []
    for shape in arena.shapes:
        if shape.surface == "ground":
            across = math.sin(abs(shape.rotation[1])) * shape.size[0]
            tops.append(shape.at[2] + across + math.cos(shape.rotation[1]) * shape.size[2])
    return np.mean(tops)


def objects(arena):
    return len(arena.loose) + sum(shape.surface == "ground" for shape in arena.shapes)


def radio_ends(arena):
    """Segments from half a metre above the first start to so high over the middles of all cells."""
    start = np.array([*arena.starts[0].at[:2], 0.5])
    (_, x1), (_, y1) = arena.extent
    x, y = np.meshgrid(np.arange(CELL / 2, x1, CELL), np.arange(CELL / 2, y1, CELL))
    return start, np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.5)], -1)


def walls_between(arena):
    """Mean number of wall boxes between the first start and the cells: upright boxes along the axes."""
    start, ends = radio_ends(arena)
    boxes = [s for s in arena.shapes if s.surface == "wall"]
    mid, half = np.array([s.at for s in boxes]), np.array([s.size for s in boxes])
    way = ends[:, None] - start
    with np.errstate(divide="ignore", invalid="ignore"):
        cuts = np.stack([(mid - half - start) / way, (mid + half - start) / way])[..., :2]
    enter, leave = cuts.min(0).max(-1), cuts.max(0).min(-1)
    return (np.maximum(enter, 0.0) < np.minimum(leave, 1.0)).sum(1).mean()


def test_walls_between_are_those_that_the_radio_counts():
    arena = generate("maze", (5, 4), 3)
    start, ends = radio_ends(arena)
    walls = replace(arena, shapes=tuple(s for s in arena.shapes if s.surface == "wall"), victims=())
    starts = jnp.broadcast_to(jnp.asarray(start, jnp.float32), ends.shape)
    counted = count_walls(arena_solids(walls), starts, jnp.asarray(ends, jnp.float32))
    assert walls_between(arena) == pytest.approx(float(counted.mean()))


EVERYWHERE = tuple(NAMES)
EFFECTS = [
    ("wall_density", wall_length, EVERYWHERE),
    ("roughness", mean_height, EVERYWHERE),
    ("clutter", objects, EVERYWHERE),
    ("dead_ends", dead_ends, ("maze",)),
    ("dead_ends", wall_length, ("building", "collapsed")),  # fewer doorways
    ("radio_shadow", walls_between, EVERYWHERE),
]


@pytest.mark.every_run(
    "wall_density-wall_length-building",
    "wall_density-wall_length-maze",
    "roughness-mean_height-rubble",
    "roughness-mean_height-ramps",
    "clutter-objects-collapsed",
    "clutter-objects-steps",
    "dead_ends-dead_ends-maze",
    "dead_ends-wall_length-building",
    "radio_shadow-walls_between-rubble",
    "radio_shadow-walls_between-collapsed",
)
@pytest.mark.parametrize(
    ("name", "measure", "kind"),
    [(name, measure, kind) for name, measure, kinds in EFFECTS for kind in kinds],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_difficulty_has_a_monotone_effect(name, measure, kind):
    rest = Difficulty(wall_density=0.8, dead_ends=1.0) if name != "wall_density" else Difficulty()
    for seed in SEEDS:
        seen = [measure(generate(kind, (8, 6), seed, replace(rest, **{name: level}))) for level in LEVELS]
        assert all(a <= b + EXACT for a, b in itertools.pairwise(seen)), (seed, seen)
        assert seen[0] < seen[-1], (seed, seen)


def test_a_maze_at_full_difficulty_is_perfect():
    arena = generate("maze", (8, 6), 5, Difficulty.of(1.0))
    ways = [pair for pair, wall in edges(arena).items() if not wall]
    assert len(ways) == 8 * 6 - 1  # a tree
    area = {(c, r): (c, r) for c in range(8) for r in range(6)}

    def root(cell):
        return cell if area[cell] == cell else root(area[cell])

    for c0, r0, c1, r1 in ways:
        area[root((c0, r0))] = root((c1, r1))
    assert len({root(cell) for cell in area}) == 1


def test_a_maze_without_dead_ends_has_none():
    for seed in SEEDS:
        assert dead_ends(generate("maze", (8, 6), seed, Difficulty(wall_density=1.0, dead_ends=0.0))) == 0


def test_walls_are_straight_pieces_of_at_most_four_cells():
    for kind in NAMES:
        walls = [s for s in generate(kind, (12, 8), 1).shapes if s.surface == "wall"]
        assert max(max(s.size[:2]) for s in walls) <= 2 * CELL + 0.025 + EXACT
        assert {s.at[2] for s in walls} == {WALL_HEIGHT / 2}


def test_curricula_set_all_of_the_difficulty():
    assert Difficulty.of(0.3) == Difficulty(
        wall_density=0.3, roughness=0.3, clutter=0.3, dead_ends=0.3, radio_shadow=0.3
    )


def test_the_second_floor_has_a_victim():
    for seed in SEEDS:
        arena = generate("ramps", (8, 5), seed)
        up = [victim for victim in arena.victims if victim.at[2] > STOREY]
        assert len(up) == 1
        assert pytest.approx(2.4 * math.tan(math.radians(15))) == STOREY


def test_a_p2at_drives_up_to_the_second_floor():
    arena = generate("ramps", (8, 5), 0, Difficulty.of(0.0))
    ramps = [s for s in arena.shapes if s.size[0] > CELL and s.rotation[1] < 0]
    assert len(ramps) == 2
    ramp = min(ramps, key=lambda shape: abs(math.cos(shape.rotation[2]) - 1.0))  # climbs along x
    foot = ramp.at[0] - 1.2 - 0.6
    rig = Rig("P2AT", *arena.shapes, places=((foot, ramp.at[1], 0.0),))
    rig.tell(Left=3, Right=3)  # rad/s: 0.39 m/s
    path = rig.run(9.0)
    # It stands as high above the deck as above the floor, within a contact's depth.
    assert path[-1, 2] - path[0, 2] == pytest.approx(STOREY, abs=0.01)
    assert rig.up[0] > 0.99


@pytest.mark.parametrize(
    ("error", "keys", "message"),
    [
        (
            UnknownNameError,
            {"kind": "swamp"},
            r"unknown kind of arena 'swamp'; did you mean 'ramps'\? known: building, collapsed, maze",
        ),
        (SpecError, {"size": (2, 6)}, "size 2x6, expected 3 to 64"),
        (SpecError, {"size": (6, 65)}, "size 6x65, expected 3 to 64"),
        (SpecError, {"seed": -1}, "seed -1, expected 0 or more"),
        (SpecError, {"reachable": 1.1}, "reachable 1.1, expected from 0 to 1"),
        (SpecError, {"reachable": math.nan}, "reachable nan, expected from 0 to 1"),
        (SpecError, {"victims": 7}, "7 victims, expected 0 to 6 in 8x6 cells"),
        (SpecError, {"starts": 0}, "0 start poses, expected at least 1"),
        (SpecError, {"robot": "Hummer"}, r"circle of radius 2.05 m; the arenas' corridors take 0.54 m"),
        (UnknownNameError, {"robot": "Dalek"}, "unknown robot"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_what_cannot_be_made_is_refused(error, keys, message):
    with pytest.raises(error, match=message):
        generate(**{"kind": "maze", **keys})


@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan])
def test_difficulties_are_from_0_to_1(value):
    with pytest.raises(SpecError, match=r"Difficulty: clutter is .*, expected a number from 0 to 1"):
        Difficulty(clutter=value)
