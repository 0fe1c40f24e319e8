"""A served world whose robots a policy drives, and clients that take some of them over."""

import asyncio
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

from tests.scripts import load
from tests.server.peers import PATIENCE, serving
from usarmjx.base.errors import UsageError
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MessageSettings, OutgoingMessages
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.services import RosRobots
from usarmjx.server.rosbridge.topics import TWIST, WorldTopics
from usarmjx.server.viewing.controls import PageRobots
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds import policy_world
from usarmjx.server.worlds.batch_world import InstanceSwitch
from usarmjx.server.worlds.policy_world import PolicyBatch, PolicyFollower, PolicyWorld, newest, wait_for_run
from usarmjx.sim.control import CommandUpdate
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy, StepResult, Task, TeamMaps
from usarmjx.train.tasks.soccer import Soccer
from usarmjx.train.tasks.team import TeamTask
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX

P2AT = ROBOTS.get("P2AT")
LEVEL = (0.0, 0.0, 0.0)
SHARE = 0.4
SPEED = SHARE * P2AT.drive.full_scale["Left"] * P2AT.wheel_radius
STEPS = 5
"""Actions until the task begins anew."""


@dataclass(frozen=True, kw_only=True)
class Roll(Task):
    """Two robots; what counts is the number of the action."""

    @property
    def robots(self):
        return ("P2AT", "P2AT")

    def start(self, view, key):
        return jnp.zeros(())

    def observe(self, view, memory):
        return (view.sensor(0, "GroundTruth"),)

    def maps(self, scene, memory):
        squares = jnp.full((2, 4, 3), memory).at[1].add(10)
        return TeamMaps(low=(1.0, -2.0), cell=0.3, squares=squares)

    def evaluate(self, view, memory):
        return StepResult(memory + 1, (jnp.zeros(2),), jnp.zeros((), bool), memory + 1, {})


@dataclass(frozen=True, kw_only=True)
class Remember(Roll):
    """Robots are driven by what the task remembers of the actions, which is their mean."""

    decides: ClassVar[bool] = True

    def decide(self, view, memory, actions):
        return actions[0].mean()

    def act(self, view, memory, actions):
        return super().act(view, memory, tuple(jnp.full_like(one, memory) for one in actions))

    def evaluate(self, view, memory):
        return StepResult(memory, (jnp.zeros(2),), jnp.zeros((), bool), memory, {})


@dataclass(frozen=True, kw_only=True)
class Report(Roll):
    """Each robot tells the other its number by radio; the memory is who was heard after the last action."""

    def start(self, view, key):
        return jnp.zeros(2)

    def act(self, view, memory, actions):
        numbers = jnp.arange(2.0)[:, None] + 1
        others, size = ~jnp.eye(2, dtype=bool), jnp.full(2, 4)
        messages = OutgoingMessages(receivers=others, payload=numbers, size_bytes=size)
        return replace(super().act(view, memory, actions), messages=messages)

    def evaluate(self, view, memory):
        heard = jnp.where(view.world.mail.count > 0, view.world.mail.payload[:, 0, 0], 0.0)
        return StepResult(heard, (jnp.zeros(2),), jnp.zeros((), bool), heard.sum(), {})


@dataclass(frozen=True, kw_only=True)
class ReportItself(Report):
    """The same, whoever drives."""

    reports_itself: ClassVar[bool] = True


@pytest.fixture(scope="module")
def compiled():
    """Both robots of both worlds are driven straight on; the policy's memory counts its actions."""
    task = Roll(
        sensors=("GroundTruth",),
        physics=Physics(timestep=0.01, substeps=5),
        repeat=4,
        episode_steps=STEPS,
    )
    policy = Policy(
        initial_carry=lambda worlds: jnp.zeros(worlds),
        act=lambda memory, obs, key: (memory + 1, (jnp.full((*obs[0].shape[:2], 2), SHARE),)),
    )
    world = PolicyWorld(PolicyBatch(Env(task, 2, engine="c", seed=3), policy))
    world.warm_up()
    return world


@pytest.fixture
def world(compiled):
    yield compiled
    for robot in list(compiled.robots.values()):
        compiled.remove(robot)
    run(compiled, 1.0)


def run(world, seconds):
    for _ in range(round(seconds / world.period)):
        world.step()


