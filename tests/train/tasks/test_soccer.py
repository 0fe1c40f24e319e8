"""soccer: field and robot, what scanners tell, judgements of states made by hand, and games on engine c."""

import math
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import usarmjx
from tests.train.views import placed, told, view_of
from usarmjx.base.errors import UsageError
from usarmjx.comms.mail import empty_inboxes
from usarmjx.engines.base import check_features
from usarmjx.models.arenas.soccer import BALL_RADIUS, GOAL_WIDTH, LENGTH, SOCCER
from usarmjx.sim.world import observe
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation.evaluate import run_episodes
from usarmjx.train.learning.config import task_config
from usarmjx.train.tasks import TASKS
from usarmjx.train.tasks.soccer import (
    MAIL_SETTINGS,
    NEVER,
    NUMBERS,
    SIDES,
    Soccer,
    SoccerMemory,
    compose_messages,
    find_ball,
    find_others,
    initial_belief,
    update_from_mail,
)
from usarmjx.train.tasks.soccer_field import (
    BEAMS,
    COVER,
    FREE_KICK,
    GOAL_LINE,
    LOWER_SCANNER_HEIGHT,
    SCANNER_RANGE,
    SOCCER_FIELD,
    UPPER_SCANNER_HEIGHT,
    beams,
    depth_inside,
    goal_scored,
)
from usarmjx.train.tasks.soccer_play import soccer_action

TASK = Soccer(episode_steps=200)
POSES = (
    ((-1.0, 0.5, 0.2, 0.0, 0.0, 0.3), (-2.2, 0.0, 0.2, 0.0, 0.0, 1.5)),
    (
        (1.2, -0.4, 0.2, 0.0, 0.0, 2.5),
        (2.0, 1.0, 0.2, 0.0, 0.0, -2.0),
    ),
)
"""Of blue and yellow: x, y, z, roll, pitch, yaw."""
BETWEEN_BEAMS = 0.0277
"""Half the angle between two beams [rad]."""


def test_beams_are_those_of_both_scanners(view):
    suite = view.scene.groups[0].suite
    for kind in ("RangeScanner", "IRScanner"):
        lines = suite.sensors[suite.index(kind)].directions()
        np.testing.assert_allclose(np.arctan2(lines[:, 1], lines[:, 0]), beams(), atol=1e-6)


@pytest.fixture(scope="module")
def view():
    return view_of(TASK)


def with_ball(view, x, y):
    """The same view with the ball there."""
    place = view.scene.loose_geoms.root_qposadr[0, :2]
    return view.replace(physics=view.physics.replace(qpos=view.physics.qpos.at[place].set(jnp.array([x, y]))))


def half_turn(pose):
    x, y, z, roll, pitch, yaw = pose
    return (-x, -y, z, roll, pitch, yaw + math.pi)


# The field and the robot.


def test_the_field_is_that_of_dm_soccer_without_its_dead_corners():
    """Beside the goals the boards are on the goal lines; the goals and the lines are as they were."""
    places = jnp.array(
        [(2.7, 1.0), (0.0, 2.0), (2.45, 1.75), (2.69, 0.3), (3.0, 0.0), (2.8, 0.4), (0.0, 0.0)]
    )
    np.testing.assert_allclose(depth_inside(places), [0, 0, 0, 0.1, 0, 0, 2.0], atol=0.011)
    kept = [shape for shape in SOCCER.shapes if shape in SOCCER_FIELD.shapes]
    assert len(kept) == 3 + 3 + 2, "goals and long boards"


