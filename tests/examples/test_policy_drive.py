"""The example that lets an exported policy drive over TCP."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.scripts import EXAMPLES, load, python_path
from tests.server.peers import serving
from tests.train.handmade import policy_file
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.shapes import OPAQUE
from usarmjx.server.gamebots.sensors import sensor_report
from usarmjx.server.protocol import grammar
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.task import drive_keys
from usarmjx.train.make import make

policy_drive = load("policy_drive")
parse_line = load("usarsim_client").parse_line

YELLOW = ARENAS.get("yellow")
HERE = {**os.environ, "PYTHONPATH": python_path(EXAMPLES.parent)}
"""The package is found by programs without being installed."""
HALF = 0.0051
"""Half the last of the two decimals that poses have on the wire [m or rad], and rounding."""


def wire_observation(env, state):
    """The observation of world 0 from the lines that a server would send of its readings."""
    (team,) = env.scene.groups
    last = state.batch.worlds.groups[0].memory.last
    driver = policy_drive.PolicyDriver.__new__(policy_drive.PolicyDriver)
    driver.kinds, driver.needs_ranges, driver.now = (env.task.pose, env.task.ranges[0]), True, 0.0
    driver.pose = driver.ranges = None
    for sensor, value in zip(team.suite.sensors, last, strict=True):
        report = sensor_report(sensor, np.asarray(value[0, 0]), 1.0)
        driver.take(parse_line(grammar.format_message(report)))
    goal = np.asarray(state.memory.goal[0]) * (1, -1)
    away = np.linalg.norm(goal - driver.pose[:2])
    return policy_drive.observation(driver.pose, goal, driver.ranges), away


@cache
def yellow(ranges):
    """An environment with some range sensors, compiled once; each material takes XLA a fifth longer."""
    physics = Physics(timestep=0.01, substeps=5)
    arena = replace(
        YELLOW, shapes=tuple(shape for shape in YELLOW.shapes if shape.material == OPAQUE), loose=()
    )
    return make("drive-to-goal", engine="c", arena=arena, ranges=(ranges,), physics=physics)


@pytest.mark.oracle
@pytest.mark.parametrize("ranges", ["Sonar", pytest.param("RangeScanner", marks=pytest.mark.thorough)])
def test_lines_give_the_observation_that_the_environment_gives(ranges):
    env = yellow(ranges)
    state, draw = env.reset(5), np.random.default_rng(1)
    for _ in range(4):
        seen, away = wire_observation(env, state)
        expected = np.asarray(state.obs[0][0, 0])
        assert seen.shape == expected.shape
        turned = HALF + 2**0.5 * HALF / away
        np.testing.assert_allclose(seen[:2], expected[:2], atol=turned)
        np.testing.assert_allclose(seen[2:4], expected[2:4], atol=2**0.5 * HALF)
        # Ranges have four decimals, cut: a share of 5 m.
        np.testing.assert_allclose(seen[4:], expected[4:], atol=1.01e-4 / 5)
        state = env.step(state, (np.float32(draw.uniform(-1, 1, (1, 1, 2))),))


def test_at_the_goal_there_is_no_bearing():
    seen = policy_drive.observation((1.0, 2.0, 0.5), (1.0, 2.0), [9.0] * 16)
    np.testing.assert_array_equal(seen, [0, 0, 0, 0, *[1] * 16])


def test_each_side_gets_its_own_share_of_an_action():
    told, side = {}, dict(zip(drive_keys(ROBOTS.get("P2AT")), (0.2, -0.7), strict=True))
    driver = policy_drive.PolicyDriver.__new__(policy_drive.PolicyDriver)
    driver.policy = SimpleNamespace(act=lambda *_: (np.array(list(side.values())), None))
    driver.robot = SimpleNamespace(drive=lambda left, right, **_: told.update(Left=left, Right=right))
    driver.group, driver.memory, driver.now = 0, None, 0.0
    driver.pose, driver.goal, driver.ranges = (0.0, 0.0, 0.0), (1.0, 0.0), [5.0] * 16
    driver.act()
    assert told == pytest.approx({key: 100 * share for key, share in side.items()})


def seconds_to_goal(*words):
    """How long the example takes for the 3 m to a goal on an empty floor [simulated s]."""
    world = DynamicWorld(FLAT, Physics(), 1, max_robots=16)
    world.prepare(ROBOTS.get("P2AT"))
    words = [*words, "--to", "2.0,2.0", "--start", "0.0,0.0,-0.3", "--seconds", "20"]
    with serving(world, realtime_factor=2.0) as (port, _):
        command = [sys.executable, str(EXAMPLES / "policy_drive.py"), *words, "--port", str(port)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=HERE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("there after")
    return float(done.stdout.split()[2])


def test_an_exported_policy_drives_a_robot_to_its_goal_over_tcp(tmp_path):
    """3 m at 0.7 m/s; the INS is wrong by a few centimetres by then, the robot stops within 0.5 m."""
    file = policy_file(tmp_path / "goal.npz", obs_size=20)
    assert 3.0 < seconds_to_goal(str(file)) < 15.0


@pytest.mark.slow
def test_the_baseline_drives_a_robot_to_its_goal_over_tcp():
    """Straight on, as nothing bars the way: 2.3 m at 0.9 m/s at most, after a turn."""
    assert 2.3 / 0.9 < seconds_to_goal("--baseline") < 15.0


def test_the_baseline_of_a_client_does_what_that_of_the_environment_does():
    """One robot in the yellow arena, the same observations to both; float32 rounding between programs."""
    env = yellow("Sonar")
    policy, state = BASELINES.get("drive-to-goal")(env), env.reset(5)
    client = policy_drive.Baseline("P2AT", "Sonar")
    assert client.groups[0]["obs_size"] == env.groups[0].obs_size
    ours, theirs = client.initial_carry(0), policy.initial_carry(1)
    for _ in range(3):
        action, ours = client.act(0, np.asarray(state.obs[0][0, 0]), ours)
        theirs, told = policy.act(theirs, state.obs, jax.random.key(0))
        np.testing.assert_allclose(action, told[0][0, 0], atol=1e-5)
        state = env.step(state, told)


def test_it_needs_no_jax():
    code = "import sys, policy_drive; print({'jax', 'mujoco'} & set(sys.modules))"
    paths = {**HERE, "PYTHONPATH": f"{HERE['PYTHONPATH']}{os.pathsep}{EXAMPLES}"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=paths)
    assert done.stdout == "set()\n", done.stderr


def test_what_is_no_policy_is_told_in_a_line(tmp_path):
    command = [sys.executable, str(EXAMPLES / "policy_drive.py"), str(tmp_path / "none.npz"), "--to", "1,1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=HERE)
    assert done.returncode == 1
    assert done.stderr.startswith("policy_drive: ")
    assert done.stderr.count("\n") == 1