def places(world):
    """Positions of all robots (worlds, robots, 2)."""
    qpos = np.asarray(world._batch.physics(world._state).qpos)
    return qpos[:, world._batch.scene.groups[0].root_qposadr[:, :2]]


def went(world, seconds):
    """How far each robot goes in that time (worlds, robots)."""
    before = places(world)
    run(world, seconds)
    return np.linalg.norm(places(world) - before, axis=-1)


def test_the_policy_drives_all_robots_of_all_worlds(world):
    run(world, 1.0)
    np.testing.assert_allclose(went(world, 1.0), SPEED, rtol=0.05)  # wheels slip a little


def test_a_task_that_decides_remembers_the_actions_of_the_policy():
    """One wheel's share is 0 and the other's twice that of the mean, which drives both."""
    task = Remember(
        sensors=("GroundTruth",), physics=Physics(timestep=0.01, substeps=5), repeat=4, episode_steps=STEPS
    )
    policy = Policy(
        initial_carry=lambda worlds: jnp.zeros(worlds),
        act=lambda memory, obs, key: (
            memory,
            (jnp.broadcast_to(jnp.array([0.0, 2 * SHARE]), (*obs[0].shape[:2], 2)),),
        ),
    )
    world = PolicyWorld(PolicyBatch(Env(task, 2, engine="c", seed=3), policy))
    run(world, 1.0)
    np.testing.assert_allclose(went(world, 1.0), SPEED, rtol=0.05)  # wheels slip a little
    assert world.score == pytest.approx(SHARE)


@pytest.mark.parametrize(("kind", "heard"), [(ReportItself, [2.0, 1.0]), (Report, [0.0, 1.0])])
def test_a_robot_that_a_client_drives_reports_if_the_task_does_not_let_the_policy_speak(kind, heard):
    task = kind(
        sensors=("GroundTruth",),
        physics=Physics(timestep=0.01, substeps=5),
        repeat=4,
        radio=RadioSettings(),
        mail=MessageSettings(numbers=1, capacity=1, bytes_per_step=4),
    )
    policy = Policy(
        initial_carry=jnp.zeros, act=lambda memory, obs, key: (memory, (jnp.zeros((*obs[0].shape[:2], 2)),))
    )
    world = PolicyWorld(PolicyBatch(Env(task, 1, engine="c"), policy))
    world.warm_up()
    run(world, 1.0)
    assert world.policy_batch.task_memory(0).tolist() == [2.0, 1.0]
    # The robot of slot 1: what slot 0 hears is its number, 2.
    name = next(name for name, slot in world.agents().items() if slot == 1)
    world.spawn(P2AT, name, LEVEL, LEVEL)
    run(world, 1.0)
    assert world.policy_batch.task_memory(0).tolist() == heard
    assert world.score == sum(heard)


def test_teams_report_whoever_drives():
    assert TeamTask.reports_itself
    assert Soccer.reports_itself
    assert not Task.reports_itself


def test_a_robot_is_taken_over_by_its_name_where_it_is_and_given_back(world):
    run(world, 1.0)
    before = places(world)[0, 1]
    robot = world.spawn(P2AT, "p2at1", (90.0, 90.0, 1.0), LEVEL)
    assert robot.slot == 1
    run(world, 1.0)
    assert np.linalg.norm(places(world)[0, 1] - before) < 0.1, "it brakes"
    way = went(world, 1.0)
    assert way[0, 1] < 0.01
    np.testing.assert_allclose(way[[0, 1, 1], [0, 0, 1]], SPEED, rtol=0.05)
    world.remove(robot)
    run(world, 0.6)
    np.testing.assert_allclose(went(world, 1.0)[0, 1], SPEED, rtol=0.05)


def test_the_page_takes_a_robot_over_from_the_policy_and_gives_it_back(world):
    robots = PageRobots(BotServer(world, BotServerSettings(port=0)))
    assert robots.drivers() == {0: "policy", 1: "policy"}
    with pytest.raises(UsageError, match="take it over first"):
        robots.drive(1, {"Left": 0.0, "Right": 0.0})
    robots.take_over(1)
    assert robots.drivers() == {0: "policy", 1: "page"}
    run(world, 1.0)
    assert went(world, 1.0)[0, 1] < 0.01
    robots.drive(1, {"Left": 2.0, "Right": 2.0})
    assert went(world, 0.4)[0, 1] > 0.05
    robots.give_back(1)
    assert robots.drivers() == {0: "policy", 1: "policy"}
    assert world.robots == {}
    run(world, 0.6)
    np.testing.assert_allclose(went(world, 1.0)[0, 1], SPEED, rtol=0.05)


