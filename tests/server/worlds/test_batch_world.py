"""One world of a batch, served: clients claim robots that wait parked."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.arenas import FLAT
from usarmjx.base.errors import UsageError
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.cameras.paint import ROBOT_LABEL
from usarmjx.sensors.suite import suite_of
from usarmjx.server.worlds.batch_world import BatchWorld, SharedBatch, select_world
from usarmjx.server.worlds.served_world import CameraRequest, ViewpointRequest
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import CommandUpdate
from usarmjx.sim.scene import PARKING_HEIGHT, RosterEntry, build_scene

P2AT, P2DX = ROBOTS.get("P2AT"), ROBOTS.get("P2DX")
P2AT_SUITE = suite_of(P2AT)
STAND = 0.26  # m: a P2AT's origin above the floor (manual 5.3.6)
SERVED, OTHERS = 1, [0, 2]
LEVEL = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def batch():
    scene = build_scene(FLAT, [RosterEntry(robot="P2AT", parked=True)] * 2)
    return Batch(scene, 3, engine="c", seed=4)


@pytest.fixture(scope="module")
def compiled(batch):
    return BatchWorld(batch, SERVED)


@pytest.fixture
def world(compiled, batch):
    """The world with all robots parked, as at its start."""
    yield compiled
    for robot in list(compiled.robots.values()):
        compiled.remove(robot)
    compiled.step()


def places(world, batch):
    """Positions of all robots (worlds, robots, 3)."""
    return np.asarray(batch.physics(world._state).qpos)[:, batch.scene.groups[0].root_qposadr[:, :3]]


def run(world, steps):
    for _ in range(steps):
        world.step()


def test_warming_up_leaves_the_world_as_it_is(world):
    state = world._state
    world.warm_up()
    assert world._state is state
    assert not world.robots


def reading(world, robot, kind):
    """The robot's next reading of a sensor."""
    place = robot.suite.index(kind)
    robot.pending.clear()
    for _ in range(60):
        world.step()
        world.observe([robot])
        if place in robot.pending:
            return robot.pending.pop(place)
    raise AssertionError(f"no {kind} for 1.2 s")


def drive(world, robot, left, right):
    target = robot.command.target.copy()
    target[[0, 2]], target[[1, 3]] = left, right
    world.set_command(robot, robot.command.replace(target=target))


def test_parked_robots_stay_where_they_wait_to_the_bit(world, batch):
    before = places(world, batch)
    run(world, 20)
    np.testing.assert_array_equal(places(world, batch), before)
    assert (before[..., 2] > PARKING_HEIGHT - 1).all()


def test_a_claimed_robot_stands_where_its_client_wanted_it(world, batch):
    robot = world.spawn(P2AT, "R1", (1.0, -2.0, 0.5), (0.0, 0.0, 1.0))
    run(world, 50)
    pos = places(world, batch)
    np.testing.assert_allclose(pos[SERVED, robot.slot], [1.0, -2.0, STAND], atol=0.01)
    truth = reading(world, robot, "GroundTruth")
    np.testing.assert_allclose(truth, [1.0, -2.0, STAND, 0.0, 0.0, 1.0], atol=0.02)
    assert (pos[OTHERS, :, 2] > PARKING_HEIGHT - 1).all(), "nobody moved in the other worlds"


def test_it_drives_as_told_and_the_other_worlds_do_not_notice(world, batch):
    robot = world.spawn(P2AT, "R1", (0.0, 0.0, STAND), LEVEL)
    before = places(world, batch)[OTHERS]
    drive(world, robot, 3.0, 3.0)
    run(world, 100)
    pos = places(world, batch)
    assert pos[SERVED, robot.slot, 0] == pytest.approx(3.0 * P2AT.wheel_radius * 2.0, rel=0.1)
    np.testing.assert_array_equal(pos[OTHERS], before)
    np.testing.assert_allclose(reading(world, robot, "Odometry")[0], pos[SERVED, robot.slot, 0], atol=0.3)


def test_one_inside_the_floor_is_raised(world, batch, caplog):
    caplog.set_level("INFO", "usarmjx")
    robot = world.spawn(P2AT, "Mole", (0.0, 0.0, -3.0), LEVEL)
    assert "Mole would start 3.260 m inside the floor: raised" in caplog.text
    run(world, 50)
    assert places(world, batch)[SERVED, robot.slot, 2] == pytest.approx(STAND, abs=0.01)


