"""Faults of the physics: who goes bad is put back, with whom it touches, and the others keep every bit."""

from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
import pytest

from tests.arenas import COURSE, FLAT
from tests.crowd import UPRIGHT, Crowd
from usarmjx.engines.c.faults import SEARCH_RADII, RecoveryResult, faulty_robots, step_and_recover
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.standing import START_GAP
from usarmjx.models.types.arena import LooseObject
from usarmjx.models.types.shapes import Shape

Disable = mujoco.mjtDisableBit
SUBSTEPS, STEPS, BEGIN = 4, 70, 20
LIMIT = 5.0
UNSOLVED = 1e-3
"""How far robots get apart within a second if the solver starts otherwise [m]: it makes at most 10
iterations, and the longest ways here are 0.9 m."""
SETTLED = 0.01
"""How far a robot that was put back falls and rocks [m]; the gap below it is 2 mm."""
BRICK = LooseObject(
    name="brick",
    at=(3.0, 0.0, 0.1),
    shapes=(Shape(kind="box", size=(0.1, 0.1, 0.1), surface="loose", mass=2.0),),
)


class Course:
    """Robots 2 m apart, the first two of which drive; the guarded step, and what it put back."""

    def __init__(self, arena=COURSE, robots=3, flags=0):
        self.crowd = Crowd(arena, *["P2AT"] * robots)
        self.model, self.data = self.crowd.model, self.crowd.data
        self.model.opt.disableflags |= Disable.mjDSBL_AUTORESET | flags
        self.indices = dict(enumerate(self.crowd.indices))
        self.limits = dict.fromkeys(self.indices, LIMIT)
        poses = {robot: self.crowd.on_floor(robot, 0.0, 2.0 * robot) for robot in self.indices}
        for robot, pos in poses.items():
            self.crowd.put(robot, pos)
        joints = np.zeros(len(self.indices[0].qposadr))
        self.homes = {robot: np.array([*pos, *UPRIGHT, *joints]) for robot, pos in poses.items()}
        self.reset_trees = []

    def tell(self):
        for robot, index in self.indices.items():
            self.data.ctrl[list(index.actuator_ids)] = (2.0, 1.0, 0.0)[min(robot, 2)]
            self.data.ctrl[list(index.hold_actuator_ids)] = 1.0
            self.data.xfrc_applied[:] = 0.0

    def step(self):
        world = self.model, self.data, SUBSTEPS
        found = step_and_recover(*world, self.indices, self.limits, self.homes)
        self.reset_trees.append(found)
        return found

    def run(self, spoil=None, steps=STEPS):
        """The robots' coordinates after each step (steps, robots, nq); `spoil` is called once, before one."""
        rows = []
        for step in range(steps):
            self.tell()
            if spoil is not None and step == BEGIN:
                spoil(self)
            self.step()
            rows.append([self.crowd.qpos(robot) for robot in self.indices])
        return np.array(rows)

    def beside(self, robot, y):
        """So far to the left of a robot [m]."""
        return self.crowd.qpos(robot)[:3] + np.array([0.0, y, 0.0])

    def touching(self):
        """The pairs of kinematic trees that touch now."""
        mujoco.mj_forward(self.model, self.data)
        trees = self.model.body_treeid[self.model.geom_bodyid[self.data.contact.geom]].reshape(-1, 2)
        return {frozenset(pair) for pair in trees.tolist() if min(pair) >= 0 and pair[0] != pair[1]}

    def tree(self, robot):
        return int(self.model.body_treeid[self.indices[robot].body_ids[0]])


def nan_velocity(course, robot=2):
    course.data.qvel[course.indices[robot].root_dofadr] = np.nan


def nan_joint(course, robot=2):
    course.data.qvel[course.indices[robot].dofadr[1]] = np.nan


def nan_position(course, robot=2):
    course.data.qpos[course.indices[robot].root_qposadr + 1] = np.nan


def infinite_activation(course, robot=2):
    course.data.act[course.indices[robot].actadr[0]] = np.inf


def nan_force(course, robot=2):
    course.data.xfrc_applied[course.indices[robot].body_ids[0], 2] = np.nan


def nan_control(course, robot=2):
    course.data.ctrl[course.indices[robot].actuator_ids[0]] = np.nan


def runaway(course, robot=2):
    course.data.qvel[course.indices[robot].root_dofadr + 2] = 200.0


FAULTS = (nan_velocity, nan_joint, nan_position, infinite_activation, nan_force, nan_control, runaway)


@pytest.fixture(scope="module")
def undisturbed():
    """What the robots do when nothing happens, by flags of the solver."""
    return {flags: Course(flags=flags).run() for flags in (0, Disable.mjDSBL_WARMSTART)}


