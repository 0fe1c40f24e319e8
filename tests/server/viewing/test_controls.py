"""What somebody at the page may do to served worlds, without a page: worlds on engine c, a few sockets."""

import asyncio
import time

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.peers import PATIENCE, Peer, looping, wait_until
from usarmjx.base.errors import UsageError
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.runtime.loop import IDLE_PERIOD, MAX_STEPS, StepClock
from usarmjx.server.viewing import controls
from usarmjx.server.viewing import controls as controls_module
from usarmjx.server.viewing.controls import ServedControls
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry, build_scene

PLACE, YAW = (0.5, -1.0, 0.0), 1.0
AHEAD = {"Left": 5.0, "Right": 5.0}
INIT = "INIT {ClassName USARBot.P2DX} {Name C1} {Location 0,0,-0.2}"


class Served:
    """A world that is stepped by hand, and what may be done to it."""

    def __init__(self, world=None, **settings):
        self.world = world or DynamicWorld(FLAT, max_robots=3)
        self.clock = StepClock()
        self.server = BotServer(self.world, BotServerSettings(port=0, **settings))
        self.controls = ServedControls([self.server], self.clock)
        self.server.services.append(self.controls)

    def steps(self, count):
        async def run():
            for _ in range(count):
                self.server.tick(self.clock.takes_step())
                await asyncio.sleep(0)

        asyncio.run(run())

    def until(self, done):
        async def run():
            deadline = time.monotonic() + PATIENCE
            while not done() and time.monotonic() < deadline:
                self.server.tick(self.clock.takes_step())
                await asyncio.sleep(0.001)

        asyncio.run(run())
        assert done()

    def spawn(self, name="V1", pos=PLACE, robot="P2DX"):
        self.controls.spawn(0, robot, name, pos, YAW)
        self.until(lambda: name in self.names() or self.status.errors)
        return next((slot for slot, robot in self.world.robots.items() if robot.name == name), None)

    def names(self):
        return [robot.name for robot in self.world.robots.values()]

    @property
    def status(self):
        return self.controls.status(0)

    def place(self, slot):
        return np.array(self.world.state(self.world.robots[slot]).pos)


@pytest.fixture
def served():
    return Served()


# The clock


def test_worlds_that_stand_still_make_as_many_steps_as_they_are_told(served):
    served.controls.pause(True)
    served.steps(5)
    assert (served.world.time, served.status.paused) == (0.0, True)
    served.controls.step(3)
    served.steps(9)
    assert served.world.time == pytest.approx(3 * served.world.period)
    served.controls.pause(False)
    served.steps(2)
    assert served.world.time == pytest.approx(5 * served.world.period)


def test_the_speed_is_that_of_the_next_step():
    clock = StepClock(1.0)
    clock.wait(0.02, 100.0)
    assert clock.wait(0.02, 100.02) == pytest.approx(0.02)
    clock.set_factor(4.0)
    assert clock.wait(0.02, 101.0) == pytest.approx(0.005)
    clock.set_factor(0.0)
    assert clock.wait(0.02, 102.0) == 0.0
    clock.pause(True)
    assert clock.wait(0.02, 103.0) == IDLE_PERIOD, "who stands still does not spin"


def test_a_pause_is_no_lag(caplog):
    clock = StepClock(1.0)
    clock.wait(0.02, 100.0)
    clock.pause(True)
    clock.wait(0.02, 100.02)
    clock.pause(False)
    assert clock.wait(0.02, 200.0) == pytest.approx(0.02)
    assert not caplog.records


@pytest.mark.parametrize("factor", [-1.0, 1e9, float("nan"), float("inf")])
def test_no_clock_goes_like_that(served, factor):
    served.controls.set_speed(factor)
    assert "real-time factor" in served.status.last_error
    assert served.clock.factor == 1.0


@pytest.mark.parametrize("steps", [0, -1, MAX_STEPS + 1])
def test_so_many_steps_cannot_be_asked_for(steps):
    with pytest.raises(UsageError, match="1 to 1000"):
        StepClock().step(steps)