def test_boards_are_where_the_robots_take_them_to_be(view):
    """C MuJoCo's rays from the middle, at the height of the ball's middle, the ball elsewhere."""
    data = mujoco.MjData(view.scene.model)
    data.qpos[:] = view.scene.model.qpos0
    for slot in range(4):
        data.qpos[view.scene.groups[0].root_qposadr[slot, 2]] += 5.0
    data.qpos[view.scene.loose_geoms.root_qposadr[0, 2]] += 5.0
    mujoco.mj_kinematics(view.scene.model, data)
    geom = np.zeros(1, np.int32)
    for angle in np.arange(64) * math.tau / 64 + 0.01:
        way = np.array([math.cos(angle), math.sin(angle), 0.0])
        far = mujoco.mj_ray(
            view.scene.model, data, np.array([0, 0, LOWER_SCANNER_HEIGHT]), way, None, 1, -1, geom
        )
        assert float(depth_inside(far * way[:2])) == pytest.approx(0.0, abs=1e-3), angle


def test_starts_are_mirrored_and_apart():
    poses = np.array([(*start.at[:2], start.yaw) for start in SOCCER_FIELD.starts])
    places = poses[:, :2]
    gaps = np.linalg.norm(places[:, None] - places, axis=-1) + 9 * np.eye(len(places))
    assert gaps.min() > math.hypot(0.44, 0.38), "two robots do not overlap, whatever their yaws"
    assert np.linalg.norm(places, axis=-1).min() > FREE_KICK
    assert np.asarray(depth_inside(places)).min() > math.hypot(0.22, 0.19)
    for x, y, yaw in poses:
        turned = np.abs(poses - (-x, -y, yaw + math.pi))
        turned[:, 2] = np.abs(np.mod(turned[:, 2] + math.pi, math.tau) - math.pi)
        assert turned.sum(-1).min() < 1e-6


def test_the_ball_meets_covers_and_neither_wheels_nor_casters(view):
    """MuJoCo's own filter decides."""
    model = view.scene.model
    sphere = model.geom("loose/Ball/0").id
    ours = np.isin(model.geom_bodyid, view.scene.groups[0].indices[0].body_ids)
    meets = (model.geom_contype[sphere] & model.geom_conaffinity) | (
        model.geom_conaffinity[sphere] & model.geom_contype
    )
    assert (ours & (meets > 0)).sum() == 1
    (cover,) = np.flatnonzero(ours & (meets > 0))
    np.testing.assert_allclose(model.geom_size[cover], (0.22, 0.19, 0.135))
    assert COVER[0] < BALL_RADIUS < 2 * BALL_RADIUS < UPPER_SCANNER_HEIGHT < COVER[1]


def test_all_engines_have_the_contacts(view):
    for engine in ("c", "jax", "warp"):
        check_features(view.scene.model, engine)


# Goals, rewards, score.


@pytest.mark.parametrize(
    ("x", "y", "goal"),
    [
        (LENGTH / 2 + BALL_RADIUS + 0.01, 0.0, 1),
        (LENGTH / 2 + BALL_RADIUS - 0.01, 0.0, 0),
        (-LENGTH / 2 - BALL_RADIUS - 0.01, 0.2, -1),
        (LENGTH / 2 + BALL_RADIUS + 0.01, GOAL_WIDTH / 2 + 0.1, 0),
        (0.0, 0.0, 0),
    ],
)
def test_a_goal_is_the_whole_ball_behind_the_line(view, x, y, goal):
    assert float(goal_scored(jnp.array([x, y]))) == goal
    here = told(placed(with_ball(view, x, y), *POSES[0], *POSES[1]), **BLIND)
    memory = TASK.start(here, jax.random.key(0))
    result = TASK.evaluate(here, memory)
    assert bool(result.terminated) is (goal != 0)
    assert float(result.score) == goal
    np.testing.assert_allclose(result.reward[0], 5.0 * goal * SIDES, atol=1e-6)


BLIND = {
    "GroundTruth": np.array([*POSES[0], *POSES[1]]),
    "RangeScanner": np.full((4, 76), SCANNER_RANGE),
    "IRScanner": np.full((4, 76), SCANNER_RANGE),
}
"""Sensors that show where the robots are and nothing else."""


def stands(ball, blue, yellow):
    """How the game stands for blue, from the task's text."""
    ball, blue, yellow = map(np.array, (ball, blue, yellow))
    a, b = (np.linalg.norm(ball - (x, 0)) for x in (-LENGTH / 2, LENGTH / 2))
    c, d = (np.linalg.norm(team[:, :2] - ball, axis=-1).min() for team in (blue, yellow))
    return (a - b) / 2 + 0.2 * (d - c)


