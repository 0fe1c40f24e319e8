"""A robot whose description changes while it runs: it goes on as it was, and nobody else notices."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.arenas import FLAT
from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.models.compile import compose
from usarmjx.models.ini.parameters import SETTERS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import options
from usarmjx.sim.configure import update_robot_spec
from usarmjx.sim.control import CommandUpdate, update_command
from usarmjx.sim.scene import build_scene
from usarmjx.sim.single_world import SingleWorld

P2AT, P2DX = ROBOTS.get("P2AT"), ROBOTS.get("P2DX")
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
FIRST, OTHER = 0, 1


@pytest.fixture
def world():
    """Two robots that drive and sense, for 0.6 s."""
    world = SingleWorld(build_scene(FLAT, ()), seed=3, seats=4)
    for x, robot in enumerate((P2AT, P2DX)):
        world.add(robot, robot.name, [((0.0, 2.0 * x, 0.3), UPRIGHT)])
        with numpy_backend():
            told = CommandUpdate(drive={"Left": 2.0, "Right": 1.0}, light=True)
            plan = world.scene.groups[world.scene.group_of(x)[0]].plan
            world.edit(x, command=update_command(plan, world.state_of(x).command, told))
    run(world, 30)
    return world


def run(world, steps):
    """Steps, with the readings of the robots at the last one."""
    for _ in range(steps):
        world.step()
    return world.observe(world.roster)


def state(world, slot):
    """Where a robot is and how it moves, in its own order, and what is kept of it."""
    group, member = world.scene.group_of(slot)
    index, data = world.scene.groups[group].indices[member], world.engine.data
    free, dofs = np.arange(7) + index.root_qposadr, np.arange(6) + index.root_dofadr
    physics = {
        "qpos": data.qpos[[*free, *index.qposadr]],
        "qvel": data.qvel[[*dofs, *index.dofadr]],
        "warmstart": data.qacc_warmstart[[*dofs, *index.dofadr]],
        "act": data.act[list(index.actadr)],
        "ctrl": data.ctrl[[*index.actuator_ids, *index.hold_actuator_ids]],
    }
    return jax.tree.map(np.array, (physics, world.state_of(slot)))


def assert_same(one, other):
    for mine, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert np.asarray(mine).tobytes() == np.asarray(theirs).tobytes()


def with_sensor(robot, name, **settings):
    sensors = [
        replace(m, options=(*m.options, *options(**settings))) if m.name == name else m for m in robot.sensors
    ]
    return replace(robot, sensors=tuple(sensors))


@pytest.mark.parametrize("key", ["ChassisMass", "MaxTorque", "maxSpinSpeed", "msgTimer"])
def test_whose_figures_change_goes_on_as_it_was(world, key):
    before = state(world, FIRST), state(world, OTHER)
    changed = SETTERS[key][1](P2AT, 1.5)
    update_robot_spec(world, FIRST, changed)
    assert world.roster[FIRST].spec == changed
    assert_same((state(world, FIRST), state(world, OTHER)), before)
    run(world, 10)
    assert np.isfinite(world.engine.data.qpos).all()


def test_mass_and_torque_are_the_models(world):
    def mass():
        model, index = world.engine.model, world.scene.groups[0].indices[0]
        return model.body_mass[index.body_ids[0]]

    before = mass()
    update_robot_spec(world, FIRST, SETTERS["ChassisMass"][1](P2AT, 2.0))
    assert mass() == pytest.approx(2 * before)
    update_robot_spec(world, FIRST, P2AT)
    assert mass() == pytest.approx(before)


def test_a_setting_is_that_of_the_next_reading_and_the_others_remember(world):
    suite = world.scene.groups[0].suite
    sonar, scanner, odometry = (suite.index(kind) for kind in ("Sonar", "RangeScanner", "Odometry"))
    changed = with_sensor(with_sensor(P2AT, "F1", MaxRange=0.5), "Scanner1", Resolution=0.1, ScanInterval=0.2)
    kept = state(world, FIRST)[1].memory
    update_robot_spec(world, FIRST, changed)
    memory = world.state_of(FIRST).memory
    assert_same(memory.own[odometry], kept.own[odometry])
    assert memory.due[odometry] == kept.due[odometry]
    assert memory.due[scanner] < kept.due[scanner], "it scans at once"
    readings = run(world, 1)[FIRST]
    assert np.asarray(readings[sonar].value)[0] == np.float32(0.5)
    assert (np.asarray(readings[sonar].value)[1:3] > 1.0).all()
    assert np.shape(readings[scanner].value) == (32,), "pi / 0.1 beams, and one"


def test_what_cannot_be_changes_nothing(world, monkeypatch):
    before = state(world, FIRST), state(world, OTHER)
    with pytest.raises(UsageError, match="a running P2AT keeps its parts and its load"):
        update_robot_spec(world, FIRST, replace(P2AT, sensors=P2AT.sensors[1:]))
    with pytest.raises(SpecError, match="MaxRange"):
        update_robot_spec(world, FIRST, with_sensor(P2AT, "F1", MaxRange=-1.0))

    def broken(spec, robot, *rest):
        whole(spec, robot, *rest)
        if robot is heavy:
            spec.worldbody.add_body(name="twice")
            spec.worldbody.add_body(name="twice").add_geom(size=[0.0] * 3)

    heavy, whole = SETTERS["ChassisMass"][1](P2AT, 2.0), compose.add_robot
    monkeypatch.setattr("usarmjx.sim.configure.add_robot", broken)
    with pytest.raises(SpecError, match="a P2AT cannot be built so"):
        update_robot_spec(world, FIRST, heavy)
    assert world.roster[FIRST].spec == P2AT
    assert_same((state(world, FIRST), state(world, OTHER)), before)
