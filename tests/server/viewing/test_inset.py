"""Cameras' pictures beside the page: what the raycaster sees, taken only while somebody wants one."""

import asyncio
import time
from types import SimpleNamespace

import numpy as np
import pytest

from tests.server.watchers import CYCLOPS, LOOKOUT
from tests.view.visitor import PATIENCE
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.server.pictures.views import robot_view, snapshot
from usarmjx.server.protocol.viewports import MultiView
from usarmjx.server.viewing import inset as inset_module
from usarmjx.server.viewing.inset import ALL_ROBOTS, ITS_VIEW, NOTHING, SIZE, CameraInset
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.view.page import ViewerPage
from usarmjx.view.viewpoint import FOV, Viewer

YARD = ArenaSpec(
    name="yard",
    starts=(StartPose(tag="S", at=(0.0, 0.0, 0.2)),),
    extent=((-5.0, 5.0), (-5.0, 5.0)),
    shapes=(Shape(kind="box", size=(0.1, 2.0, 1.0), at=(3.0, 0.0, 1.0), surface="wall"),),
)


@pytest.fixture
def world():
    world = DynamicWorld(YARD, seed=1)
    world.spawn(CYCLOPS, "one", (0.0, 0.0, 0.3), (0.0, 0.0, 0.0))
    world.spawn(LOOKOUT, "three", (0.0, 2.0, 0.3), (0.0, 0.0, 0.0))
    return world


@pytest.fixture
def page(world, monkeypatch):
    monkeypatch.setattr(inset_module, "PERIOD", 0.0)
    panels = [lambda page: CameraInset(page, [world])]
    page = ViewerPage(ServedSource([world]), panels=panels)
    yield page
    page.close()


def pictures_after(page, count):
    """Let the page go on until so many pictures have been taken."""
    inset = page.panels[0]
    wanted, end = inset.rendered + count, time.monotonic() + PATIENCE

    async def run():
        while inset.rendered < wanted:
            assert time.monotonic() < end, "no picture came"
            page.refresh()
            await asyncio.sleep(0.01)

    asyncio.run(run())
    return np.array(inset._image.image)


def test_nothing_is_rendered_before_a_camera_is_chosen(page):
    async def run():
        for _ in range(10):
            page.refresh()
            await asyncio.sleep(0.01)

    asyncio.run(run())
    inset = page.panels[0]
    assert inset.rendered == 0
    assert not inset._threads
    assert not inset._image.visible
    assert inset._choice.options == (NOTHING, ITS_VIEW, "Camera", "Ahead", "Right", "Behind")


@pytest.mark.parametrize(
    ("slot", "chosen", "camera"), [(None, "Camera", "Camera"), (1, "Right", "Right"), (1, ITS_VIEW, "")]
)
def test_a_picture_is_what_clients_get_of_the_chosen_robot(page, world, slot, chosen, camera):
    page.robot, page.panels[0]._choice.value = slot, chosen
    found = pictures_after(page, 1)
    view = robot_view(world.robots[slot or 0], camera, SIZE)
    requests = [request for request, _, _ in view.tiles]
    expected = view.compose(dict(zip(requests, snapshot(world, requests)(), strict=True)))
    assert found.shape == (*SIZE[::-1], 3)
    assert (found == expected).all()
    assert len(np.unique(expected.reshape(-1, 3), axis=0)) > 3  # sky, floor, the wall or another robot
    page.panels[0]._choice.value = NOTHING
    page.refresh()
    assert not page.panels[0]._image.visible


def test_a_robot_that_no_client_has_shows_its_cameras_too(page, world):
    page.robot, page.panels[0]._choice.value = 0, "Camera"
    expected = pictures_after(page, 1)
    held = dict(world.robots)
    frame, drawing = page.source.frame(0), page.source.drawing(0)
    world.robots.clear()
    try:
        view, name = page.panels[0]._view("Camera", drawing, frame)
        requests = [request for request, _, _ in view.tiles]
        found = view.compose(dict(zip(requests, snapshot(world, requests)(), strict=True)))
    finally:
        world.robots.update(held)
    assert name == "one"
    # Poses have gone through quaternions of single precision: a few pixels on edges may differ.
    assert (found == expected).all(-1).mean() > 0.99


def test_where_nobody_has_that_camera_the_page_says_so(page, world):
    inset = page.panels[0]
    page.robot, inset._choice.value = 0, "Behind"
    page.refresh()
    assert inset._caption.content == "one has no Behind."
    assert ALL_ROBOTS not in inset._choice.options


def test_after_the_last_robot_comes_the_multi_view(page, world, monkeypatch):
    """As in the original's viewing client; and with the first robot the picture of before."""
    page.close()
    monkeypatch.setattr(world, "multi_view", MultiView(camera_num=4))
    page = ViewerPage(ServedSource([world]), panels=[lambda page: CameraInset(page, [world])])
    try:
        inset, viewer = page.panels[0], Viewer(SimpleNamespace(camera=SimpleNamespace(fov=FOV)))
        inset._choice.value, inset._due = ITS_VIEW, float("inf")  # no picture is needed
        seen = []
        for _ in range(4):
            page.attach_next(viewer)
            page.refresh()
            seen.append((viewer.robot, inset._choice.value))
        assert seen == [(0, ITS_VIEW), (1, ITS_VIEW), (None, ALL_ROBOTS), (0, ITS_VIEW)]
    finally:
        page.close()


def test_without_a_multi_view_the_first_robot_follows_the_last(page):
    viewer = Viewer(SimpleNamespace(camera=SimpleNamespace(fov=FOV)))
    robots = [page.attach_next(viewer) or viewer.robot for _ in range(3)]
    assert robots == [0, 1, 0]
