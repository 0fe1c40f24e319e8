"""A served world on C MuJoCo sees what the same world of a batch sees."""

import threading
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.server.peers import PATIENCE, wait_until
from usarmjx.models.robots.pioneer import P2DX
from usarmjx.models.types.arena import ArenaSpec, FalseAlarm, Light, LooseObject, StartPose, Victim, Water
from usarmjx.models.types.shapes import Mesh, Shape
from usarmjx.sensors.cameras.paint import SKY_LABEL
from usarmjx.sensors.cameras.picture import Picture
from usarmjx.sensors.cameras.programs import PicturePrograms
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.served_world import CameraRequest
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import CommandUpdate
from usarmjx.sim.scene import build_scene, start_height

CORNERS = np.array([(0, 0, 0), (0.4, 0, 0), (0, 0.4, 0), (0, 0, 0.6)], float)


def box(at: tuple, size: tuple, **more) -> Shape:
    return Shape(kind="box", at=at, size=size, **{"surface": "wall", **more})


POND = ArenaSpec(
    name="pond",
    floor=-0.5,
    shapes=(
        box((2.5, 0.8, 0.5), (0.05, 0.6, 0.5), material="glass", rgba=(0.2, 0.8, 0.4, 1)),
        box((3.0, -0.8, 0.5), (0.05, 0.6, 0.5), material="mirror"),
        Shape(kind="mesh", mesh=Mesh(CORNERS), at=(1.5, 0.5, 0.0), surface="wall", rgba=(0.2, 0.2, 0.9, 1)),
    ),
    starts=(StartPose(tag="A", at=(0.0, 0.0, 0.188)), StartPose(tag="B", at=(1.5, -0.6, 0.188), yaw=2.0)),
    extent=((-3.0, 4.0), (-3.0, 3.0)),
    loose=(
        LooseObject(
            name="crate",
            at=(2.0, 0.3, 0.15),
            shapes=(box((0, 0, 0), (0.15, 0.15, 0.15), mass=1.0, surface="loose"),),
        ),
    ),
    waters=(Water(low=(1.0, -0.3, 0.0), high=(1.4, 0.3, 0.25)),),
    victims=(Victim(name="one", at=(3.5, 0.5, 0.2)),),
    false_alarms=(FalseAlarm(part="Head", at=(1.9, -0.2, 0.2)),),
    lights=(Light(at=(0.5, 0.5, 2.0), brightness=3.0, rgb=(1.0, 0.9, 0.8)),),
)


def pond(arena=POND):
    """The pond with two robots where a batch starts them, the second with its headlight on."""
    world = DynamicWorld(arena)
    for start, light in zip(arena.starts, (False, True), strict=True):
        pos = (*start.at[:2], start_height(arena, start, P2DX))
        robot = world.spawn(P2DX, start.tag, pos, (0.0, 0.0, start.yaw))
        world.update_command(robot, CommandUpdate(light=light))
    return world


def seen_by(world, width=56, height=40):
    return world.snapshot([CameraRequest(world.robots[0], 0, width, height)])()[0]


PLAIN = replace(
    POND,
    name="plain",
    shapes=(box((3.0, -0.8, 0.5), (0.05, 0.6, 0.5)),),
    waters=(),
    victims=(),
    false_alarms=(),
)
"""A wall, a crate and the robots: XLA takes long for glass, mirrors, water, meshes and people."""


@pytest.mark.parametrize(
    ("arena", "labels"),
    [(PLAIN, 3), pytest.param(POND, 5, marks=pytest.mark.thorough)],
    ids=["plain", "pond"],
)
def test_a_served_world_sees_what_a_batch_sees(arena, labels):
    batch = Batch(build_scene(arena, [P2DX] * 2), 1, engine="c")
    state = batch.reset()
    members = state.worlds.groups[0]
    lit = members.replace(command=members.command.replace(light=np.array([[False, True]])))
    state = batch.with_group(state, 0, lit)
    wanted = jax.tree.map(np.asarray, batch.render_robot(state, 0, 0, None, 56, 40))
    seen = seen_by(pond(arena))
    # Another program rounds differently: at edges a ray may meet the other side.
    assert (seen.segmentation == wanted.segmentation).mean() > 0.99
    assert np.isclose(seen.depth, wanted.depth, atol=1e-4).mean() > 0.99
    assert (np.abs(seen.rgb.astype(int) - wanted.rgb) <= 1).mean() > 0.99
    assert len(np.unique(seen.segmentation)) >= labels


def test_a_served_world_sees_headlights_and_water():
    world = pond()
    seen = seen_by(world)
    world.update_command(world.robots[1], CommandUpdate(light=False))
    unlit = seen_by(world)
    assert (seen.rgb != unlit.rgb).any()
    dry = pond(replace(POND, waters=()))
    dry.update_command(dry.robots[1], CommandUpdate(light=False))
    assert (seen_by(dry).rgb != unlit.rgb).any(-1)[seen.segmentation != SKY_LABEL].any(), "water tints"


class Programs:
    """Programs that are compiled when the gate is open, and render plain pictures; and who asked for them."""

    def __init__(self):
        self.gate, self.threads = threading.Event(), []
        self.known = PicturePrograms(self.render)

    def render(self, _scene, _viewpoint, width, height):
        self.threads.append(threading.current_thread())
        assert self.gate.wait(PATIENCE)
        return Picture(rgb=np.full((height, width, 3), 7, np.uint8), depth=None, segmentation=None)


def test_pictures_come_without_a_program_while_it_is_compiled_and_then_from_it():
    """On an accelerator. Another camera or robot costs no compilation."""
    world, programs = pond(), Programs()
    plain = seen_by(world)
    world.programs = programs.known
    for _ in range(3):
        np.testing.assert_array_equal(seen_by(world).rgb, plain.rgb)
    seen_by(world, 28, 20)
    wait_until(lambda: programs.threads, "a program to be asked for")
    assert len(programs.threads) == 1, "one at a time"
    assert programs.threads[0] is not threading.current_thread()

    programs.gate.set()
    wait_until(lambda: programs.known.idle, "both programs")
    assert len(programs.threads) == 2
    assert (seen_by(world).rgb == 7).all()
    assert (seen_by(world, 28, 20).rgb == 7).all()
    world.spawn(P2DX, "third", (-1.5, 1.0, 0.0), (0.0, 0.0, 0.0))
    world.update_command(world.robots[1], CommandUpdate(light=False))
    world.snapshot([CameraRequest(world.robots[1], 0, 56, 40)])()
    assert programs.threads[2:] == [threading.current_thread()] * 3
    world.remove(world.robots[2])
    seen_by(world)
    assert programs.threads[5:] == [threading.current_thread()]


def test_a_program_that_cannot_be_compiled_is_done_without(caplog):
    def broken(*_):
        raise RuntimeError("no room on the accelerator")

    world = pond()
    plain = seen_by(world)
    world.programs = PicturePrograms(broken)
    for _ in range(3):
        np.testing.assert_array_equal(seen_by(world).rgb, plain.rgb)
        wait_until(lambda: world.programs.idle, "it to fail")
    assert caplog.text.count("no program for pictures could be compiled") == 1


def test_on_a_processor_no_program_is_asked_for():
    assert jax.default_backend() != "cpu" or pond().programs is None