def test_when_none_is_left_the_roster_is_named(world):
    first, second = (world.spawn(P2AT, f"R{i}", (0.0, 2.0 * i, STAND), LEVEL) for i in range(2))
    assert {first.slot, second.slot} == {0, 1}
    with pytest.raises(UsageError, match="no parked P2AT left in the roster"):
        world.spawn(P2AT, "R3", (0.0, -2.0, STAND), LEVEL)


def test_a_class_that_is_not_in_the_roster_is_refused(world):
    with pytest.raises(UsageError, match="no parked P2DX left"):
        world.spawn(P2DX, "R1", (0.0, 0.0, 0.2), LEVEL)
    assert not world.robots


def test_a_place_out_of_reach_is_refused_and_claims_nobody(world):
    with pytest.raises(UsageError, match="out of reach"):
        world.spawn(P2AT, "R1", (1e6, 0.0, 0.0), LEVEL)
    assert not world.robots


def test_leaving_parks_the_robot_and_the_next_client_gets_it_at_rest(world, batch):
    robot = world.spawn(P2AT, "R1", (0.0, 0.0, STAND), LEVEL)
    drive(world, robot, 5.0, 5.0)
    run(world, 20)
    world.remove(robot)
    run(world, 20)
    assert (places(world, batch)[..., 2] > PARKING_HEIGHT - 1).all()
    again = world.spawn(P2AT, "R2", (0.0, 0.0, STAND), LEVEL)
    assert again.slot == robot.slot
    run(world, 50)
    np.testing.assert_allclose(places(world, batch)[SERVED, again.slot, :2], 0.0, atol=0.01)
    np.testing.assert_allclose(reading(world, again, "Odometry"), 0.0, atol=0.01)


def test_leaving_twice_does_not_take_the_next_clients_robot(world):
    """A client whose world started again is told late; its slot may have been claimed by then."""
    old = world.spawn(P2AT, "R1", (0.0, 0.0, STAND), LEVEL)
    world.remove(old)
    new = world.spawn(P2AT, "R2", (0.0, 0.0, STAND), LEVEL)
    assert new.slot == old.slot
    world.remove(old)
    assert world.robots == {new.slot: new}


def test_a_robot_in_use_is_heard_and_a_parked_one_is_not(world):
    first = world.spawn(P2AT, "R1", (0.0, 0.0, STAND), LEVEL)
    forward = [mount.name for mount in P2AT.sensors if mount.kind == "Sonar"].index("F4")
    assert reading(world, first, "Sonar")[forward] == 5.0
    second = world.spawn(P2AT, "R2", (1.0, 0.0, STAND), LEVEL)
    assert reading(world, first, "Sonar")[forward] < 1.0
    world.remove(second)
    assert reading(world, first, "Sonar")[forward] == 5.0


def test_orders_reach_the_sensors_memory(world):
    robot = world.spawn(P2AT, "R1", (0.0, 0.0, STAND), LEVEL)
    drive(world, robot, 3.0, 3.0)
    run(world, 50)
    drive(world, robot, 0.0, 0.0)
    run(world, 50)
    odometry = robot.suite.index("Odometry")
    assert reading(world, robot, "Odometry")[0] > 0.2
    assert world.operate_sensor(robot, odometry, "RESET", ())
    assert abs(reading(world, robot, "Odometry")[0]) < 0.02
    assert not world.operate_sensor(robot, odometry, "SCAN", ())


def test_a_world_that_goes_bad_loses_its_robots_and_time_goes_on(world, batch, caplog):
    robot = world.spawn(P2AT, "R1", (0.0, 0.0, STAND), LEVEL)
    before = world.time
    qpos = np.array(batch.physics(world._state).qpos)
    pinned, no_dof = np.zeros(qpos.shape, bool), np.zeros((3, batch.scene.model.nv), bool)
    at = batch.scene.groups[0].root_qposadr[robot.slot, 0]
    pinned[SERVED, at], qpos[SERVED, at] = True, np.nan
    world._state = world._state.replace(
        physics=batch.engine.set_qpos(world._state.physics, pinned, no_dof, qpos)
    )
    world.step()
    assert not world.robots
    assert "not finite" in caplog.text
    assert world.time == pytest.approx(before + world.period)
    again = world.spawn(P2AT, "R2", (0.0, 0.0, STAND), LEVEL)
    assert reading(world, again, "GroundTruth")[2] == pytest.approx(STAND, abs=0.01)


@pytest.mark.parametrize("instance", [-1, 3])
def test_an_instance_out_of_range_is_an_error(batch, instance):
    with pytest.raises(UsageError, match=f"instance {instance} is not among worlds 0 to 2"):
        BatchWorld(batch, instance)


