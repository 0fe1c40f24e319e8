"""What keeps robots within their data sheets and on their wheels: rotation limits, boards, walls, drift."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.models.robots.blind_drives import blind_drive
from usarmjx.base.backend import numpy_backend
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.drives import SkidSteer
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.control import CommandUpdate, update_command
from usarmjx.sim.scene import build_scene
from usarmjx.sim.single_world import SingleWorld

PERIOD = 0.02


class Course:
    """One robot among some solids on a floor, on C MuJoCo."""

    def __init__(self, name, *solids, at=(0.0, 0.0, 0.3), turn=(0.0, 0.0, 0.0)):
        self.world = SingleWorld(build_scene(replace(FLAT, shapes=solids), ()), seed=0, seats=1)
        self.world.add(ROBOTS.get(name), name, [(at, np.array(quat_from_angles(*turn)))])
        group, member = self.world.scene.group_of(0)
        self.group = self.world.scene.groups[group]
        self.index = self.group.indices[member]

    def tell(self, flip_until=None, **keys):
        with numpy_backend():
            update = CommandUpdate(drive=keys, flip_until=flip_until)
            self.world.edit(
                0, command=update_command(self.group.plan, self.world.state_of(0).command, update)
            )
        return self

    def run(self, seconds):
        """Return pose and velocity of the root, and the speeds of its joints, after each step."""
        data, rows = self.world.engine.data, []
        root, dof = self.index.root_qposadr, self.index.root_dofadr
        for _ in range(round(seconds / PERIOD)):
            self.world.step()
            rows.append((*data.qpos[root : root + 7], *data.qvel[dof : dof + 6]))
        return np.array(rows)

    @property
    def wheels(self):
        """Speeds of the wheels [rad/s]."""
        return self.world.engine.data.qvel[list(self.index.dofadr)][: len(self.group.robot.wheels)]


def upright(rows):
    return 1 - 2 * (rows[:, 4] ** 2 + rows[:, 5] ** 2)


def heading(rows):
    w, x, y, z = rows[:, 3:7].T
    return np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


# Rotation limits


@pytest.mark.parametrize(
    ("name", "limit"), [("P2AT", 140), ("StereoP2AT", 140), ("P2DX", 300), ("ATRVJr", 120)]
)
def test_no_command_asks_for_more_than_the_data_sheets_rotation(name, limit):
    """Manual 12.1.1, 12.3.1, 12.4: what is too much is taken from both sides alike."""
    drive = ROBOTS.get(name).drive
    assert isinstance(drive, SkidSteer)
    fast = replace(drive, max_spin=100.0)  # as maxSpinSpeed makes it
    sides = np.array([[-100.0, 100.0], [100.0, -100.0], [20.0, 100.0], [50.0, 50.0], [1.0, 1.5]], np.float32)
    told = fast.targets(sides)
    left, right = told[:, 0], told[:, -1]
    rate = np.degrees((right - left) * fast.radius / fast.lever)
    assert rate == pytest.approx(
        [limit, -limit, limit, 0.0, math.degrees(0.5 * fast.radius / fast.lever)], rel=1e-5
    )
    assert (left + right) / 2 == pytest.approx(sides.mean(1), abs=1e-4)
    assert told[3:, [0, -1]].tolist() == sides[3:].tolist(), "to the last bit"


def test_a_p2dx_turns_at_its_data_sheets_300_degrees_a_second():
    spin = Course("P2DX").tell(Left=-21.8, Right=21.8).run(3.0)
    assert np.degrees(spin[100:, 12].mean()) == pytest.approx(300.0, rel=0.02)


def test_an_atrvjr_turns_no_faster_than_its_data_sheets_120_degrees_a_second():
    """Manual 12.4.1; its wheels stick and slip meanwhile, so that single instants are faster by a tenth."""
    turned = heading(Course("ATRVJr").tell(Left=-100.0, Right=100.0).run(3.0))
    assert 114.0 < np.degrees(turned[-1] - turned[49]) / (100 * PERIOD) < 120.0


def test_a_p2dx_starts_stops_and_reverses_with_its_caster_on_the_ground():
    course = Course("P2DX")
    course.run(0.5)
    for speed in (21.8, 0.0, 21.8, -21.8, 0.0):
        assert upright(course.tell(Left=speed, Right=speed).run(2.0)).min() > math.cos(math.radians(1.0))


# Boards, walls


def board(height):
    """One of yellow's, 9 cm wide."""
    return Shape(kind="box", size=(0.045, 0.5, height / 2), at=(0.0, 0.0, height / 2), surface="ground")


@pytest.mark.every_run("0.04")
@pytest.mark.parametrize("height", [0.02, 0.03, 0.04])
def test_the_wheels_of_a_p2dx_that_turns_on_a_board_do_not_stall(height):
    """In yellow, at 7.80,0.57, they stood still at 1.5 N m: an edge of 2 cm takes 1.9 N m."""
    for x, yaw in ((0.0, 20.0), (0.05, 120.0), (0.1, 60.0)):
        for rate in (3.0, -3.0):
            course = Course(
                "P2DX", board(height), at=(x, 0.0, 0.21 + height), turn=(0.0, 0.0, math.radians(yaw))
            )
            course.run(0.6)
            course.tell(Left=-rate, Right=rate).run(1.5)
            speeds = []
            for _ in range(50):
                course.run(PERIOD)
                speeds.append(np.abs(course.wheels).mean())
            assert np.mean(speeds) > 0.5, (x, yaw, rate)