def test_rewards_are_what_the_game_stands_better_and_add_up_to_nothing(view):
    before, after = (0.0, 0.0), (0.5, -0.3)
    start = told(placed(with_ball(view, *before), *POSES[0], *POSES[1]), **BLIND)
    moved = ((-0.5, 0.3, *POSES[0][0][2:]), POSES[0][1])
    later = told(placed(with_ball(view, *after), *moved, *POSES[1]), **BLIND)
    result = TASK.evaluate(later, TASK.start(start, jax.random.key(0)))
    gain = stands(after, moved, POSES[1]) - stands(before, POSES[0], POSES[1])
    np.testing.assert_allclose(result.reward[0], gain * SIDES, atol=1e-5)
    assert abs(gain) > 0.1
    assert float(result.reward[0].sum()) == pytest.approx(0.0, abs=1e-6)


SHAPED = TASKS.get("soccer-v2")


def test_the_gains_of_an_episode_add_up_to_what_it_began_with():
    """Discounted, in closed form: -w of the start, whatever way it took."""
    draw = np.random.default_rng(4)
    for steps in (1, 7, 60):
        worth = np.concatenate([[0.7], draw.normal(size=steps)]).astype(np.float32)
        over = np.arange(1, steps + 1) == steps
        gains = np.array([SHAPED.gain(*row) for row in zip(worth[:-1], worth[1:], over, strict=True)])
        assert (gains * SHAPED.discount ** np.arange(steps)).sum() == pytest.approx(-0.7, abs=1e-5)


def test_gains_change_nothing_about_which_play_is_best():
    """A random game of 12 states, three moves, and 30 steps: the best moves by backward induction."""
    draw, steps, discount = np.random.default_rng(5), 30, SHAPED.discount
    worth, reward = draw.normal(size=12) * 3.0, draw.normal(size=(12, 3))
    after = draw.integers(0, 12, (12, 3))
    best, values = [], []
    for shaped in (False, True):
        value, moves = np.zeros(12), []
        for step in reversed(range(steps)):
            gain = SHAPED.gain(worth[:, None], worth[after], jnp.bool_(step == steps - 1))
            choices = reward + shaped * np.asarray(gain) + discount * value[after]
            value, moves = choices.max(1), [choices.argmax(1), *moves]
        best.append(np.array(moves))
        values.append(value)
    np.testing.assert_array_equal(*best)
    np.testing.assert_allclose(values[1] - values[0], -worth, atol=1e-4)
    assert len(np.unique(best[0])) == 3


@pytest.mark.parametrize(("ball", "step"), [((2.85, 0.0), 10), ((0.5, -0.3), SHAPED.episode_steps - 1)])
def test_the_last_step_takes_back_what_is_left_of_the_gains(view, ball, step):
    """A goal brings its bonus, and either end costs w of the state before."""
    here = told(placed(with_ball(view, *ball), *POSES[0], *POSES[1]), **BLIND)
    memory = SHAPED.start(here, jax.random.key(0)).replace(potential=jnp.float32(1.25), step=jnp.int32(step))
    result = SHAPED.evaluate(here, memory)
    goal = 1.0 if ball[0] > LENGTH / 2 else 0.0
    np.testing.assert_allclose(result.reward[0], (goal * SHAPED.bonus - 1.25) * SIDES, atol=1e-5)
    middle = SHAPED.evaluate(told(placed(with_ball(view, 0.5, -0.3), *POSES[0], *POSES[1]), **BLIND), memory)
    assert (float(middle.reward[0][0]) != pytest.approx(-1.25)) == (step == 10)