@pytest.mark.thorough
def test_a_claimed_robots_camera_sees_another_robot_and_zooms(world):
    """From 3 m behind; every length in a pinhole's picture goes with 1 / tan(fov / 2)."""
    seer = world.spawn(P2AT, "R1", (0.0, 0.0, STAND), LEVEL)
    other = world.spawn(P2AT, "R2", (3.0, 0.0, STAND), LEVEL)
    run(world, 10)
    counts = []
    for fov in (1.0, 0.5):
        assert world.zoom(seer, 0, fov)
        (picture,) = world.snapshot([CameraRequest(seer, 0, 96, 72)])()
        assert picture.rgb.shape == (72, 96, 3)
        counts.append((picture.segmentation == ROBOT_LABEL + other.slot).sum())
    assert counts[0] > 50
    # It is about 10 and 20 pixels wide: its rim is a fifth of it.
    assert counts[1] / counts[0] == pytest.approx((np.tan(0.5) / np.tan(0.25)) ** 2, rel=0.2)
    take = world.snapshot([CameraRequest(seer, 0, 96, 72)])
    world.remove(other)
    run(world, 1)
    assert (take()[0].segmentation == ROBOT_LABEL + other.slot).sum() == counts[1], (
        "the moment it was held still"
    )
    same = ViewpointRequest(
        world.viewpoint(CameraRequest(seer, 0, 96, 72)), 96, 72
    )  # a spectator from where the camera is
    np.testing.assert_array_equal(
        *(world.snapshot([one])()[0].rgb for one in (same, CameraRequest(seer, 0, 96, 72)))
    )
    world.remove(seer)
    again = world.spawn(P2AT, "R3", (0.0, 0.0, STAND), LEVEL)
    team, place = world._batch.scene.group_of(again.slot)
    assert again.slot == seer.slot
    assert world._state.worlds.groups[team].fov[SERVED, place, 0] == pytest.approx(
        again.cameras[0].default_fov
    )


def test_two_worlds_of_a_batch_are_stepped_once_and_each_hears_its_own_robot(batch):
    """A reading is fresh for one look only, whichever world asks for it."""
    shared = SharedBatch(batch)
    one, other = BatchWorld(shared, 0), BatchWorld(shared, 2)
    robots = [world.spawn(P2AT, "R", (x, 0.0, STAND), LEVEL) for world, x in ((one, 0.0), (other, 1.5))]
    before = shared.steps
    for _ in range(10):
        one.step()
        other.step()
    assert shared.steps == before + 10
    one.observe([robots[0]])
    other.observe([robots[1]])
    truth = P2AT_SUITE.index("GroundTruth")
    assert [robot.pending[truth][0] for robot in robots] == pytest.approx([0.0, 1.5], abs=0.01)
    one.remove(robots[0])
    assert not one.robots
    assert other.robots


def test_another_world_is_served_and_the_robots_come_along(batch):
    shared = SharedBatch(batch)
    world, other = BatchWorld(shared, 0), BatchWorld(shared, 1)
    robot = world.spawn(P2AT, "R", (0.5, 0.2, STAND), (0.0, 0.0, 1.0))
    run(world, 20)
    before = world.state(robot)
    with pytest.raises(UsageError, match="world 1 is served on other ports"):
        world.switch(1)
    world.switch(2)
    assert world.robots == {robot.slot: robot}
    np.testing.assert_allclose(world.state(robot).pos, before.pos, atol=1e-6)
    there = np.asarray(world._state.worlds.groups[0].active)
    assert there[:, robot.slot].tolist() == [False, False, True]
    world.update_command(robot, CommandUpdate(drive={"Left": 2.0, "Right": 2.0}))
    run(world, 50)
    assert np.linalg.norm(world.state(robot).pos - before.pos) > 0.1
    (rival,) = [BatchWorld(shared, 0)]
    rival.spawn(P2AT, "S", (0.0, 0.0, STAND), LEVEL)
    shared.served.remove(rival)
    with pytest.raises(UsageError, match="world 0 has no room for R"):
        world.switch(0)
    assert world._instance == 2
    assert not other.robots


def test_a_world_that_is_picked_is_a_copy_of_its_own():
    tree = (
        jnp.arange(6.0).reshape(3, 2),
        np.arange(3),
        {"key": jnp.arange(12, dtype=jnp.uint32).reshape(3, 4)},
    )
    found = select_world(1, tree)
    assert all(isinstance(leaf, np.ndarray | np.generic) for leaf in jax.tree.leaves(found))
    assert found[0].tolist() == [2.0, 3.0]
    assert found[1] == 1
    assert found[2]["key"].tolist() == [4, 5, 6, 7]
    found[0][:] = -1.0
    assert tree[0].tolist() == [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