def test_clients_stay_while_the_world_stands_still(served):
    with looping([served.server], served.clock):
        peer = Peer(served.server.port, INIT)
        peer.sta_times(2)
        served.controls.pause(True)
        while served.clock.takes_step():
            pass
        time.sleep(3 * IDLE_PERIOD)
        still = served.world.time
        peer.say("GETCONF {Type Robot}")
        assert b"CONF" in peer.until(b"CONF"), "it is answered"
        assert served.world.time == still
        served.controls.step(30)
        assert peer.sta_times(2)[-1] <= still + 30 * served.world.period + 0.011
        served.controls.pause(False)
        assert peer.sta_times(5)
        peer.close()


# Robots of the page


def test_a_robot_appears_where_it_was_told_and_senses(served):
    slot = served.spawn()
    np.testing.assert_allclose(served.place(slot)[:2], PLACE[:2], atol=1e-3)
    assert served.status.drivers == {slot: "page"}
    served.steps(30)
    robot = served.world.robots[slot]
    sonar = [sensor.kind for sensor in robot.suite.sensors].index("Sonar")
    frame = ServedSource([served.world]).frame(0)
    assert (frame.robots[slot].readings[sonar] > 0.1).all(), "the page can show what it measures"
    assert robot.pending == {}, "what it reports is not kept"


@pytest.mark.parametrize(
    ("name", "robot", "pos", "reason"),
    [
        ("V 1", "P2DX", PLACE, "no spaces or braces"),
        ("x" * 41, "P2DX", PLACE, "up to 40 characters"),
        ("first", "P2DX", PLACE, "there is a robot first already"),
        ("V2", "Dalek", PLACE, "Dalek"),
        ("V2", "P2DX", (1e6, 0.0, 0.0), "out of reach"),
        ("V2", "P2DX", (float("nan"), 0.0, 0.0), "out of reach"),
    ],
)
def test_what_cannot_appear_says_why(served, name, robot, pos, reason):
    served.spawn("First")
    served.controls.spawn(0, robot, name, pos, YAW)
    served.until(lambda: served.status.errors)
    assert reason in served.status.last_error
    assert served.names() == ["First"]


def test_seats_count(served):
    for number in range(3):
        served.spawn(f"V{number}", (number, 0.0, 0.0))
    served.spawn("V3", (0.0, 2.0, 0.0))
    assert "no seat left" in served.status.last_error
    assert len(served.names()) == 3


def test_it_drives_and_stops_when_nobody_holds_it(served):
    slot = served.spawn()
    before = served.place(slot)
    served.controls.drive(0, slot, AHEAD)
    served.steps(40)
    assert np.linalg.norm(served.place(slot) - before) > 0.1
    time.sleep(controls.HOLD_TIME)
    served.steps(10)
    assert not np.asarray(served.world.robots[slot].command.setpoint).any()


def test_who_lets_go_stops_all(served):
    slot = served.spawn()
    served.controls.drive(0, slot, AHEAD)
    served.steps(5)
    assert np.asarray(served.world.robots[slot].command.setpoint).any()
    served.controls.release_all()
    served.steps(1)
    assert not np.asarray(served.world.robots[slot].command.setpoint).any()
    assert served.status.drivers == {slot: "page"}, "it is still the page's"


def test_joints_light_cameras_and_effecters_obey(served):
    slot = served.spawn(robot="Talon")
    robot = served.world.robots[slot]
    camera = robot.cameras[0]
    served.controls.set_joint(0, slot, "TalonArm_Link1", 0.3)
    served.controls.set_light(0, slot, True)
    served.controls.zoom(0, slot, camera.mount.name, camera.min_fov)
    served.controls.operate(0, slot, "Gripper", "Open", 1.0)
    served.steps(3)
    assert not served.status.errors, served.status.last_error
    index = robot.plan.joint_index("TalonArm_Link1")
    assert robot.command.target[index] == pytest.approx(0.3)
    assert robot.command.light
    assert robot.fovs[0] == pytest.approx(camera.min_fov)
    served.controls.set_joint(0, slot, "Trunk", 0.3)
    served.steps(1)
    assert served.status.last_error == "Talon has no joint 'Trunk'"


def test_it_goes_when_told(served):
    slot = served.spawn()
    served.controls.remove(0, slot)
    served.steps(1)
    assert served.names() == []
    assert served.server.guests == []
    served.controls.remove(0, slot)
    served.steps(1)
    assert "no robot" in served.status.last_error