def test_learners_that_discount_more_than_the_gains_profit_from_a_ball_that_is_far_ahead():
    """By the default gamma a w of 1 that stays brings (1 - gamma) sum gamma^t; by the gains' own nothing."""
    gamma, steps = task_config("soccer", gpu=True).gamma, 100
    worth = np.ones(steps + 1)
    gains = np.array([SHAPED.gain(a, b, jnp.bool_(False)) for a, b in pairwise(worth)])
    ahead = np.array([SHAPED.gain(jnp.float32(0.0), jnp.float32(1.0), jnp.bool_(False)), *gains])
    kept = (ahead * gamma ** np.arange(steps + 1)).sum() - gamma ** (steps + 1) * 1.0
    assert gamma < SHAPED.discount == 1.0
    assert kept == pytest.approx((1 - gamma) * (gamma ** np.arange(steps + 1)).sum(), rel=1e-6)


def test_yellow_sees_and_gets_what_blue_would_in_its_place(view):
    """Half a turn about the middle, and the teams change places."""
    draw = np.random.default_rng(0)
    scans = {kind: draw.uniform(0.3, 4.0, (4, 76)) for kind in ("RangeScanner", "IRScanner")}
    swap, ball = np.array([2, 3, 0, 1]), (0.4, -0.7)

    def game(sign):
        poses = [*POSES[0], *POSES[1]]
        if sign < 0:
            poses = [half_turn(poses[i]) for i in swap]
        order = np.arange(4) if sign > 0 else swap
        here = placed(with_ball(view, sign * ball[0], sign * ball[1]), *poses)
        here = told(here, GroundTruth=poses, **{kind: scan[order] for kind, scan in scans.items()})
        memory = TASK.start(here, jax.random.key(0))
        goal = told(
            placed(with_ball(here, sign * 2.85, 0.0), *poses),
            GroundTruth=poses,
            **{kind: scan[order] for kind, scan in scans.items()},
        )
        result = TASK.evaluate(goal, memory)
        return TASK.observations(here, memory), result

    (seen, result), (other, turned) = game(1), game(-1)
    assert (np.abs(seen[:, 8:10]).sum(-1) > 0).any(), "some see a ball"
    np.testing.assert_allclose(seen, np.asarray(other)[swap], atol=1e-4)
    np.testing.assert_allclose(result.reward[0], np.asarray(turned.reward[0])[swap], atol=1e-4)
    assert float(result.score) == 1.0 == -float(turned.score)


# What scanners and mail tell.


def ranges(pose, ball, height):
    """Ranges to a ball on an empty field (beams,): where a line meets a sphere."""
    x, y, _, roll, pitch, yaw = pose
    assert roll == 0.0
    cos, sin = math.cos(pitch), math.sin(pitch)
    tilt = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    lines = np.stack([np.cos(beams()), np.sin(beams()), np.zeros(BEAMS)], -1)
    along = lines @ (turn @ tilt).T
    gap = np.array([*ball, BALL_RADIUS]) - (x, y, height)
    near = along @ gap
    root = near**2 - gap @ gap + BALL_RADIUS**2
    far = np.where((root >= 0) & (near > 0), near - np.sqrt(np.maximum(root, 0)), SCANNER_RANGE)
    return np.minimum(far, SCANNER_RANGE)


@pytest.mark.parametrize("pitch", [0.0, 0.01, -0.01])
@pytest.mark.parametrize("ball", [(0.4, 0.0), (1.0, 0.9), (2.0, -1.0), (-0.3, 1.2)])
def test_the_ball_is_what_only_the_lower_scanner_meets(pitch, ball):
    """Right to half the angle between two beams, and some millimetres as a beam may not meet its middle."""
    pose = (-0.5, 0.2, 0.2, 0.0, pitch, 0.3)
    low, high = (
        jnp.array(ranges(pose, ball, height)) for height in (LOWER_SCANNER_HEIGHT, UPPER_SCANNER_HEIGHT)
    )
    assert float(high.min()) == SCANNER_RANGE
    found, there = find_ball(jnp.array(pose), low, high)
    assert bool(there)
    far = math.dist(pose[:2], ball)
    assert math.dist(found, ball) < far * BETWEEN_BEAMS + 0.01


