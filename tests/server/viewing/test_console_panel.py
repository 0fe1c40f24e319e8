"""The spectator's console on the live page: for whoever has the controls; the others may look."""

import pytest

from tests.server.watchers import CYCLOPS
from tests.view.visitor import until, visiting
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.server.viewing.console import NOT_ALLOWED, SOMEBODY_ELSE, ConsolePanel
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.view.controls import ControlLock
from usarmjx.view.page import ViewerPage

YARD = ArenaSpec(
    name="yard", starts=(StartPose(tag="S", at=(0.0, 0.0, 0.2)),), extent=((-5.0, 5.0), (-5.0, 5.0))
)


@pytest.fixture
def world():
    world = DynamicWorld(YARD, seed=1)
    world.spawn(CYCLOPS, "one", (0.0, 0.0, 0.3), (0.0, 0.0, 0.0))
    return world


def answer(page, visitor, line):
    """What the console of a person shows after a line."""
    before = len(shown(visitor))
    visitor.set("Line", line)
    visitor.set("Run", True)
    until(page, lambda: len(shown(visitor)) > before)
    return shown(visitor)[-1]


def shown(visitor):
    updates = [m["updates"].get("content") for m in visitor.of("GuiUpdateMessage")]
    return [text for text in updates if text and "<pre" in text]


def test_who_has_the_controls_edits_robots_and_the_others_may_look(world):
    lock = ControlLock()
    page = ViewerPage(ServedSource([world]), panels=[lambda page: ConsolePanel(page, [world], lock)])
    try:
        with visiting(page.server.get_port()) as visitor:
            until(page, lambda: page.viewers and "Line" in labels(visitor))
            (client,) = page.viewers
            line = "editactor name=one msgTimer=0.5"
            assert "editactor: take the controls first" in answer(page, visitor, line)
            lock.take(client + 1)
            assert f"editactor: {SOMEBODY_ELSE}" in answer(page, visitor, line)
            lock.leave(client + 1)
            lock.allowed = False
            assert f"editactor: {NOT_ALLOWED}".replace("'", "&#x27;") in answer(page, visitor, line)
            lock.allowed = True
            visitor.look((0.0, 0.0, 5.0), 1.6)
            until(page, lambda: page.viewers[client].client.camera.position[2] == 5.0)
            told = answer(page, visitor, "showdebug")
            # It looks down from 5 m above the origin; on the wire z points down.
            assert "camera: {Location 0.00,0.00,-5.00}" in told.replace("-0.00", "0.00")
            assert "one (Cyclops)" in told
            assert world.robots[0].spec.msg_timer == 0.2
            assert lock.take(client)
            assert "msgTimer=0.5" in answer(page, visitor, line)
            assert world.robots[0].spec.msg_timer == 0.5
            assert "&lt;" in answer(page, visitor, "<b>"), "what is typed is shown as text"
    finally:
        page.close()


def labels(visitor):
    return {m["props"].get("label") for m in visitor.heard if m["type"].startswith("Gui") and "props" in m}