def test_without_a_fault_it_is_mujocos_step():
    course, plain = Course(), Course()
    moved = course.run()
    for row in moved:
        plain.tell()
        mujoco.mj_step(plain.model, plain.data, nstep=SUBSTEPS)
        np.testing.assert_array_equal(row, [plain.crowd.qpos(robot) for robot in plain.indices])
    assert not any(course.reset_trees)
    assert np.abs(moved[-1, 0] - moved[0, 0]).max() > 0.3, "they do drive"


@pytest.mark.parametrize("fault", FAULTS)
def test_who_goes_bad_is_found(fault):
    course = Course()
    course.tell()
    assert faulty_robots(course.data, course.indices, course.limits) == frozenset()
    fault(course, 1)
    assert faulty_robots(course.data, course.indices, course.limits) == {1}
    fault(course, 2)
    assert faulty_robots(course.data, course.indices, course.limits) == {1, 2}


def test_each_robot_has_its_own_limit():
    course = Course()
    course.data.qvel[[index.root_dofadr for index in course.indices.values()]] = 7.0
    limits = {0: 6.9, 1: 7.0, 2: 7.1}
    assert faulty_robots(course.data, course.indices, limits) == {0}
    assert faulty_robots(course.data, {}, {}) == frozenset()


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("flags", [0, Disable.mjDSBL_WARMSTART], ids=["warm", "cold"])
def test_a_robot_goes_bad_and_no_other_notices(undisturbed, fault, flags):
    """The robot stands at its home in the undisturbed world too."""
    course = Course(flags=flags)
    moved, told = course.run(fault), undisturbed[flags]
    assert [step for step, found in enumerate(course.reset_trees) if found] == [BEGIN]
    assert course.reset_trees[BEGIN] == RecoveryResult(robots=frozenset({2}))
    np.testing.assert_array_equal(moved[: BEGIN + 1, :2], told[: BEGIN + 1, :2])
    if flags:
        np.testing.assert_array_equal(moved[:, :2], told[:, :2])
    np.testing.assert_allclose(moved[:, :2], told[:, :2], atol=UNSOLVED)
    np.testing.assert_allclose(moved[BEGIN:, 2, :3], np.tile(course.homes[2][:3], (50, 1)), atol=SETTLED)


def test_who_is_put_back_stands_still_at_its_home_and_has_heard_nothing():
    course = Course()
    course.run(steps=BEGIN)
    course.tell()
    nan_velocity(course, 0)
    index = course.indices[0]
    course.step()
    fallen = 9.81 * (SUBSTEPS * course.model.opt.timestep) ** 2
    pos = course.crowd.qpos(0)
    np.testing.assert_allclose(pos[:7], course.homes[0][:7], atol=max(fallen, START_GAP))
    np.testing.assert_allclose(pos[7:], 0.0, atol=1e-3)  # wheels and links: what the fall does to them [rad]
    assert np.abs(course.data.qvel[[index.root_dofadr + k for k in range(3)]]).max() <= 9.81 * 0.02 + 1e-9
    assert not course.data.ctrl[list(index.actuator_ids)].any()
    assert course.data.ctrl[list(index.hold_actuator_ids)].all()


@pytest.mark.parametrize("fault", [nan_velocity, runaway, nan_force])
def test_who_touches_a_bad_robot_is_put_back_with_it_and_nobody_else(undisturbed, fault):
    course = Course(flags=Disable.mjDSBL_WARMSTART)

    def collide(course):
        course.crowd.put(2, course.beside(1, 0.42))
        assert course.touching() == {frozenset({course.tree(1), course.tree(2)})}
        fault(course, 2)

    moved = course.run(collide)
    assert course.reset_trees[BEGIN] == RecoveryResult(robots=frozenset({1, 2}))
    assert sum(map(bool, course.reset_trees)) == 1
    np.testing.assert_array_equal(moved[:, 0], undisturbed[Disable.mjDSBL_WARMSTART][:, 0])
    np.testing.assert_allclose(moved[BEGIN, 1:, :3], [course.homes[k][:3] for k in (1, 2)], atol=SETTLED)


def test_who_goes_bad_within_the_step_is_put_back_before_it_hits_others(undisturbed):
    """Pushed to 60 m/s in the first substep, it is upon another one in the third."""
    course, plain = Course(flags=Disable.mjDSBL_WARMSTART), Course(flags=Disable.mjDSBL_WARMSTART)

    def push(course):
        course.crowd.put(2, course.beside(1, 1.0))
        assert course.touching() == set()
        speed, mass = 60.0, course.model.body_subtreemass[course.indices[2].body_ids[0]]
        force = mass * speed / course.model.opt.timestep
        course.data.xfrc_applied[course.indices[2].body_ids[0], 1] = -force

    plain.run(steps=BEGIN)
    plain.tell()
    push(plain)
    mujoco.mj_step(plain.model, plain.data, nstep=SUBSTEPS)
    assert 1 in faulty_robots(plain.data, plain.indices, plain.limits), "it is hit, were nothing done"
    moved = course.run(push)
    assert course.reset_trees[BEGIN] == RecoveryResult(robots=frozenset({2}))
    np.testing.assert_array_equal(moved[:, :2], undisturbed[Disable.mjDSBL_WARMSTART][:, :2])