def test_a_reset_begins_the_task_anew_in_that_world_alone(world):
    """The robots are where the episode has them; a client keeps its own, which forgets what it was told."""
    robot = world.spawn(P2AT, "P2AT1", (0.0, 0.0, 1.0), LEVEL)
    world.update_command(robot, CommandUpdate(drive={"Left": 3.0, "Right": 3.0}))
    run(world, 1.0)
    world.prepare_reset()
    before = places(world)
    world.reset()
    after = places(world)
    np.testing.assert_array_equal(after[1], before[1])
    starts = np.array([start.at[:2] for start in world.arena.starts])
    assert (np.linalg.norm(after[0, :, None] - starts, axis=-1).min(-1) < 1e-3).all()
    assert world.robots == {1: robot}
    assert not np.asarray(robot.command.setpoint).any()
    run(world, 0.6)
    way = went(world, 1.0)
    assert way[0, 1] < 0.01
    np.testing.assert_allclose(way[[0, 1], 0], SPEED, rtol=0.05)
    assert world.recovery_log.resets == 0


def test_two_served_worlds_share_the_policy_and_a_claim_is_one_worlds(world):
    other = PolicyWorld(world.policy_batch, 1)
    robot = other.spawn(P2AT, "P2AT0", (0.0, 0.0, 1.0), LEVEL)
    for _ in range(50):
        world.step()
        other.step()
    assert world._steps == other._steps == world.policy_batch.steps
    way = went(world, 1.0)
    assert way[1, 0] < 0.01
    np.testing.assert_allclose(way[[0, 0, 1], [0, 1, 1]], SPEED, rtol=0.05)
    assert robot.pending
    other.remove(robot)
    world.policy_batch.served.remove(other)


def test_another_world_can_be_served_and_clients_take_over_the_same_robot_there(world, capsys):
    robot = world.spawn(P2AT, "P2AT1", (0.0, 0.0, 1.0), LEVEL)
    switch = InstanceSwitch(world, 2)
    switch.select("1")
    assert capsys.readouterr().out == "usarmjx: world 1 is served now\n"
    assert world.robots == {1: robot}
    run(world, 1.0)
    way = went(world, 1.0)
    assert way[1, 1] < 0.01, "the client has it here"
    np.testing.assert_allclose(way[[0, 0, 1], [0, 1, 0]], SPEED, rtol=0.05)
    np.testing.assert_allclose(world.state(robot).pos[:2], places(world)[1, 1], atol=1e-6)
    switch.select("0")
    world.remove(robot)


@pytest.mark.parametrize(("line", "why"), [("2", "worlds 0 to 1"), ("x", "'x' is not the number of a world")])
def test_a_number_that_is_no_worlds_changes_nothing(world, caplog, line, why):
    robot = world.spawn(P2AT, "P2AT1", (0.0, 0.0, 1.0), LEVEL)
    InstanceSwitch(world, 2).select(line)
    assert why in caplog.text
    assert world.robots == {1: robot}
    assert world._instance == 0


def test_any_other_name_gets_the_first_free_robot_where_it_wants(world):
    first = world.spawn(P2AT, "Ann", (20.0, -5.0, 0.3), LEVEL)
    run(world, 1.0)
    np.testing.assert_allclose(places(world)[0, first.slot], [20.0, -5.0], atol=0.02)
    second = world.spawn(P2AT, "Bob", (20.0, 5.0, 0.3), LEVEL)
    assert {first.slot, second.slot} == {0, 1}
    with pytest.raises(UsageError, match="no P2AT left to take over; the robots here: P2AT0, P2AT1"):
        world.spawn(P2AT, "Eve", (0.0, 0.0, 0.3), LEVEL)


def test_a_robot_that_is_taken_or_of_another_class_is_refused(world):
    world.spawn(P2AT, "P2AT0", (0.0, 0.0, 0.3), LEVEL)
    with pytest.raises(UsageError, match="P2AT0 is taken"):
        world.spawn(P2AT, "P2AT0", (0.0, 0.0, 0.3), LEVEL)
    with pytest.raises(UsageError, match="P2AT1 is a P2AT, not a P2DX"):
        world.spawn(ROBOTS.get("P2DX"), "P2AT1", (0.0, 0.0, 0.3), LEVEL)


