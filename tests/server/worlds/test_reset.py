"""A world that is put back to its start while it is served: what comes back, and what goes on."""

from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.handy import block
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import Door
from usarmjx.server.worlds.batch_world import BatchWorld, SharedBatch
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import CommandUpdate
from usarmjx.sim.scene import RosterEntry, build_scene

P2DX = ROBOTS.get("P2DX")
PLACE, LEVEL = (0.5, -1.0, 0.2), (0.0, 0.0, 0.0)
AHEAD = CommandUpdate(drive={"Left": 10.0, "Right": 10.0}, light=True)
COURT = replace(
    FLAT,
    loose=(block((1.2, -1.0), half=(0.1, 0.1, 0.1), mass=1.0),),
    doors=(Door(name="door", at=(1.8, -1.6, 0.0), yaw=np.pi / 2),),
)


def steps(world, count):
    for _ in range(count):
        world.step()


def qpos(world):
    return np.array(world.one_world()[1].qpos)


@pytest.fixture
def court():
    world = DynamicWorld(COURT, max_robots=3)
    robot = world.spawn(P2DX, "R1", PLACE, LEVEL)
    return world, robot, qpos(world)


def test_all_that_moves_is_back_where_it_began_to_the_bit(court):
    world, robot, before = court
    world.update_command(robot, AHEAD)
    steps(world, 100)
    assert abs(qpos(world) - before).max() > 0.3, "it has driven and pushed"
    world.reset()
    np.testing.assert_array_equal(qpos(world), before)
    assert not np.asarray(world.one_world()[1].qvel).any()


def test_robots_stay_and_know_nothing_of_before(court):
    world, robot, _ = court
    world.update_command(robot, AHEAD)
    world.zoom(robot, 0, robot.cameras[0].min_fov)
    world.tag_texts[7] = "seen"
    steps(world, 50)
    world.observe([robot])
    odometry = [sensor.kind for sensor in robot.suite.sensors].index("Odometry")
    assert robot.pending[odometry][0] > 0.1
    world.reset()
    assert world.robots == {robot.slot: robot}
    assert world.battery(robot) == pytest.approx(P2DX.battery_life)
    assert not robot.command.light
    assert not robot.pending
    assert robot.fovs == [camera.default_fov for camera in robot.cameras]
    assert 7 not in world.tag_texts
    steps(world, 50)
    assert np.linalg.norm(world.state(robot).pos[:2] - PLACE[:2]) < 0.01, "it does not drive on"
    robot.pending.clear()
    world.observe([robot])
    assert abs(robot.pending[odometry][0]) < 0.02


def test_time_goes_on_for_clients_and_begins_again_for_the_world(court):
    world, robot, _ = court
    steps(world, 10)
    world.reset()
    world.step()
    assert world.time == pytest.approx(11 * world.period)
    assert int(world.one_world()[0].step) == 1
    # A robot is righted for three seconds from now on, not from the world's beginning.
    world.update_command(robot, CommandUpdate(flip_until=world.steps + 50))
    own = world.one_world()[0].groups[0].command.flip_until
    assert own == 51


def test_who_appeared_where_another_had_been_stands_next_to_it(court):
    world, first, _ = court
    world.update_command(first, AHEAD)
    steps(world, 100)
    second = world.spawn(P2DX, "R2", PLACE, LEVEL)
    world.reset()
    steps(world, 5)
    apart = np.linalg.norm(world.state(first).pos[:2] - world.state(second).pos[:2])
    assert P2DX.dimensions[1] * 0.9 < apart < 1.0
    assert world.recovery_log.put_back == 0


@pytest.fixture(scope="module")
def batch():
    scene = build_scene(FLAT, [RosterEntry(robot="P2DX", parked=True), RosterEntry(robot="P2DX")])
    return Batch(scene, 2, engine="c", seed=4)


def _push(shared, dof):
    """Let a robot of world 1, which stands still, move by itself."""
    engine, physics = shared.batch.engine, shared.state.physics
    numbers = physics.integration.copy()
    numbers[1, engine._parts[mujoco.mjtState.mjSTATE_QVEL].start + dof] = 0.5
    shared.state = shared.state.replace(physics=physics._replace(integration=numbers))


def test_of_a_batch_only_that_world_begins_again(batch):
    shared = SharedBatch(batch)
    world = BatchWorld(shared, 1)
    robot = world.spawn(P2DX, "R1", PLACE, LEVEL)
    start = np.array(world.state(robot).pos)
    world.update_command(robot, AHEAD)
    _push(shared, batch.scene.groups[0].root_dofadr[1])
    steps(world, 50)
    world.prepare_reset()
    before = jax.tree.map(lambda x: np.array(x[0]), (batch.physics(shared.state), shared.state.worlds.groups))
    other = np.array(world.one_world()[1].qpos[batch.scene.groups[0].root_qposadr[1]])
    world.reset()
    after = jax.tree.map(lambda x: np.array(x[0]), (batch.physics(shared.state), shared.state.worlds.groups))
    jax.tree.map(np.testing.assert_array_equal, after, before)
    assert world.robots == {robot.slot: robot}, "its client keeps it"
    np.testing.assert_allclose(world.state(robot).pos, start, atol=1e-6)
    assert not robot.command.light
    assert not np.allclose(world.one_world()[1].qpos[batch.scene.groups[0].root_qposadr[1]], other)
    steps(world, 2)
    assert (world.recovery_log.resets, world.time) == (0, pytest.approx(53 * world.period))