def test_a_loose_object_that_goes_bad_lies_where_the_model_has_it():
    course = Course(replace(COURSE, loose=(BRICK,)), flags=Disable.mjDSBL_WARMSTART)
    undisturbed = Course(replace(COURSE, loose=(BRICK,)), flags=Disable.mjDSBL_WARMSTART).run()
    joint = course.data.joint("loose/brick")

    def spoil(course):
        course.data.joint("loose/brick").qvel[1] = np.nan

    moved = course.run(spoil)
    assert course.reset_trees[BEGIN] == RecoveryResult(others=("loose/brick",))
    np.testing.assert_array_equal(moved, undisturbed)
    sunk = 1e-3  # into the floor [m]; less
    np.testing.assert_allclose(joint.qpos, (*BRICK.at, *UPRIGHT), atol=sunk)


def test_with_a_loose_object_the_robot_on_it_is_put_back():
    course = Course(replace(COURSE, loose=(BRICK,)), flags=Disable.mjDSBL_WARMSTART)
    undisturbed = Course(replace(COURSE, loose=(BRICK,)), flags=Disable.mjDSBL_WARMSTART).run()

    def spoil(course):
        belly = 0.12  # a little more than it is above the wheels' lowest points
        course.crowd.put(2, (*BRICK.at[:2], 0.2 + course.homes[2][2] - belly))
        brick = int(course.model.body_treeid[course.model.body("loose/brick").id])
        assert frozenset({course.tree(2), brick}) in course.touching()
        course.data.joint("loose/brick").qvel[1] = np.nan

    moved = course.run(spoil)
    assert course.reset_trees[BEGIN] == RecoveryResult(robots=frozenset({2}), others=("loose/brick",))
    np.testing.assert_array_equal(moved[:, :2], undisturbed[:, :2])


def test_who_finds_its_home_taken_is_put_beside():
    course = Course(FLAT)
    course.run(steps=BEGIN)
    course.homes[2] = course.homes[1].copy()
    course.crowd.put(1, course.homes[1][:3])
    course.tell()
    nan_velocity(course, 2)
    assert course.step() == RecoveryResult(robots=frozenset({2}))
    away = np.linalg.norm(course.crowd.qpos(2)[:2] - course.homes[2][:2])
    assert 0.2 < away <= SEARCH_RADII[0]
    assert course.touching() == set()


def test_all_at_once_with_one_home_are_put_apart():
    course = Course(FLAT)
    course.homes = dict.fromkeys(course.indices, course.homes[1])
    course.tell()
    for robot in course.indices:
        nan_position(course, robot)
    assert course.step().robots == {0, 1, 2}
    assert course.touching() == set()
    course.run()
    assert not any(course.reset_trees[1:])


def test_who_is_bad_at_home_too_does_not_stop_the_world():
    """Nobody may move at all: everything is put back, and stays there."""
    course = Course(replace(FLAT, loose=(BRICK,)))
    course.run(steps=2)
    course.limits = dict.fromkeys(course.indices, 0.0)
    assert course.step() == RecoveryResult(robots=frozenset({0, 1, 2}), others=("loose/brick",))
    for robot, home in course.homes.items():
        np.testing.assert_array_equal(course.crowd.qpos(robot), home)


def test_a_car_that_stands_in_the_walls_is_put_where_it_fits_and_no_other_notices():
    """`INIT USARBot.Sedan` at (4.5, 1.9) in yellow, without asking for a free pose."""
    yellow = ARENAS.get("yellow")

    def world(where=None):
        crowd = Crowd(yellow, "P2AT", "Sedan", "P2AT")
        crowd.model.opt.disableflags |= Disable.mjDSBL_AUTORESET | Disable.mjDSBL_WARMSTART
        for robot in (0, 2):
            crowd.put(robot, crowd.on_floor(robot, *yellow.starts[robot].at[:2]))
        crowd.put(1, crowd.on_floor(1, 4.5, 1.9) if where is None else where)
        indices, limits = dict(enumerate(crowd.indices)), {0: LIMIT, 1: 30.0, 2: LIMIT}
        homes = {robot: crowd.qpos(robot) for robot in indices}
        rest = indices, limits, homes
        return crowd, partial(step_and_recover, crowd.model, crowd.data, SUBSTEPS, *rest)

    crowd, step = world()
    found = [step() for _ in range(50)]
    assert {robot for one in found for robot in one.robots} == {1}
    assert not any(found[-10:])
    assert crowd.depth(1) < 0.02  # it stands, on springs and in nothing
    other, step = world(where=crowd.qpos(1)[:3])
    assert not any(step() for _ in range(50))
    for robot in (0, 2):
        np.testing.assert_array_equal(crowd.qpos(robot), other.qpos(robot))