def test_clients_are_told_what_was_measured_for_the_last_action(world):
    robot = world.spawn(P2AT, "P2AT0", (0.0, 0.0, 0.3), LEVEL)
    readings = 0
    for _ in range(20):
        world.step()
        truth = robot.pending.pop(0, None)
        if truth is not None:
            readings += 1
            np.testing.assert_allclose(truth[:3], world.state(robot).pos, atol=1e-5)
    assert readings == 20 / 4


def test_a_client_finds_every_sensor_of_its_class(world):
    """The task reads GroundTruth alone; noise of the INS is 0.01 m, and the empty floor gives no echo."""
    world.prepare(P2AT)
    robot = world.spawn(P2AT, "P2AT0", (0.0, 0.0, 0.3), LEVEL)
    kinds = [sensor.kind for sensor in robot.suite.sensors]
    assert sorted(kinds) == sorted({mount.kind for mount in P2AT.sensors})
    assert {mount.name for mount in robot.spec.sensors} == {mount.name for mount in P2AT.sensors}
    read, odometry_item, start = {}, kinds.index("Odometry"), places(world)[0, 0]
    for _ in range(20):
        world.step()
        world.observe([robot])
        read |= robot.pending
    assert set(read) == set(range(len(kinds)))
    truth, odometry = read[kinds.index("GroundTruth")], read[odometry_item]
    way = np.linalg.norm(places(world)[0, 0] - start)
    assert odometry[0] == pytest.approx(way, abs=0.03), "it begins with its client, and brakes"
    np.testing.assert_allclose(read[kinds.index("INS")][:3], truth[:3], atol=0.1)
    scan = read[kinds.index("RangeScanner")]
    assert len(scan) == 181
    assert scan.min() > 1.0, "nothing but the other robot is near"
    assert len(read[kinds.index("Sonar")]) == 16
    ins = kinds.index("INS")
    assert world.operate_sensor(robot, ins, "POSE", (7.0, 8.0, 0.0, 0.0, 0.0, 0.0))
    robot.pending.clear()
    for _ in range(20):
        world.step()
        world.observe([robot])
    np.testing.assert_allclose(robot.pending[ins][:2], [7.0, 8.0], atol=0.1)
    world.prepare_reset()
    world.reset()
    robot.pending.clear()
    for _ in range(20):
        world.step()
        world.observe([robot])
    assert set(robot.pending) == set(range(len(kinds))), "they begin anew with the world"


def test_maps_that_the_tasks_robots_build_are_shown(world):
    run(world, 2.0)
    source = ServedSource([world])
    extra = source.frame(0).extra
    names = [robot.name for robot in source.drawing(0).robots.values()]
    assert sorted(extra) == sorted([MAP_GRID, *(f"{MAP_PREFIX}{name}" for name in names)])
    assert np.allclose(extra[MAP_GRID], (1.0, -2.0, 0.3))
    first, second = (extra[f"{MAP_PREFIX}{name}"] for name in names)
    assert (first == world.score % STEPS).all()  # Roll scores its actions, and begins anew
    assert (second == first + 10).all()
    run(world, 4 * world.period)
    after = source.frame(0).extra[f"{MAP_PREFIX}{names[0]}"]
    assert (after == world.score % STEPS).all()
    assert not np.array_equal(after, first)


def test_ros_sees_the_robots_that_the_policy_drives_and_does_not_drive_them(world):
    topics, crew = WorldTopics(world, (32, 24)), RosRobots(BotServer(world, BotServerSettings(port=0)), "ros")
    run(world, 1.0)
    there = topics.all()
    assert {f"/P2AT{n}/{name}" for n in (0, 1) for name in ("odom", "joint_states", "cmd_vel")} <= set(there)
    pose = there["/P2AT1/odom"].make(RosVersion.ROS2)["pose"]["pose"]["position"]
    np.testing.assert_allclose([pose["x"], pose["y"]], places(world)[0, 1], atol=1e-6)
    (truth,) = [name for name in there if name.startswith("/P2AT1/GroundTruth")]
    before = there[truth].revision()
    assert world.time - before < 4 * world.period + 1e-6  # it is of the last action
    run(world, 0.4)
    assert there[truth].revision() == pytest.approx(before + 0.4)
    frames = [one["child_frame_id"] for one in there["/tf"].make(RosVersion.ROS2)["transforms"]]
    assert {"P2AT0/base_link", "P2AT1/base_link"} <= set(frames)
    with pytest.raises(UsageError, match="a policy drives P2AT1: /simulator/spawn with that name takes it"):
        crew.command(there["/P2AT1/cmd_vel"].robot, TWIST, {"linear": {"x": 0.1}})
    robot = world.spawn(P2AT, "P2AT1", (0.0, 0.0, 1.0), LEVEL)
    taken = topics.all()
    assert set(taken) == set(there)
    assert taken["/P2AT1/cmd_vel"].robot is robot
    crew.command(robot, TWIST, {"linear": {"x": 0.1}})
    assert np.asarray(robot.command.setpoint).any()


