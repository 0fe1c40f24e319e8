"""Reports of victims to a base, in a room with a drawn map and made-up sensor readings."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.rooms import play, room
from usarmjx.train.evaluation.yardsticks import measure_teams
from usarmjx.train.mapping.maps import FREE, MARK
from usarmjx.train.mapping.wavefront import frontier
from usarmjx.train.tasks import TASKS
from usarmjx.train.tasks.critic_features import OWN_WIDTH, TRUTH_WIDTH
from usarmjx.train.tasks.goal_features import NEWS_SCALE, OBSERVATION_SIZE
from usarmjx.train.tasks.reporting_team import LOOK_ANGLE, LOOK_RANGE, TRY_RADIUS, SearchBase, in_view

STARTS = ((0.6, 0.9), (0.6, 2.1), (1.8, 0.9))
VICTIM, OTHER = (5.0, 1.5), (2.0, 1.5)
PART = (1.0, 0.0, 1.0, -0.3, 0.1)
"""A part met 1 m ahead of a victim sensor (0.1439 m before a robot's middle) and 0.3 m to its right."""
BEFORE = (3.8561, 1.8, 0.0)
"""From here that part is where the victim is."""
STEPS = 6
TASK = SearchBase(
    arena=room(STARTS, (VICTIM, OTHER)), count=2, episode_steps=STEPS, price=0.0, hint=0.0, found=0.5
)
"""A base and two robots; all tests play this task, which is compiled once."""


def links(*pairs):
    """Links of the base and two robots."""
    table = np.zeros((3, 3), bool)
    for i, j in pairs:
        table[i, j] = table[j, i] = True
    return table


APART, JOINED = links(), links((0, 2), (1, 2))


def searched(met, linked):
    """Steps of robots that stand; of each step which robots meet the victim, and the links."""
    path = [[(*STARTS[0], 0.0), BEFORE, (*BEFORE[:2], 0.0)]] * (STEPS + 1)
    boxes = len(TASK.scene().victims.part)
    table = np.zeros((STEPS + 1, 3, boxes, 5), np.float32)
    for step, robots in met.items():
        table[step, list(robots), 0] = PART
    return list(play(TASK, path, linked, table))


@pytest.fixture(scope="module")
def late():
    """One robot meets a victim in step 1; a link over the other begins after step 2."""
    return searched({1: (1,)}, [APART] * 3 + [JOINED] * 4)


def test_a_victim_counts_only_after_its_report_has_come_over_links(late):
    """Met in step 1; sent after step 3 to the other, after step 4 by that one to the base, read in step 5."""
    metrics = [result.metrics for _, _, result in late[1:]]
    assert [float(one["reported"]) for one in metrics] == [0, 0, 0, 0, 0.5, 0.5]
    assert [float(one["found"]) for one in metrics] == [0.5] * STEPS
    silent = searched({1: (1,)}, [APART] * (STEPS + 1))
    assert float(silent[-1][2].score) == 0.0
    assert float(silent[-1][2].metrics["found"]) == 0.5


def test_an_early_report_pays_more(late):
    """One of two victims pays 50 times 1 - haste (k - 1) / n in step k of n: 33.3 in step 5 of 6."""
    assert TASK.haste == 0.5
    assert float(late[-1][2].score) == pytest.approx(50 * (1 - 0.5 * 4 / 6), rel=1e-5)
    at_once = searched({1: (1,)}, [links((0, 1))] * (STEPS + 1))
    # Sent after step 1, read in step 2.
    assert float(at_once[-1][2].score) == pytest.approx(50 * (1 - 0.5 * 1 / 6), rel=1e-5)
    series = {name: np.array([r.metrics[name] for _, _, r in late[1:]]) for name in ("reported", "contacts")}
    parts = TASK.score_parts(series)
    assert parts.keys() == TASK.most_points.keys()
    np.testing.assert_allclose(sum(parts.values()), [float(r.score) for _, _, r in late[1:]], rtol=1e-5)


def test_the_finder_gets_its_share_and_nobody_pays_for_passing_on(late):
    """Half of the reward goes to the finder, the rest to both; together they are the points."""
    rewards = np.array([np.asarray(result.reward[0]) for _, _, result in late[1:]])
    points = 50 * (1 - 0.5 * 4 / 6)
    np.testing.assert_allclose(rewards.sum(0), [0.75 * points, 0.25 * points], rtol=1e-5)
    assert (np.flatnonzero(rewards.sum(1)) == [4]).all()


def test_a_report_counts_once_however_many_bring_it():
    steps = searched({1: (1, 2), 2: (1,), 4: (2,)}, [JOINED] * (STEPS + 1))
    reported = [float(result.metrics["reported"]) for _, _, result in steps[1:]]
    # The second robot has met it too, and has its link to the base.
    assert reported == [0, 0.5, 0.5, 0.5, 0.5, 0.5]
    assert float(steps[-1][2].score) == pytest.approx(50 * (1 - 0.5 * 1 / 6), rel=1e-5)


def test_a_robot_knows_what_its_base_has_not_heard(late):
    news = [NEWS_SCALE * np.asarray(TASK.observe(view, memory)[0])[:, 5] for view, memory, _ in late]
    assert all(seen.shape == (2,) for seen in news)
    first, last = news[1], news[-1]
    assert first.tolist() == pytest.approx([TASK.news_worth, 0.0])
    assert last.tolist() == pytest.approx([0.0, 0.0]), "both have heard that it has come to the base"
    assert np.asarray(TASK.observe(*late[0][:2])[0]).shape == (2, OBSERVATION_SIZE)


def test_a_mark_stands_for_the_nearest_victim_and_for_no_other():
    """Victims at 2.0 and 3.0 m: a mark at 2.4 m is within 1.5 m of both; one at 4.8 m is of none."""
    task = replace(TASK, arena=room(STARTS, ((2.0, 1.5), (3.0, 1.5))))
    scene = task.scene()
    view = SimpleNamespace(scene=scene, victims=scene.victims)
    grid = task.arena_grid(scene)

    def stands_for(*places):
        marks = jnp.zeros(grid.shape, bool)
        for place in places:
            marks = marks.at[tuple(grid.index(jnp.array(place)))].set(True)
        return np.asarray(task.marked(view, marks)).tolist()

    assert stands_for((2.4, 1.5)) == [True, False]
    assert stands_for((2.7, 1.5)) == [False, True]
    assert stands_for((4.8, 1.5)) == [False, False]
    assert stands_for((0.9, 1.5), (4.2, 1.5)) == [True, True]


ORACLE = replace(TASK, oracle=True)


def of_oracle(memory):
    """The memory of an oracle that has not yet looked for any victim."""
    none = jnp.zeros((2, *memory.reachable.shape), bool)
    return memory.replace(extra=memory.extra.replace(looked=none))


def test_an_oracle_goes_to_the_nearest_places_of_victims_that_are_not_reported(late):
    for view, memory, result in (late[1], late[-1]):
        targets = np.asarray(ORACLE.targets(view, of_oracle(memory)))
        missing = [OTHER] if result.metrics["reported"] else [VICTIM, OTHER]
        gaps = np.linalg.norm(TASK.arena_grid(view.scene).centres[:, :, None] - np.array(missing), axis=-1)
        gaps = np.where(np.asarray(memory.reachable)[..., None], gaps, np.inf)
        # To the last bit of single precision several squares are as near.
        nearest = gaps < gaps.min((0, 1)) + 1e-4
        assert (nearest.any(-1) | ~targets).all()
        assert (nearest & targets[..., None]).any((0, 1)).all(), "each of them has a place"


def test_an_oracle_that_looked_in_vain_looks_from_elsewhere(late):
    """It has to be in the place, and turned to the victim: else the place stays."""
    view, memory, _ = late[0]
    memory, grid = of_oracle(memory), TASK.arena_grid(view.scene)
    places = np.asarray(ORACLE.places(view, memory))
    x, y = grid.centres[places[0]][0]
    there = np.arctan2(VICTIM[1] - y, VICTIM[0] - x)

    def tried(*pose):
        poses = memory.belief.pose.at[1].set(jnp.array(pose))
        return ORACLE.tries(view, memory.replace(belief=memory.belief.replace(pose=poses)))

    assert not np.asarray(tried(x, y, there + np.pi)).any()
    assert not np.asarray(tried(x - 1.0, y, 0.0)).any()
    vain = tried(x, y, there)
    assert vain[0].any()
    assert not vain[1].any(), "of the other victim it says nothing"
    after = ORACLE.places(view, memory.replace(extra=memory.extra.replace(looked=vain)))
    gap = np.linalg.norm(grid.centres[np.asarray(after)[0]] - np.array([x, y]), axis=-1)
    assert len(gap)
    assert (gap >= TRY_RADIUS).all()
    np.testing.assert_array_equal(after[1], places[1])


def test_the_way_of_an_oracle_ends_at_the_victim_so_that_it_turns_there(late):
    view, memory, _ = late[0]
    assert TASK.known(view, memory).sights == ()
    memory = of_oracle(memory)
    known = ORACLE.known(view, memory)
    grid = TASK.arena_grid(view.scene)
    place = grid.centres[np.asarray(ORACLE.places(view, memory))[1]][0]
    goal = jnp.broadcast_to(jnp.asarray(place, jnp.float32), (3, 2))
    way = np.asarray(ORACLE.ways(view.scene, known, goal))[1]
    usual = np.asarray(ORACLE.ways(view.scene, known.replace(sights=()), goal))[1]
    arrived = np.flatnonzero((np.abs(usual - place) < 1e-4).all(-1))[0]
    np.testing.assert_array_equal(way[: arrived + 1], usual[: arrived + 1])
    np.testing.assert_allclose(way[arrived + 1 :] - OTHER, 0.0, atol=1e-5)


def test_a_robot_goes_back_for_what_its_scanner_saw_and_its_victim_sensor_did_not(late):
    view, memory, _ = late[0]
    grid = TASK.arena_grid(view.scene)
    away = grid.centres - np.array([2.0, 1.5])
    bearing = np.abs(np.arctan2(away[..., 1], away[..., 0]))
    near = np.hypot(away[..., 0], away[..., 1]) < LOOK_RANGE
    seen = np.asarray(in_view(grid, jnp.array([2.0, 1.5, 0.0])))
    np.testing.assert_array_equal(seen, near & (bearing <= LOOK_ANGLE))
    # Robots of the fixture stand and look along x: ahead they have looked, to their sides not.
    robot = np.asarray(memory.belief.pose)[1, :2]
    left = np.asarray(TASK.pending(view, memory))[1]
    looked = np.asarray(memory.extra.looked)[1]
    away = grid.centres - robot
    bearing = np.abs(np.arctan2(away[..., 1], away[..., 0]))
    assert looked.any()
    assert (bearing[looked] <= LOOK_ANGLE + 1e-6).all()
    assert left.any()
    assert not (left & looked).any()
    assert (np.asarray(memory.belief.evidence)[1][left] < 0).all()
    ends = np.asarray(TASK.ends(TASK.known(view, memory)))[1]
    assert (left & ends).any()
    looked_at = memory.replace(extra=memory.extra.replace(looked=jnp.ones_like(memory.extra.looked)))
    borders = np.asarray(TASK.ends(TASK.known(view, looked_at)))[1]
    np.testing.assert_array_equal(borders, np.asarray(frontier(memory.belief.squares[1])))


def test_marks_of_the_base_are_its_only_news(late):
    """A mark is on the base's map where the victim is, and the robots' free squares are no news."""
    _, memory, _ = late[-1]
    marked = np.argwhere(np.asarray(memory.belief.squares)[0] == MARK)
    np.testing.assert_array_equal(marked, [np.round(np.array(VICTIM) / 0.3)])


def critics_view(view, memory):
    """Of a team of two: facts (3,), true maps (3, 256), own maps (2, 64), poses (12,), victims (2, 6)."""
    seen = np.asarray(TASK.privileged(view, memory))
    ends = np.cumsum([3, 3 * TRUTH_WIDTH**2, 2 * OWN_WIDTH**2, 12])
    facts, true, own, poses, victims = np.split(seen, ends)
    return facts, true.reshape(3, -1), own.reshape(2, -1), poses, victims.reshape(2, -1)


def test_critics_see_victims_and_who_knows_of_them(late):
    """Robot 1 meets the victim in step 1, hears of robot 2 after step 2, and the base of it in step 5."""
    shown = [critics_view(view, memory)[-1] for view, memory, _ in late]
    for row in shown:
        np.testing.assert_allclose(row[:, 0], 1.0)
        np.testing.assert_allclose(row[:, 1:3], np.array([VICTIM, OTHER]) / [6.0, 3.0], rtol=1e-6)
        np.testing.assert_array_equal(row[1, 3:], 0.0)
    known = np.array([row[0, 3:] for row in shown])
    np.testing.assert_array_equal(known[:, 1], [0, 1, 1, 1, 1, 1, 1])
    np.testing.assert_array_equal(known[:, 0], [0, 0, 0, 0, 0, 1, 1])
    assert known[-1, 2] == 1.0
    # The second robot passes the report on, so it has it before the base.
    assert np.flatnonzero(known[:, 2])[0] < np.flatnonzero(known[:, 0])[0]


def test_critics_see_the_map_of_each_robot(late):
    """The free squares of a robot's map, counted; a block of a map has a known number of squares."""
    view, memory, _ = late[0]
    own = critics_view(view, memory)[2]
    free = np.asarray(memory.belief.squares)[1:] == FREE
    block = np.prod([-(-side // OWN_WIDTH) for side in free.shape[1:]])
    np.testing.assert_allclose(own.sum(1) * block, free.sum((1, 2)), rtol=1e-5)
    blank = memory.belief.replace(evidence=memory.belief.evidence.at[2].set(0))
    first, second = critics_view(view, memory.replace(belief=blank))[2]
    np.testing.assert_array_equal(first, own[0])
    np.testing.assert_array_equal(second, 0.0)


def test_teams_of_any_number_see_as_much():
    task = TASKS.get("victim-search-v3")
    for count in (1, 8):
        scene = SimpleNamespace(num_robots=1 + count, groups=())
        assert replace(task, count=count).layout(scene).size == OBSERVATION_SIZE
    kinds = {mount.kind for mount in task.robots[1].sensors}
    assert kinds == {"INS", "RangeScanner", "VictSensor"}


@pytest.mark.thorough
def test_reports_and_teamwork_pay():
    """Means of six buildings: the planner that reports, a silent one, and one robot alone."""
    teams, coarse = ("frontier", "one", "baseline"), {"physics": "coarse"}
    rows = measure_teams("victim-search-v3", 6, teams=teams, engine="planar", split="validation", **coarse)
    silent, one, reporting = (np.array(row.by_world).mean() for row in rows)
    assert reporting > silent + 5.0
    assert reporting > one + 2.0


@pytest.mark.thorough
def test_who_reports_beats_who_does_not_even_if_all_know_the_building():
    """Three buildings, two robots that know them and hear each other over their own radio."""
    alike = {"physics": "coarse", "count": 2, "oracle": True}
    teams = ("frontier", "courier")
    rows = measure_teams("victim-search-v3", 3, teams=teams, engine="planar", split="validation", **alike)
    silent, reporting = (np.array(row.by_world) for row in rows)
    assert (reporting > silent + 10.0).all()


@pytest.mark.thorough
def test_an_oracle_scores_more_than_the_baseline_that_hears_all():
    """Eight buildings, two robots; the oracle is ahead in all of them, by 37 points in the mean."""
    alike = {"physics": "coarse", "count": 2}
    teams = ("perfect-radio", "oracle")
    rows = measure_teams("victim-search-v3", 8, teams=teams, engine="planar", split="validation", **alike)
    baseline, oracle = (np.array(row.by_world) for row in rows)
    assert (oracle > baseline).all(), (oracle, baseline)
    assert oracle.mean() > baseline.mean() + 20.0
