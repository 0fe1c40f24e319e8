"""A robot that is served is one of a batch: the same draws, readings, effecters, links and ways.

World 2 of a batch on C MuJoCo against a served world of that seed and number, to which the same robots come
at once, at the same start poses.
"""

from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest

from tests.handy import TAGGER
from tests.sensors.test_numpy_backend import EVERYTHING
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.engines.c.batch import INTEGRATION_STATE
from usarmjx.models.arenas import ARENAS
from usarmjx.models.effecters import EFFECTERS, effecters_of
from usarmjx.models.robots.pioneer import P2AT, P2DX
from usarmjx.models.types.robot import Mount
from usarmjx.models.types.shapes import OPAQUE
from usarmjx.sensors.base import SENSORS
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import CommandUpdate
from usarmjx.sim.scene import build_scene, start_height

SEED, NUMBER = 7, 2
YELLOW = ARENAS.get("yellow")
YELLOW = replace(YELLOW, shapes=tuple(shape for shape in YELLOW.shapes if shape.material == OPAQUE), loose=())
"""Each further material takes XLA a fifth more of its time; tests/engines/test_c_rays.py has them all."""
OTHERS = {mount.kind: mount for mount in reversed(EVERYTHING.sensors)}
WHOLE = replace(
    TAGGER,
    name="Whole",
    sensors=(
        *P2AT.sensors,
        *(mount for kind, mount in OTHERS.items() if kind not in {m.kind for m in P2AT.sensors}),
    ),
    effecters=(*TAGGER.effecters, Mount(kind="RollerTable", name="Table", at=(0.0, 0.0, -0.2))),
)
"""A P2AT with a sensor and an effecter of every type."""
ROSTER = (WHOLE, replace(P2DX, name="Bare", sensors=()), WHOLE)
RADIO = RadioSettings(shadowing=4.0)
REPORT = 10
"""Control steps between two looks at the sensors."""
RANGE = 1e-4
"""Ranges: C MuJoCo casts in double precision for one of them, the batch in single [m]."""
SHARE, NEAR = 1e-5, 2e-5
"""Other readings: as NumPy's differ from XLA's, which fuses products and sums (tests/sensors/
test_numpy_backend.py): a share of what is measured, and of positions 10 m from the origin."""
RANGING = ("Sonar", "RangeScanner", "IRSensor", "IRScanner", "RangeScanner3D", "Lidar", "LineLaser", "PCL")
POWER = 1e-4
"""Single precision of 100 dB is 8e-6; logarithms and normal numbers differ in their last places too [dB]."""
GROUND = 1e-5
"""C MuJoCo's rays in double precision, from points up to 20 m from the origin in single [m]."""
TARGETS = 1e-6
"""Sines of angles up to 1.6 rad."""
START = 1e-6
"""The batch's start poses are of single precision, up to 12 m from the origin [m, rad]."""
ON_THE_WAY = 1e-3
"""After a second's drive from the same pose to the bit [m, rad]: what is told may differ in the last places,
and the solver, which makes 10 iterations at most, makes more of it. They go 0.1 m and more."""


class Both:
    """The batch, and the served world with its robots by slot."""

    def __init__(self, roster=ROSTER):
        self.batch = Batch(build_scene(YELLOW, roster, radio=RADIO), NUMBER + 1, engine="c", seed=SEED)
        self.state = self.batch.reset()
        self.own = mujoco.MjData(self.batch.scene.model)
        self.served = DynamicWorld(YELLOW, seed=SEED, number=NUMBER)
        self.robots = []
        for robot, start in zip(roster, YELLOW.starts, strict=False):
            pos = (*start.at[:2], start_height(YELLOW, start, robot))
            self.robots.append(self.served.spawn(robot, start.tag, pos, (0.0, 0.0, start.yaw)))
        self.data = self.served._single.engine.data

    @property
    def groups(self):
        return self.batch.scene.groups

    def of_batch(self, tree):
        return jax.tree.map(lambda values: np.asarray(values)[NUMBER], tree)

    def drive(self, **values):
        for group in range(len(self.groups)):
            self.state = self.batch.drive(self.state, group, values)
        for robot in self.robots:
            self.served.update_command(robot, CommandUpdate(drive=values))

    def step(self, steps):
        for _ in range(steps):
            self.state = self.batch.step(self.state)
            self.served.step()

    def take_poses(self):
        """Put the served robots to the bit where the batch's are, with what the solver begins from."""
        state = self.state.physics.integration[NUMBER]
        mujoco.mj_setState(self.batch.scene.model, self.own, state, INTEGRATION_STATE)
        for name in ("qpos", "qvel", "act", "qacc_warmstart"):
            getattr(self.data, name)[:] = getattr(self.own, name)

    def commands(self):
        """What the robots are told, by slot: in the batch, and served."""
        worlds = self.of_batch(self.state.worlds.replace(key=None))
        where = [self.batch.scene.group_of(slot) for slot in range(len(ROSTER))]
        theirs = [jax.tree.map(lambda x, m=m: x[m], worlds.groups[g].command) for g, m in where]
        return [robot.command for robot in self.robots], theirs


@pytest.fixture(scope="module")
def both():
    return Both()


