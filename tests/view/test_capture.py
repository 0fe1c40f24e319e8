import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usarmjx.models.files.load import find_arena
from usarmjx.models.generate.arena import generate
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.cameras.paint import VICTIM_LABEL
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene
from usarmjx.view.capture import Capture

P2AT = ROBOTS.get("P2AT")


@pytest.fixture(scope="module")
def world():
    served = DynamicWorld(find_arena("yellow"), seed=3)
    for name, x in (("a", 1.0), ("b", 2.2)):
        served.spawn(P2AT, name, (x, 0.6, served.arena.floor + 0.3), (0.0, 0.0, 0.0))
    for _ in range(25):
        served.step()
    served.observe(list(served.robots.values()))
    return served


def test_bodies_are_where_mujoco_has_them(world):
    source = ServedSource([world])
    drawing, frame = source.drawing(0), source.frame(0)
    model, data = world._single.engine.model, world._single.engine.data
    assert frame.time == pytest.approx(world.time)
    assert len(drawing.bodies) == len(frame.pos) == len(frame.quat) == len(frame.shown)
    for robot in drawing.robots.values():
        group, member = world.scene.group_of(robot.slot)
        ids = list(world.scene.groups[group].indices[member].body_ids)
        own = slice(robot.body, robot.body + robot.num_bodies)
        # data.xpos is of the state before the last substep: half a centimetre at the speed of settling
        assert np.allclose(frame.pos[own], data.xpos[ids], atol=5e-3)
        turn = Rotation.from_quat(frame.quat[own], scalar_first=True).as_matrix()
        assert np.allclose(turn, data.xmat[ids].reshape(-1, 3, 3), atol=0.02)
    assert model.nbody > 0


def test_solids_are_the_models(world):
    drawing = ServedSource([world]).drawing(0)
    arena = drawing.shapes["arena"]
    names = [world.scene.model.geom(i).name for i in range(world.scene.model.ngeom)]
    walls = [i for i, name in enumerate(names) if name.startswith("arena") or name == "floor"]
    assert len(arena.kind) == len(walls)
    labels = {body.label for body in drawing.bodies}
    assert VICTIM_LABEL in labels


def test_readings_and_battery_are_those_of_the_robot(world):
    source = ServedSource([world])
    drawing, frame = source.drawing(0), source.frame(0)
    robot = world.robots[0]
    own, seen = drawing.robots[0], frame.robots[0]
    scanner = [mount.kind for mount in own.sensors].index("RangeScanner")
    assert np.array_equal(seen.readings[scanner], world.memory(robot).last[scanner])
    assert seen.battery == pytest.approx(world.battery(robot))
    assert np.allclose(seen.pos, world.state(robot).pos)
    assert (own.name, own.robot) == ("a", "P2AT")


def test_a_drawing_stays_until_a_robot_leaves(world):
    source = ServedSource([world])
    before = source.drawing(0)
    world.step()
    assert source.drawing(0) is before
    third = world.spawn(P2AT, "c", (4.0, 0.6, world.arena.floor + 0.3), (0.0, 0.0, 0.0))
    assert [robot.name for robot in source.drawing(0).robots.values()] == ["a", "b", "c"]
    kept = source.frame(0)
    world.remove(third)
    assert [robot.name for robot in source.drawing(0).robots.values()] == ["a", "b"]
    assert len(kept.pos) > len(source.frame(0).pos)


def test_worlds_with_arenas_of_their_own_are_drawn_as_they_are():
    arenas = [generate("maze", (3, 3), seed=seed) for seed in range(2)]
    scene = build_scene(arenas, ["P2DX"])
    batch = Batch(scene, 2, engine="c")
    state = batch.reset()
    capture = Capture(scene)
    import jax

    from usarmjx.models.compile.arena_set import arena_index_of

    drawings = []
    worlds = state.worlds.replace(key=jax.random.key_data(state.worlds.key))
    for world in range(2):
        one = jax.tree.map(lambda x, i=world: np.asarray(x[i]), (worlds, batch.physics(state)))
        drawings.append(capture.drawing(*one))
        frame = capture.frame(*one)
        assert len(frame.pos) == len(drawings[-1].bodies)
        assert np.isfinite(frame.pos).all()
        solid = drawings[-1].shapes["arena"]
        assert (np.abs(solid.pos) < 1000).all()
        spec = arenas[int(arena_index_of(np.array(world), one[0].episode, 2))]
        assert scene.arena_of(one[0].arena_state) is spec
        assert drawings[-1].arena == spec.name
        boxes = np.array([np.add(shape.at, (0, 0, spec.floor)) for shape in spec.shapes])
        apart = np.linalg.norm(boxes[:, None] - solid.pos[None], axis=-1).min(-1)
        assert apart.max() < 1e-3
    assert not np.array_equal(drawings[0].shapes["arena"].pos, drawings[1].shapes["arena"].pos)