def test_the_task_begins_anew_where_the_robots_are(world):
    scores, ways = [], []
    for _ in range(2 * STEPS):
        ways.append(went(world, 4 * world.period))
        scores.append(world.score)
    assert sorted(set(scores)) == list(range(1, STEPS + 1)), "the score counts the actions of each round"
    assert np.max(ways) < 1.1 * SPEED * 4 * world.period, "nobody is put elsewhere"


def test_a_protocol_client_sees_reports_and_drives(world):
    client = load("usarsim_client")
    with (
        serving(world) as (port, _),
        client.UsarsimClient(port=port, timeout=PATIENCE) as robot,
    ):
        robot.init("USARBot.P2AT", "P2AT1", (0.0, 0.0, 0.0))
        robot.drive(50.0, -50.0, normalized=True)
        yaws, times = [], []
        for message in robot:
            if message.kind == "STA":
                times.append(message.time())
            if message.value("Type") == "GroundTruth":
                yaws.append(message.pose()[2])
            if len(yaws) == 10:
                break
    np.testing.assert_allclose(np.diff(times), 0.2, atol=0.011)  # two decimals
    turns = np.unwrap(yaws)[1:] - np.unwrap(yaws)[:-1]
    assert turns[-3:].min() > 0.05, "clockwise, as left wheels forward turn"


def slower(share):
    """A policy that drives straight ahead at a share of what that of the tests does."""
    return Policy(
        initial_carry=lambda worlds: jnp.zeros(worlds),
        act=lambda memory, obs, key: (memory, (jnp.full((*obs[0].shape[:2], 2), share),)),
    )


def test_the_newest_checkpoint_of_a_run_drives(compiled, monkeypatch, tmp_path, caplog):
    caplog.set_level("INFO", "usarmjx")
    names = iter(["00001", "00001", "00002", "00002"])
    monkeypatch.setattr(policy_world, "newest", lambda run: next(names, "00002"))
    sources = iter([UsageError("gone already"), SimpleNamespace(policy=lambda env: slower(0.0))])

    def find(run, which):
        found = next(sources)
        if isinstance(found, UsageError):
            raise found
        return found

    monkeypatch.setattr(policy_world, "load_policy", find)

    async def serve():
        follower = PolicyFollower(compiled.policy_batch, tmp_path, interval=0.001)
        (line,) = await follower.start()
        assert line == f"the newest checkpoint of {tmp_path} drives"
        while "00002" not in caplog.text:
            await asyncio.sleep(0.001)
        follower.stop()

    run(compiled, 1.0)
    np.testing.assert_allclose(went(compiled, 1.0), SPEED, rtol=0.05)
    asyncio.run(serve())
    assert "gone already" in caplog.text, "a checkpoint that has been deleted disturbs nothing"
    run(compiled, 1.0)
    assert (went(compiled, 1.0) < 0.05).all()


def test_a_run_without_a_checkpoint_is_waited_for(monkeypatch, tmp_path):
    assert newest(tmp_path) is None
    looks = iter([None, None, "00001", "00002", "00002", "00003", "00003"])
    found = iter([UsageError("deleted for 00002"), "policy", UsageError("broken")])

    def find(run, which):
        assert (run, which) == (str(tmp_path), "last")
        if isinstance(one := next(found), UsageError):
            raise one
        return one

    monkeypatch.setattr(policy_world, "newest", lambda run: next(looks))
    monkeypatch.setattr(policy_world, "load_policy", find)
    assert wait_for_run(tmp_path, interval=0.001) == "policy"
    with pytest.raises(UsageError, match="broken"):
        wait_for_run(tmp_path, interval=0.001)