@pytest.mark.parametrize("yaw", [0.0, 60.0, 120.0])
def test_a_p2dx_on_a_board_of_2_cm_turns_itself_free(yaw):
    course = Course("P2DX", board(0.02), at=(0.05, 0.0, 0.23), turn=(0.0, 0.0, math.radians(yaw)))
    course.run(0.6)
    turned = 0.0
    for rate in (3.0, -3.0):
        path = heading(course.tell(Left=-rate, Right=rate).run(4.0))
        turned = max(turned, abs(path[-1] - path[0]))
    assert turned > math.pi


@pytest.mark.parametrize(("x", "yaw"), [(-0.1, -161.0), (-0.07, -126.0), (0.03, -64.0), (0.01, 103.0)])
def test_a_p2dx_that_cannot_turn_itself_free_of_a_board_of_4_cm_drives_off_it(x, yaw):
    """Its caster, of 3.75 cm, meets what is higher as a wall; a Pioneer is made for sills of 2.5 cm."""
    course = Course("P2DX", board(0.04), at=(x, 0.0, 0.25), turn=(0.0, 0.0, math.radians(yaw)))
    course.run(0.6)
    path = np.concatenate([course.tell(Left=way, Right=way).run(3.0) for way in (6.0, -6.0)])
    assert np.linalg.norm(path[:, :2] - path[0, :2], axis=1).max() > 0.4


def test_a_p2dx_gets_over_sills_of_2_cm_slowly_and_of_4_cm_with_a_run_up():
    for height, speed, crosses in ((0.02, 2.5, True), (0.04, 2.5, False), (0.04, 12.0, True)):
        course = Course("P2DX", board(height), at=(-0.4, 0.0, 0.21))
        path = course.tell(Left=speed, Right=speed).run(1.0 / (speed * 0.0825) + 1.0)
        assert bool(path[-1, 0] > 0.3) is crosses, (height, speed)


@pytest.mark.parametrize("speed", [8.0, 21.8])
def test_a_p2dx_that_backs_into_a_wall_askew_keeps_its_wheels_on_the_ground_and_gets_away(speed):
    """With the corner of its deck it bowed by 27 degrees, and its wheels hung in the air from then on."""
    wall = Shape(kind="box", size=(0.025, 2.0, 0.6), at=(-0.7, 0.0, 0.6), surface="wall")
    course = Course("P2DX", wall, at=(0.0, 0.0, 0.21), turn=(0.0, 0.0, math.radians(25.0)))
    assert upright(course.tell(Left=-speed, Right=-speed).run(3.0)).min() > math.cos(math.radians(10.0))
    back = course.tell(Left=6.0, Right=6.0).run(1.0)
    assert np.linalg.norm(back[-1, :2] - back[0, :2]) > 0.3


def test_a_p2dx_that_bowed_at_a_wall_comes_down_from_it():
    """Pushed on, its tail against a wall and its nose on the floor, it stayed there as a ladder does."""
    wall = Shape(kind="box", size=(0.025, 2.0, 0.6), at=(-0.4, 0.0, 0.6), surface="wall")
    course = Course("P2DX", wall, at=(-0.085, 0.0, 0.19), turn=(0.0, math.radians(27.0), 0.0))
    assert upright(course.tell(Left=-18.0, Right=-18.0).run(1.5))[-1] < 0.95
    back = course.tell(Left=8.0, Right=8.0).run(1.5)
    assert upright(back)[-1] > 0.99
    assert back[-1, 0] - back[0, 0] > 0.3


@pytest.mark.parametrize("yaw", [0.0, 180.0, 200.0])
def test_a_talon_that_is_driven_at_a_wall_stays_on_its_tracks(yaw):
    wall = Shape(kind="box", size=(0.025, 2.0, 0.6), at=(0.9, 0.0, 0.6), surface="wall")
    speed = -6.43 if yaw > 90.0 else 6.43
    course = Course("Talon", wall, at=(0.0, 0.0, 0.14), turn=(0.0, 0.0, math.radians(yaw)))
    path = course.tell(Left=speed, Right=speed).run(4.0)
    assert path[-1, 0] > 0.2, "it is at the wall, with its gripper or its tracks"
    assert upright(path).min() > math.cos(math.radians(15))


@pytest.mark.every_run("Talon")
@pytest.mark.parametrize("name", ["P2DX", "Talon"])
def test_who_is_driven_blindly_through_yellow_ends_on_its_wheels(name):
    drives = [blind_drive(name, number, 12.0) for number in (3, 101)]
    assert min(drive.upright for drive in drives) > 0.85


# Soryu, Passarola


def test_a_soryu_turns_on_the_flat():
    """A crowned body stands on its middle car; flat on the ground it made 4 to 6 degrees a second."""
    course = Course("Soryu", at=(0.0, 0.0, 0.08))
    path = course.tell(Left=-5.1, Right=5.1).run(4.0)
    turned = heading(path)
    assert math.degrees(turned[-1] - turned[50]) / 3.0 > 12.0
    assert upright(path).min() > 0.95


@pytest.mark.parametrize("roll", [90.0, 180.0])
def test_a_soryu_is_righted_from_its_side_and_its_back(roll):
    course = Course("Soryu", at=(0.0, 0.0, 0.1), turn=(math.radians(roll), 0.0, 0.0))
    assert upright(course.run(0.5))[-1] < 0.1
    assert upright(course.tell(flip_until=round(3.6 / PERIOD)).run(3.0))[-1] > 0.99


def test_a_passarola_loses_its_drift_to_the_side():
    """After a turn at speed it went on sideways, by 0.30 m/s 12 s after it was told to stop."""
    course = Course("Passarola", at=(0.0, 0.0, 6.0)).tell(ThrustPropeller=2.0, TailPropeller=0.6)
    course.run(12.0)
    path = course.tell(ThrustPropeller=0.0, TailPropeller=0.0).run(12.0)
    assert np.linalg.norm(path[0, 7:9]) > 0.5
    assert np.linalg.norm(path[-1, 7:9]) < 0.05