def test_what_both_scanners_meet_is_a_robot_or_a_board():
    pose = jnp.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    scan = jnp.full(76, SCANNER_RANGE).at[38].set(1.0)  # 1 m ahead
    _, there = find_ball(pose, scan, scan)
    assert not bool(there)
    others = find_others(pose, scan)
    np.testing.assert_allclose(others, scan)
    board = jnp.full(76, SCANNER_RANGE).at[38].set(GOAL_LINE)
    assert float(find_others(pose.at[1].set(1.0), board).min()) == SCANNER_RANGE


def test_a_robot_that_nods_does_not_take_floor_or_robots_for_a_ball():
    """By 3 degrees: the lower beam meets the floor 2.1 m ahead; the other way the upper one misses covers."""
    floor = jnp.full(76, SCANNER_RANGE).at[38].set(LOWER_SCANNER_HEIGHT / math.tan(0.0524))
    high = jnp.full(76, SCANNER_RANGE)
    assert not bool(find_ball(jnp.array([0, 0, 0.2, 0, 0.0524, 0]), floor, high)[1])
    robot = jnp.full(76, SCANNER_RANGE).at[38].set(1.5)
    assert UPPER_SCANNER_HEIGHT + 1.5 * math.sin(0.0524) > COVER[1]
    assert not bool(find_ball(jnp.array([0, 0, 0.2, 0, -0.0524, 0]), robot, high)[1])


def test_mates_believe_who_saw_the_ball_later():
    belief = initial_belief(4)
    belief = belief.replace(
        pose=jnp.arange(12.0).reshape(4, 3),
        ball=jnp.array([(1.0, 2.0), (3.0, 4.0), (5.0, 6.0), (0.0, 0.0)]),
        ball_time=jnp.array([1.0, 2.0, 3.0, NEVER]),
    )
    said = compose_messages(belief, np.arange(4) == np.array([1, 0, 3, 2])[:, None])
    assert said.payload.shape == (4, NUMBERS)
    mail = empty_inboxes(MAIL_SETTINGS, 4).replace(count=jnp.ones(4, jnp.int32), time=jnp.full((4, 2), 3.5))
    mail = mail.replace(payload=mail.payload.at[:, 0].set(said.payload[np.array([1, 0, 3, 2])]))
    heard = update_from_mail(belief, mail)
    np.testing.assert_allclose(heard.ball, [(3, 4), (3, 4), (5, 6), (5, 6)])
    np.testing.assert_allclose(heard.ball_time, [2, 2, 3, 3])
    np.testing.assert_allclose(heard.mate_pose[0], belief.pose[1])
    np.testing.assert_allclose(heard.mate_time, 3.5)
    silent = update_from_mail(belief, empty_inboxes(MAIL_SETTINGS, 4))
    np.testing.assert_array_equal(silent.ball, belief.ball)


def test_only_a_ball_that_a_scanner_meets_is_seen(view):
    """All four look away from it, to their right; then the first one does not."""

    @jax.jit
    def sees(here):
        _, readings = observe(here.scene, here.world, here.physics)
        here = here.replace(readings=readings)
        memory = TASK.start(here, jax.random.key(0))
        return TASK.observe(here, memory)[0]

    away = [(2.2 - 0.6 * i, -1.6 + 0.1 * i, 0.202, 0.0, 0.0, -1.2) for i in range(4)]
    balls = ((0.6, 0.9), (1.0, 0.4))
    seen = [np.asarray(sees(with_ball(placed(view, *away), *ball))) for ball in balls]
    np.testing.assert_array_equal(seen[0], seen[1])
    turned = [(*away[0][:5], 2.2), *away[1:]]
    found = [np.asarray(sees(with_ball(placed(view, *turned), *ball))) for ball in balls]
    np.testing.assert_array_equal(found[0][1:], found[1][1:])
    for rows, ball in zip(found, balls, strict=True):
        x, y = 3.0 * rows[0, 8:10]
        cos, sin = math.cos(2.2), math.sin(2.2)
        place = (2.2 + x * cos - y * sin, -1.6 + x * sin + y * cos)
        far = math.dist(ball, turned[0][:2])
        assert math.dist(place, ball) < far * (BETWEEN_BEAMS + 0.01) + 0.01, "1 % of noise"


