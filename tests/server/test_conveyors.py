"""Conveyors: boxes with a moving surface, and the CONTROL that sets their speed (WorldController.uc)."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.handy import block
from tests.server.peers import Peer, serving
from tests.server.test_created_objects import CREATE, controller, driver, steps
from tests.server.test_world_controller import say
from usarmjx.base.errors import SpecError, UnsupportedFeatureError, UsageError
from usarmjx.base.transforms import GRAVITY
from usarmjx.models.compile.arena_set import arena_set
from usarmjx.models.files.load import load_arena, save_arena
from usarmjx.models.types.shapes import SURFACES, Conveyor, Shape
from usarmjx.recording.reader import Recording
from usarmjx.recording.replay import check_recording
from usarmjx.server.protocol.dialects import UDK
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.recorded import record_worlds
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

SPEED = 1.0
BELT = Shape(
    kind="box",
    size=(4.0, 0.5, 0.1),
    at=(0.0, 0.0, 0.1),
    surface="ground",
    conveyor=Conveyor(name="Belt1", velocity=(SPEED, 0.0, 0.0)),
)
HALF = (0.1, 0.1, 0.02)
"""Half lengths of a block too flat to tip."""
BLOCK = block((-3.0, 0.0, 0.22), HALF, name="crate")
ARENA = replace(FLAT, shapes=(BELT,), loose=(BLOCK,))
FRICTION = max(SURFACES["ground"].friction, SURFACES["loose"].friction)
"""Of two surfaces of equal priority the greater one counts."""
CONVERGENCE = 5e-3
"""Share of a slide's speed by which friction of a solver of 10 iterations differs from Coulomb's."""


@pytest.fixture
def world():
    return DynamicWorld(ARENA, max_robots=2)


@pytest.fixture
def client(world):
    return controller(world)


def velocity(world):
    return world._single.engine.data.qvel[:3].copy()


def run(client, speed, name="Belt1"):
    return say(client, f"CONTROL {{Type Conveyor}} {{Name {name}}} {{Speed {speed}}}")


def test_a_block_is_dragged_by_friction_until_it_has_the_speed_of_the_belt(world, client):
    """It slides: v = mu (g t + v_z), whatever it hops, until it has the belt's speed, and keeps that."""
    run(client, 0)
    steps(world, 25)
    np.testing.assert_allclose(velocity(world), 0.0, atol=1e-4)
    run(client, 3)
    steps(world, 10)
    ahead, _, up = velocity(world)
    assert ahead == pytest.approx(FRICTION * (GRAVITY * 10 * world.period + up), rel=CONVERGENCE)
    assert ahead < 2 * SPEED
    steps(world, 30)
    np.testing.assert_allclose(velocity(world), [3 * SPEED, 0.0, 0.0], atol=1e-3)


def test_it_moves_as_in_c_mujoco(world):
    """The same scene as MuJoCo's XML, with its attribute `surfacevel`."""
    physics, loose = world.scene.physics, SURFACES["loose"]
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><option timestep="{physics.timestep}" integrator="Euler" cone="{physics.cone}" solver="CG"
        impratio="{physics.impratio}" iterations="{physics.iterations}"
        ls_iterations="{physics.ls_iterations}"><flag multiccd="disable"/></option>
      <worldbody>
        <geom type="plane" size="0 0 1" friction=".8"/>
        <body mocap="true">
          <geom type="box" size="4 .5 .1" pos="0 0 .1" friction=".8" surfacevel="{SPEED} 0 0 0 0 0"/>
        </body>
        <body pos="-3 0 .22"><freejoint/>
          <geom type="box" size=".1 .1 .02" mass=".3" friction="{loose.friction}"/>
        </body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    steps(world, 40)
    mujoco.mj_step(model, data, 40 * physics.substeps)
    np.testing.assert_allclose(world._single.engine.data.qpos, data.qpos, atol=1e-9)
    np.testing.assert_allclose(world._single.engine.data.qvel, data.qvel, atol=1e-9)


@pytest.mark.parametrize("yaw", [0.5, -2.0])
def test_its_velocity_is_in_the_axes_of_the_box(yaw):
    turned = replace(BELT, rotation=(0.0, 0.0, yaw), at=(0.0, 0.0, 0.1))
    world = DynamicWorld(replace(ARENA, shapes=(turned,), loose=(replace(BLOCK, at=(0.0, 0.0, 0.22)),)))
    steps(world, 40)
    np.testing.assert_allclose(velocity(world), [np.cos(yaw), np.sin(yaw), 0.0], atol=1e-3)


def test_its_speed_is_a_share_of_its_own_and_may_be_negative(world, client):
    for share in (0.5, -0.25):
        assert run(client, share, "BELT1") == []
        steps(world, 40)
        np.testing.assert_allclose(velocity(world), [share * SPEED, 0.0, 0.0], atol=1e-3)


def test_it_keeps_its_speed_when_others_come_and_begins_anew_with_the_world(world, client):
    run(client, 0)
    say(client, f"{CREATE} {{Name box}} {{Location 2,2,-0.1}}")
    driver(world, "0,-2,-0.3").leave()
    steps(world, 40)
    np.testing.assert_allclose(velocity(world), 0.0, atol=1e-3)
    run(client, 0.5)
    steps(world, 40)
    assert velocity(world)[0] == pytest.approx(0.5 * SPEED, abs=1e-3)
    world.reset()
    steps(world, 40)
    assert velocity(world)[0] == pytest.approx(SPEED, abs=1e-3)


