"""DM-Soccer: the manual's start poses, a field that robots fit on, a ball that rolls, into a goal too."""

import math

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from tests.starts import deepest
from tests.tours import ArenaRoute
from usarmjx.engines.base import check_features
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.soccer import (
    BALL_MASS,
    BALL_RADIUS,
    BALL_START,
    CARPET,
    GOAL_DEPTH,
    GOAL_WIDTH,
    LENGTH,
    SOCCER,
    WIDTH,
)
from usarmjx.models.compile.physics import Physics
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.scene import build_scene

DEEP = 0.002  # m
ROLLING = 5 / 7
"""Of a solid ball's speed that stays when it begins to roll."""
SINKING = 0.001  # m: soft contacts


def ball(rig):
    """Position and velocity of the ball (6,)."""
    joint = rig.data.joint("loose/Ball")
    return np.r_[joint.qpos[:3], joint.qvel[:3]]


def kick(rig, at, velocity):
    joint = rig.data.joint("loose/Ball")
    joint.qpos[:3] = (*at, BALL_RADIUS)
    joint.qvel[:2] = velocity


def test_start_poses_are_told_as_the_manual_has_them():
    """Manual 5.3.3; it gives BlueGoal some pitch and roll, which no start pose has here."""
    client = Client(DynamicWorld(ARENAS.get("soccer"), Physics(), 0, max_robots=1), "peer")
    client.session.data_to_send()
    (command,) = client.session.receive_data(b"GETSTARTPOSES\r\n")
    client.handle(command)
    line = client.session.data_to_send().decode()
    words = line.removeprefix("NFO {StartPoses 8} {").split()
    told = dict(zip(words[::3], words[1::3], strict=False))
    assert list(told)[:3] == ["BlueGoal", "MiddleField", "YellowGoal"]
    assert told["BlueGoal"] == "-2.55,-0.00,-0.19"
    assert told["MiddleField"] == "0.01,-0.00,-0.19"
    assert told["YellowGoal"] == "2.57,-0.01,-0.19"
    yaws = [float(words[3 * i + 2].split(",")[2].rstrip("}")) for i in range(3)]
    assert yaws == [-0.01, 0.0, 3.13]


def test_two_against_two_face_each_other():
    players = [start for start in SOCCER.starts[3:] if start.tag != "PlayerStart"]
    sides = {start.tag[:-1]: [] for start in players}
    for start in players:
        sides[start.tag[:-1]].append((start.at[0], math.cos(start.yaw)))
    assert set(sides) == {"Blue", "Yellow"}
    assert all(x < 0 and ahead > 0.99 for x, ahead in sides["Blue"])
    assert all(x > 0 and ahead < -0.99 for x, ahead in sides["Yellow"])
    assert [len(side) for side in sides.values()] == [2, 2]


def test_goals_are_open_to_the_field_and_lines_are_flat():
    (x0, x1), (y0, y1) = SOCCER.extent
    assert (x1 - x0, y1 - y0) > CARPET
    mouth = [
        shape
        for shape in SOCCER.shapes
        if shape.surface == "wall"
        and abs(shape.at[1]) - shape.size[1] < GOAL_WIDTH / 2 - 1e-9
        and abs(shape.at[0]) - shape.size[0] < LENGTH / 2 + GOAL_DEPTH - 1e-9
        and abs(shape.at[1]) + shape.size[1] < WIDTH / 2
    ]
    assert not mouth
    lines = [shape for shape in SOCCER.shapes if shape.surface == "fixture"]
    assert len(lines) == 24
    assert max(shape.at[2] + shape.size[2] for shape in lines) <= 0.002


@pytest.mark.parametrize("name", SOCCER.robots)
def test_starts_are_clear(name):
    assert max(deepest(SOCCER, name).values()) <= DEEP


def test_robots_with_wheels_legs_and_tracks_run_here_on_jax():
    """The ball is a sphere: it may not meet their cylinders."""
    for name in (*SOCCER.robots, "Talon", "Kurt2D", "ATRVJr"):
        check_features(build_scene(SOCCER, [name]).model, "jax")


@pytest.fixture
def field():
    return Rig("P2AT", arena=SOCCER, places=((-2.55, 1.2, 0.0),))


def test_the_ball_is_fifas_size_5():
    assert 0.68 <= 2 * math.pi * BALL_RADIUS <= 0.70
    assert 0.41 <= BALL_MASS <= 0.45


def test_a_kicked_ball_slides_into_rolling_and_then_keeps_its_speed(field):
    """A ball without spin rolls at 5/7 of its speed once friction has spun it (solid sphere)."""
    kick(field, (-2.0, -1.2), (1.4, 0.0))
    field.run(0.5)
    rolling = ball(field)[3]
    assert rolling == pytest.approx(1.4 * ROLLING, rel=0.01)
    start = ball(field)[0]
    field.run(3.0)
    now = ball(field)
    assert now[3] == pytest.approx(rolling, rel=0.005), "no resistance"
    assert now[0] - start == pytest.approx(3.0 * rolling, rel=0.005)
    assert now[2] == pytest.approx(BALL_RADIUS, abs=SINKING)


def test_the_ball_stays_on_the_field(field):
    """The boards take its speed: it comes back with less than a tenth."""
    kick(field, (1.5, 1.0), (2.0, 1.3))
    for _ in range(6):
        field.run(1.0)
        x, y, z = ball(field)[:3]
        assert abs(x) < CARPET[0] / 2
        assert abs(y) < CARPET[1] / 2
        assert z == pytest.approx(BALL_RADIUS, abs=0.01)
    assert np.hypot(*ball(field)[3:5]) < 0.2


def test_a_robot_dribbles_the_ball_over_the_goal_line():
    """The whole of the ball, within the goal; it comes back off the board, as nothing else stops it."""
    rig = Rig("P2AT", arena=SOCCER, places=((BALL_START[0] - 0.6, 0.0, 0.0),))
    assert ArenaRoute(rig).to([(2.2, 0.0)], speed=0.5)
    rig.tell(Left=0.0, Right=0.0)
    places = []
    for _ in range(100):
        rig.step()
        places.append(ball(rig)[:3])
    far = max(places, key=lambda place: place[0])
    assert LENGTH / 2 + BALL_RADIUS < far[0] < LENGTH / 2 + GOAL_DEPTH
    assert abs(far[1]) < GOAL_WIDTH / 2
    assert far[2] == pytest.approx(BALL_RADIUS, abs=0.01)
    assert rig.up[0] > 0.99


def test_wheels_pass_through_the_ball_and_hulls_do_not(field):
    """What the arena's text says; MuJoCo's own filter decides."""
    model, sphere = field.model, field.model.geom("loose/Ball/0").id
    ours = np.isin(model.geom_bodyid, field.indices[0].body_ids)
    meets = (model.geom_contype[sphere] & model.geom_conaffinity) | (
        model.geom_conaffinity[sphere] & model.geom_contype
    )
    round_ones = ours & (model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER)
    assert not meets[round_ones].any()
    assert meets[field.model.geom("r0/chassis/0").id]


def test_fast_balls_do_not_pass_the_boards(field):
    """6 m/s are 3 cm a step, less than the boards' 5 cm and the ball's radius."""
    kick(field, (0.0, -1.2), (6.0, 0.0))
    field.run(1.5)
    assert ball(field)[0] < CARPET[0] / 2
