"""The examples that walk and wave, against a served world: what the robots do is read off the physics."""

import contextlib
import math
import socket
from functools import partial
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.scripts import load
from tests.server.peers import PATIENCE, serving
from usarmjx.models.compile.kinematic_tree import forward_kinematics
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.server.worlds.dynamic_world import DynamicWorld

FACTOR = 0.5
"""Simulated seconds per second by the clock of a client, which has to guess them."""
LEANING = math.radians(30)  # a robot that leans more than this is about to fall
STANDING = math.radians(3)  # an arm of 0.5 kg, moved by 7 kg that stand on stiff servos
TRUTH_ATOL = 0.06  # m: GroundTruth has two decimals, and it takes a step or two to stand still again
HAND = 0.11  # m from the elbow to the end of the forearm


client = load("usarsim_client")
ers_walk = load("ers_walk")
qrio_wave = load("qrio_wave")


class Watched(client.UsarsimClient):
    """A client that notes the robot's true state whenever it sends joints somewhere."""

    def __init__(self, world, port):
        super().__init__("127.0.0.1", port, timeout=PATIENCE)
        self.world, self.states = world, []

    def multidrive(self, joints):
        self.note()
        super().multidrive(joints)

    def note(self):
        self.states.append(self.world.state(self.world.robots[0]))

    def poses(self, part):
        """Positions (states, 3) and orientations (states, 3, 3) of a part, from first to last."""
        plan = self.world.robots[0].plan
        bodies = jax.vmap(partial(forward_kinematics, plan))(
            jax.tree.map(lambda *rows: np.stack(rows), *self.states)
        )
        place = plan.parts.index(part)
        return np.array(bodies.pos[:, place]), np.array(bodies.mat[:, place])


@contextlib.contextmanager
def robot_of(name):
    """A connected client whose robot of that class stands on a flat floor."""
    world = DynamicWorld(FLAT, Physics(), 2, max_robots=1)
    world.prepare(ROBOTS.get(name))
    with serving(world) as (port, _), Watched(world, port) as robot:
        _, place, turn = robot.start_poses()[0]
        robot.init(f"USARBot.{name}", "It", place, turn)
        yield robot


def test_ers_walks_a_metre_and_stays_upright(monkeypatch):
    with robot_of("ERS") as robot:
        # By the clock of a busy machine the world's pace would not be even.
        even = SimpleNamespace(monotonic=lambda: robot.world.time / FACTOR)
        monkeypatch.setattr(ers_walk, "time", even)
        robot.note()
        trip = ers_walk.walk(robot, 1.0, 40.0)
        robot.note()
        pos, mat = robot.poses("HARD")
    assert trip.distance >= 1.0
    assert pos[-1, 0] - pos[0, 0] == pytest.approx(trip.distance, abs=TRUTH_ATOL)
    assert abs(pos[-1, 1] - pos[0, 1]) < 0.3, "its heading is corrected"
    assert trip.distance / trip.seconds > 0.05
    assert mat[:, 2, 2].min() > math.cos(LEANING)
    assert trip.lean < LEANING


def test_qrio_waves_and_still_stands():
    waves = 2
    with robot_of("QRIO") as robot:
        robot.note()
        lean = qrio_wave.wave(robot, waves)
        robot.note()
        pos, mat = robot.poses("HARD")
        elbow, forearm = robot.poses("RightElbow")
        head, _ = robot.poses("HeadTilt")
    hand = elbow - HAND * forearm[:, :, 2]
    up = hand[:, 2] > head[:, 2]
    sideways = hand[up, 1] - hand[up, 1].mean()
    assert np.ptp(sideways) > 0.1
    turns = np.flatnonzero(np.diff(np.sign(np.diff(sideways))))
    assert len(turns) >= 2 * waves - 1, "there and back, as often as it waves"
    assert not up[0]
    assert not up[-1], "the arm is down again"
    assert np.linalg.norm(pos[-1] - pos[0]) < 0.01
    assert mat[:, 2, 2].min() > math.cos(STANDING)
    assert lean < STANDING


def test_joints_travel_in_one_multidrive():
    here, there = socket.socketpair()
    with here, there:
        robot = client.UsarsimClient.__new__(client.UsarsimClient)
        robot._socket = here
        robot.multidrive({"FRFlipper": -1.0, "FLFlipper": 0.5})
        assert there.recv(100) == b"MULTIDRIVE {FRFlipper -1.0000} {FLFlipper 0.5000}\r\n"