def test_a_robot_is_carried():
    world = DynamicWorld(ARENA)
    robot = driver(world, "-2,0,-0.5").robot
    steps(world, 50)
    before = np.array(world.state(robot).pos)
    steps(world, 50)
    moved = np.array(world.state(robot).pos) - before
    # Contacts of wheels give: a braked robot creeps, by less than a percent of this.
    np.testing.assert_allclose(moved[:2], [SPEED * 50 * world.period, 0.0], atol=0.01)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("{Name Belt2} {Speed 1}", "no conveyor here is called 'Belt2'; there are: Belt1"),
        ("{Speed 1}", "no conveyor here is called ''"),
        ("{Name crate} {Speed 1}", "no conveyor here is called 'crate'"),
        ("{Name Belt1}", "Conveyor needs a Speed"),
        ("{Name Belt1} {Speed fast}", "'Speed' is 'fast'; expected numbers"),
        ("{Name Belt1} {Speed 1,0,0}", "Speed is '1,0,0'; expected a number"),
        ("{Name Belt1} {Speed 11}", "would run at 11 m/s; at most 10"),
        ("{Name Belt1} {Speed nan}", "not a finite number"),
    ],
)
def test_what_is_no_speed_of_a_belt_changes_nothing(world, client, line, says):
    client.session.take_faults()
    assert say(client, f"CONTROL {{Type Conveyor}} {line}") == []
    (fault,) = client.session.take_faults()
    assert says in fault
    steps(world, 40)
    assert velocity(world)[0] == pytest.approx(SPEED, abs=1e-3)


def test_over_tcp_a_belt_stops_and_runs():
    with serving(DynamicWorld(ARENA), dialect=UDK) as (port, server):
        peer = Peer(port, "INIT {ClassName USARBot.WorldController} {Name W}")
        engine = server.world._single.engine

        def told():
            peer.say("CONTROL {Type GetSTA} {Name crate}")
            return peer.until(b"STA")

        peer.say("CONTROL {Speed 0.25}{type conveyor} {NAME belt1}")
        assert told().startswith(b"STA {Name crate}")
        assert engine.model.geom("arena/0").id >= 0
        np.testing.assert_array_equal(engine.model.geom_surfacevel[engine.model.geom("arena/0").id, 0], 0.25)
        peer.close()


def test_other_engines_and_worlds_refuse_by_name():
    scene = build_scene(ARENA, ["P2AT"])
    for engine in ("jax", "warp", "planar"):
        with pytest.raises(UnsupportedFeatureError, match=f"engine '{engine}'.*geom_surfacevel"):
            Batch(scene, 1, engine=engine)
    world = BatchWorld(Batch(scene, 1, engine="c"), 0)
    with pytest.raises(UsageError, match="Belt1 keeps its speed: only in a single world of engine c"):
        world.set_conveyors("Belt1", 0.5)
    with pytest.raises(SpecError, match="conveyors, which cannot differ between the worlds of a batch"):
        arena_set([ARENA, FLAT])


def test_a_recording_of_a_belt_is_replayed_to_the_bit(tmp_path):
    world = DynamicWorld(ARENA, max_robots=2)
    file = record_worlds([world], tmp_path / "belt.mcap")
    client = controller(world)
    for share in (0.5, -1.0):
        steps(world, 15)
        run(client, share)
    steps(world, 15)
    world.reset()
    steps(world, 10)
    file.close()
    result = check_recording(Recording(tmp_path / "belt.mcap"), 0)
    assert (result.difference, result.note, result.steps) == ("", "", 55)


BELT_FILE = """
shapes:
- {kind: box, size: [2, 0.5, 0.1], at: [1, 0, 0.1], conveyor: {name: Belt1, velocity: [0.5, 0, 0]}}
"""


def test_an_arena_file_has_belts(tmp_path):
    (tmp_path / "belts.yaml").write_text(BELT_FILE)
    arena = load_arena(tmp_path / "belts.yaml")
    assert arena.shapes[0].conveyor == Conveyor(name="Belt1", velocity=(0.5, 0.0, 0.0))
    save_arena(arena, tmp_path / "saved.yaml")
    assert load_arena(tmp_path / "saved.yaml").shapes == arena.shapes


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("0.5, 0, 0]}", "0.5, 0]}", "velocity"),
        ("0.5, 0, 0]}", "11, 0, 0]}", "conveyor 'Belt1' runs at 11 m/s; at most 10"),
        ("name: Belt1, ", "", "name"),
        ("name: Belt1", "name: a b", "conveyor 'a b': a name is one word"),
        ("kind: box, size: [2, 0.5, 0.1]", "kind: sphere, size: [2]", "a conveyor is a box, not a sphere"),
    ],
)
def test_a_mistake_in_a_belt_is_named(tmp_path, before, after, says):
    (tmp_path / "belts.yaml").write_text(BELT_FILE.replace(before, after))
    with pytest.raises(SpecError, match=says):
        load_arena(tmp_path / "belts.yaml")
