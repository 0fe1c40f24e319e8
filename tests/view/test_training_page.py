"""Worlds of a batch on the page, and that it takes no more of a training's time than its share."""

import socket
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from tests.view.scenery import seers
from tests.view.visitor import until, visiting
from usarmjx.cli.train import _ShownTraining
from usarmjx.view.capture import Capture
from usarmjx.view.training_page import TIME_SHARE, BatchSource, TrainingPage


@pytest.fixture(scope="module")
def worlds():
    """Two worlds of one scene, as each looks alone."""
    first, _ = seers((0.0, 0.0, 0.0))
    before = first.one_world()
    second = first.one_world()[0], jax.tree.map(np.array, before[1])
    second[1].qpos[0] += 1.0
    return first.scene, [jax.tree.map(np.array, before), second]


@pytest.fixture
def batch(worlds):
    """A batch of those worlds, each twice: its state is what a batch's is to who looks at it."""
    scene, alone = worlds
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *alone, *alone)
    state = SimpleNamespace(worlds=stacked[0], physics=stacked[1])
    return SimpleNamespace(scene=scene, physics=lambda state: state.physics, worlds=4), state


def test_worlds_of_a_batch_look_as_each_does_alone(worlds, batch):
    scene, alone = worlds
    source = BatchSource(*batch, worlds=[2, 1])
    assert source.num_worlds == 2
    capture = Capture(scene)
    for number, world in ((0, alone[0]), (1, alone[1])):
        expected, found = capture.frame(*world), source.frame(number)
        assert (found.pos == expected.pos).all()
        assert (found.quat == expected.quat).all()
        assert found.robots[0].readings[0] == pytest.approx(expected.robots[0].readings[0])
    assert source.frame(1).robots[0].pos[0] == pytest.approx(source.frame(0).robots[0].pos[0] + 1.0)
    assert source.drawing(0) is source.drawing(0)
    assert source.drawing(0).extent == pytest.approx(capture.drawing(*alone[0]).extent)


class SlowPage:
    """A page whose every update takes a second; it has somebody who looks or not."""

    def __init__(self, source, clock):
        self.source, self.clock, self.is_watched, self.seen = source, clock, True, []

    def refresh(self):
        self.clock[0] += 1.0
        self.seen.append(self.source.frame(0).time)


def test_the_page_takes_its_share_of_the_time_and_none_when_nobody_looks(batch):
    clock, made = [0.0], []

    def make_page(source):
        made.append(SlowPage(source, clock))
        return made[0]

    scene, state = batch
    page = TrainingPage(scene, make_page, now=lambda: clock[0])
    while clock[0] < 1000.0:
        clock[0] += 0.25  # an action of the training
        page.show(state)
    assert len(made[0].seen) == pytest.approx(1000.0 * TIME_SHARE, abs=1)
    made[0].is_watched = False
    while clock[0] < 2000.0:
        clock[0] += 0.25
        page.show(state)
    assert len(made[0].seen) == pytest.approx(1000.0 * TIME_SHARE, abs=1)


def test_whoever_watches_a_training_sees_what_a_robot_reads(batch):
    bound = socket.create_server(("127.0.0.1", 0))
    training = _ShownTraining(bound, "explore-v1")
    training.begin(SimpleNamespace(batch=batch[0]), None)
    training.look(SimpleNamespace(batch=batch[1]))
    page = training._page._page
    try:
        with visiting(page.server.get_port()) as one:
            until(page, lambda: any(m["props"].get("label") == "Robot" for m in one.of("GuiDropdownMessage")))
            one.set("Robot", page.drawing.robots[0].name)
            until(page, lambda: one.of("GuiUplotMessage"))
    finally:
        page.close()