def test_settings_that_are_no_game():
    with pytest.raises(
        UsageError, match="opponent is 'chess', expected one of self, baseline, random, still"
    ):
        Soccer(opponent="chess").robots  # noqa: B018 - it raises
    with pytest.raises(UsageError, match="expected one loose object"):
        Soccer(arena=replace(SOCCER_FIELD, loose=())).scene()


# Hand-written play, and games.


def seen(place, yaw, ball, mate=(-2.0, 0.0), others=()):
    """What blue's first robot observes there, of a ball at rest; others at angles [rad] and distances [m]."""
    belief = initial_belief(4).replace(
        pose=jnp.zeros((4, 3)).at[0].set(jnp.array([*place, yaw])),
        ball=jnp.zeros((4, 2)).at[0].set(jnp.array(ball)),
        ball_time=jnp.zeros(4),
        mate_pose=jnp.zeros((4, 3)).at[0, :2].set(jnp.array(mate)),
        mate_time=jnp.zeros(4),
    )
    for angle, far in others:
        beam = int(np.argmin(np.abs(beams() - angle)))
        belief = belief.replace(others=belief.others.at[0, beam].set(far))
    memory = SoccerMemory(belief=belief, potential=jnp.zeros(()), score=jnp.zeros(()), step=jnp.int32(10))
    return TASK.observations(SimpleNamespace(time=0.0), memory)[0]  # all that it asks a view for


def test_behind_the_ball_it_drives_straight_on():
    np.testing.assert_allclose(soccer_action(seen((-0.4, 0.0), 0.0, (0.0, 0.0))), 1.0, atol=1e-3)


def test_before_the_ball_it_goes_round_it_on_its_side():
    """It looks at the ball from yellow's half and stands to the left of that line as it sees it."""
    left, right = soccer_action(seen((0.8, -0.1), math.pi, (0.0, 0.0)))
    assert float(right) > float(left) + 0.2


def test_the_one_farther_from_the_ball_keeps_goal_and_looks_at_it():
    post = (-GOAL_LINE + 0.45, 0.0)
    away = seen(post, 0.0, (0.5, 0.0), mate=(0.0, 0.0))
    np.testing.assert_allclose(soccer_action(away), 0.0, atol=0.01)
    turned = soccer_action(seen(post, 0.5, (0.5, 0.0), mate=(0.0, 0.0)))
    assert float(turned[0]) > 0 > float(turned[1])


def test_it_goes_round_others():
    free = soccer_action(seen((-2.0, 0.0), 0.0, (0.0, 0.0), mate=(-2.6, 0.0)))
    assert abs(float(free[0] - free[1])) < 0.05
    barred = soccer_action(seen((-2.0, 0.0), 0.0, (0.0, 0.0), mate=(-2.6, 0.0), others=[(0.0, 0.6)]))
    assert abs(float(barred[0] - barred[1])) > 0.3


@pytest.fixture(scope="module")
def env():
    return usarmjx.make("soccer-v1", worlds=4, engine="c", episode_steps=130)