def assert_near(ours, theirs, **tolerance):
    for (path, mine), other in zip(jax.tree.leaves_with_path(ours), jax.tree.leaves(theirs), strict=True):
        assert np.asarray(mine).dtype == np.asarray(other).dtype
        np.testing.assert_allclose(mine, other, err_msg=jax.tree_util.keystr(path), **tolerance)


def test_every_type_of_sensor_and_effecter_is_there():
    assert {mount.kind for mount in WHOLE.sensors} == {kind for kind, _ in SENSORS}
    # A vacuum works in single worlds alone: tests/server/test_vacuum.py.
    assert {effecter.kind for effecter in effecters_of(WHOLE)} == {kind for kind, _ in EFFECTERS} - {"Vacuum"}


def test_they_start_at_the_same_poses(both):
    model = both.served._single.engine.model
    names = [[m.joint(i).name for i in range(m.njnt)] for m in (both.batch.scene.model, model)]
    assert names[0] == names[1]
    np.testing.assert_allclose(both.data.qpos, both.state.physics.qpos[NUMBER], atol=START, rtol=0)


def assert_same_readings(both):
    """For a second's driving; sensor by sensor, whose noise is drawn for the seed, the step and the slot."""
    both.drive(Left=2.0, Right=1.0)
    fresh = set()
    for _ in range(6):
        both.take_poses()
        both.state, readings = both.batch.observe(both.state)
        both.served.observe(both.robots)
        for group, of_group in zip(both.groups, both.of_batch(readings), strict=True):
            for sensor, reading in enumerate(of_group):
                kind = group.suite.sensors[sensor].kind
                for member, slot in enumerate(group.slots):
                    mine = both.robots[slot].pending.pop(sensor, None)
                    assert (mine is not None) == reading.fresh[member], kind
                    if mine is not None:
                        near = (RANGE, 0.0) if kind in RANGING else (NEAR, SHARE)
                        assert_near(mine, reading.value[member], atol=near[0], rtol=near[1])
                        fresh.add(kind)
        both.step(REPORT)
    return fresh


@pytest.mark.oracle
def test_some_sensors_read_the_same_served_and_batched():
    """One that casts rays, one with a memory, one that goes by the clock; the next test has all."""
    some = {"Sonar", "INS", "GPS", "GroundTruth"}
    robot = replace(P2AT, name="Some", sensors=tuple(one for one in WHOLE.sensors if one.kind in some))
    assert assert_same_readings(Both((robot, robot))) == some


@pytest.mark.thorough
@pytest.mark.oracle
def test_every_sensor_reads_the_same_served_and_batched(both):
    # A depth camera waits for a SCAN; tests/sensors/test_kinect.py has both worlds' strips.
    assert assert_same_readings(both) == {kind for kind, _ in SENSORS} - {"Kinect"}


@pytest.mark.oracle
def test_after_a_seconds_drive_they_are_at_the_same_poses(both):
    both.take_poses()
    both.drive(
        Left=-2.0, Right=-1.9
    )  # back, away from walls; in tighter turns rounding decides how wheels slip
    before = both.data.qpos.copy()
    both.step(50)
    after = both.state.physics.qpos[NUMBER]
    np.testing.assert_allclose(both.data.qpos, after, atol=ON_THE_WAY, rtol=0)
    for group in both.groups:
        for index in group.indices:
            assert np.linalg.norm((after - before)[index.root_qposadr :][:2]) > 0.1


@pytest.mark.oracle
@pytest.mark.parametrize("effecter", effecters_of(WHOLE), ids=lambda effecter: effecter.kind)
def test_every_effecter_does_the_same_served_and_batched(both, effecter):
    both.take_poses()
    (place,) = [i for i, one in enumerate(effecters_of(WHOLE)) if one is effecter]
    for opcode in effecter.opcodes:
        for value in (0.3, -1.0, 9.0) if opcode.takes_value else (0.0,):
            where = np.arange(2) == 1
            both.state, result = both.batch.operate(
                both.state, 0, effecter.mount.name, opcode.name, value, where
            )
            done, number = (np.asarray(x)[NUMBER, 1] for x in (result.done, result.number))
            status = both.served.operate(both.robots[2], place, opcode, value)
            assert status == ("Failed" if not done else "OK" if number < 0 else str(number))
            assert_near(*both.commands(), atol=TARGETS, rtol=0)
    world, _ = both.served.one_world()
    theirs = both.of_batch(both.state.worlds.replace(key=None))
    np.testing.assert_array_equal(world.groups[0].releases, theirs.groups[0].releases)
    assert_near(world.tags, theirs.tags, atol=GROUND, rtol=0)


@pytest.mark.oracle
def test_links_are_the_same_served_and_batched(both):
    both.take_poses()
    both.state, links = both.batch.links(both.state)
    theirs, ours = both.of_batch(links), both.served.links(RADIO)
    here = slice(len(ROSTER))
    np.testing.assert_allclose(ours.power[here, here], theirs.power, atol=POWER, rtol=0)
    np.testing.assert_array_equal(ours.walls[here, here], theirs.walls)
    np.testing.assert_array_equal(ours.in_range[here, here], theirs.in_range)
    assert np.unique(np.round(ours.power[np.isfinite(ours.power)], 3)).size > 2