# Robots of clients


def test_a_client_robot_obeys_its_client_unless_taken_over(served):
    with looping([served.server], served.clock):
        peer = Peer(served.server.port, INIT)
        peer.sta_times(1)
        (slot,) = served.world.robots
        robot = served.world.robots[slot]
        served.controls.drive(0, slot, AHEAD)
        wait_until(lambda: served.status.errors)
        assert served.status.last_error == "C1 has a driver: take it over first"
        assert not np.asarray(robot.command.setpoint).any()
        served.controls.take_over(0, slot)
        served.controls.drive(0, slot, AHEAD)
        wait_until(lambda: np.asarray(robot.command.setpoint).any())
        assert served.status.taken_over == {slot}
        peer.say("DRIVE {Left -1} {Right -1}")
        peer.sta_times(2)
        assert (np.asarray(robot.command.setpoint) >= 0).all(), "its client is not listened to"
        served.controls.take_over(0, slot, on=False)
        wait_until(lambda: served.status.drivers == {slot: "client"})
        peer.say("DRIVE {Left -1} {Right -1}")
        wait_until(lambda: (np.asarray(robot.command.setpoint) == -1).all())
        peer.close()


def test_a_client_robot_leaves_only_if_that_is_confirmed(served):
    with looping([served.server], served.clock):
        peer = Peer(served.server.port, INIT)
        peer.sta_times(1)
        (slot,) = served.world.robots
        served.controls.remove(0, slot)
        wait_until(lambda: served.status.errors)
        assert "leaves only if that is confirmed" in served.status.last_error
        assert served.names() == ["C1"]
        served.controls.remove(0, slot, any_owner=True)
        while peer.line():
            pass
        assert served.names() == []
        peer.close()


def test_init_with_its_name_takes_a_robot_over_from_the_page(served):
    with looping([served.server], served.clock):
        served.controls.spawn(0, "P2DX", "C1", PLACE, YAW)
        wait_until(lambda: served.names() == ["C1"])
        (slot,) = served.world.robots
        peer = Peer(served.server.port, INIT)  # its Location is elsewhere
        peer.sta_times(2)
        wait_until(lambda: served.status.drivers == {slot: "client"})
        np.testing.assert_allclose(served.place(slot)[:2], PLACE[:2], atol=0.02)
        assert served.server.guests == []
        peer.close()
        wait_until(lambda: served.names() == [])


# The queue


def test_what_waits_is_bounded_and_later_values_replace_earlier_ones(served):
    slot = served.spawn()
    for number in range(1000):
        served.controls.set_joint(0, slot, "CameraPanTilt_Link1", number / 1000)
    assert len(served.controls._requests) == 1
    for number in range(1000):
        served.controls.operate(0, slot, f"E{number}", "NOP")
    assert len(served.controls._requests) == controls_module.MAX_WAITING
    assert "requests wait already" in served.status.last_error
    served.steps(1)
    left = controls_module.MAX_WAITING - controls_module.MAX_AT_ONCE
    assert len(served.controls._requests) == left, "the rest waits for later steps"


def test_the_page_resets_the_world(served):
    slot = served.spawn()
    start = served.place(slot)
    served.controls.drive(0, slot, AHEAD)
    served.steps(40)
    assert np.linalg.norm(served.place(slot) - start) > 0.1
    served.controls.reset(0)
    served.until(lambda: served.world.one_world()[0].episode == 1)
    served.steps(20)
    np.testing.assert_allclose(served.place(slot)[:2], start[:2], atol=0.01)
    assert served.status.drivers == {slot: "page"}


def test_in_a_batch_robots_that_wait_parked_appear():
    scene = build_scene(FLAT, [RosterEntry(robot="ComStation", parked=True)])
    served = Served(BatchWorld(Batch(scene, 2, engine="c", seed=4), 1))
    slot = served.spawn(robot="ComStation")
    np.testing.assert_allclose(served.place(slot)[:2], PLACE[:2], atol=1e-3)
    served.controls.spawn(0, "ComStation", "V2", PLACE, YAW)
    served.until(lambda: served.status.errors)
    assert "no parked ComStation left" in served.status.last_error
    served.controls.remove(0, slot)
    served.steps(1)
    assert served.names() == []