@pytest.mark.thorough
def test_a_robot_pushes_the_ball_into_the_goal(env):
    """It drives straight on for 1.5 m; the ball rolls on, and the episode ends. Rewards add up."""
    state, scene = env.reset(0), env.scene
    qpos = np.array(env.batch.physics(state.batch).qpos)
    places = [(1.0, 0.0), (-2.0, 1.2), (-2.0, -1.2), (-1.0, -1.2)]
    for address, place in zip(scene.groups[0].root_qposadr, places, strict=True):
        qpos[:, address[:2]], qpos[:, address[3:]] = place, (1.0, 0.0, 0.0, 0.0)
    qpos[:, scene.loose_geoms.root_qposadr[0, :2]] = 1.5, 0.0
    everywhere = jnp.ones(env.worlds, bool)
    physics = env.batch.engine.reset(state.batch.physics, everywhere, jnp.asarray(qpos))
    state = state.replace(batch=state.batch.replace(physics=physics))
    go, rewards, before = jnp.zeros((4, 4, 2)).at[:, 0].set(1.0), 0.0, float(state.memory.potential[0])
    while not bool(state.done[0]):
        state = env.step(state, (go,))
        rewards = rewards + np.asarray(state.reward[0][0])
    assert not bool(state.truncated[0])
    assert float(state.final_score[0]) == float(state.metrics["goals"][0]) == 1.0
    # At the end the ball is in the goal, and the robot that pushed it is the nearest one to it.
    ends = [stands((x, 0.0), ((x - far, 0.0),), ((-1.0, -1.2),)) for x, far in ((2.81, 0.9), (2.89, 0.33))]
    low, high = (5.0 + end - before for end in sorted(ends))
    assert low - 0.05 < float(rewards[0]) < high + 0.05
    np.testing.assert_allclose(rewards, float(rewards[0]) * SIDES, atol=1e-4)


@pytest.mark.thorough
def test_the_baseline_scores_against_robots_that_stand(env):
    """Games of 13 s, yellow does nothing: goals for blue, and none against it.

    About a third of such games ends with a goal, and a rounding decides which: at 5 of 16, fewer than two
    goals have a probability of 2 %.
    """
    policy = BASELINES.get("soccer")(env)
    blue = jnp.array([1.0, 1.0, 0.0, 0.0])[:, None]
    alone = Policy(
        initial_carry=policy.initial_carry,
        act=lambda memory, obs, key: ((), (blue * policy.act((), obs, key)[1][0],)),
    )
    played = run_episodes(env, alone, 16)
    assert played.bad == 0
    assert played.scores.min() >= 0.0
    assert played.scores.sum() >= 2.0


@pytest.mark.thorough
def test_goals_are_possible_on_planar():
    """The baseline against robots that stand: 0.39 goals an episode (25 of 64), none against it.

    At that, fewer than 5 in 32 have a probability of 0.2 %.
    """
    env = usarmjx.make("soccer-v2", worlds=32, engine="planar", physics="coarse", opponent="still")
    played = run_episodes(env, BASELINES.get("soccer")(env), 32)
    assert (played.bad, played.scores.min()) == (0, 0.0)
    assert played.scores.sum() >= 5


def test_yellow_plays_by_hand_or_stands_if_asked_to():
    by_hand = Soccer(opponent="baseline")
    view = view_of(by_hand)
    assert [len(team.slots) for team in view.scene.groups] == [2, 2]
    assert by_hand.agent_groups(view.scene) == (0,)
    zero = jnp.zeros(())
    memory = SoccerMemory(belief=initial_belief(4), potential=zero, score=zero, step=jnp.zeros((), jnp.int32))
    wheel = view.scene.groups[0].robot.wheel_radius
    actions = by_hand.act(view, memory, (jnp.ones((2, 2)),))
    np.testing.assert_allclose(actions.drive[0]["Left"], 1.0 / wheel)
    told = [soccer_action(rows)[1] for rows in by_hand.observations(view, memory)[2:]]
    np.testing.assert_allclose(actions.drive[1]["Right"], np.array(told) / wheel, atol=1e-5)
    assert np.abs(told).max() > 0
    drawn = Soccer(opponent="random").act(view, memory, (jnp.ones((2, 2)),)).drive[1]
    assert len({*map(float, (*drawn["Left"], *drawn["Right"]))}) == 4
    still = Soccer(opponent="still").act(view, memory, (jnp.ones((2, 2)),))
    np.testing.assert_array_equal(still.drive[1]["Right"], 0.0)


def test_the_baseline_is_for_soccer():
    with pytest.raises(UsageError, match="plays soccer, not chess"):
        BASELINES.get("soccer")(SimpleNamespace(task=None, name="chess"))
