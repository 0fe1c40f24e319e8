"""The page: who looks at what, and what it costs when nobody does."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from tests.view.simple_worlds import CAMERA_AT, HandMadeSource, drawing_of
from tests.view.visitor import until, visiting
from usarmjx.base.errors import UnknownNameError
from usarmjx.view import page as page_module
from usarmjx.view.layers import LAYERS
from usarmjx.view.page import BOARD_SHARE, FREE, NEXT, SIDE_BY_SIDE, STYLE, TOGGLE, ViewerPage


@pytest.fixture
def source():
    return HandMadeSource(*(drawing_of(robots=n) for n in (2, 3, 1)))


@pytest.fixture
def page(source):
    page = ViewerPage(source, title="three yards")
    yield page
    page.close()


def port_of(page):
    return page.server.get_port()


def camera_of(page):
    (viewer,) = page.viewers.values()
    return viewer.client.camera


def test_nothing_is_looked_at_before_somebody_comes_nor_more_often_than_twenty_times_a_second(
    page, source, monkeypatch
):
    now = [100.0]
    monkeypatch.setattr(page_module.time, "monotonic", lambda: now[0])
    before = list(source.asked)
    for _ in range(10):
        now[0] += 0.1
        page.update()
    assert source.asked == before
    monkeypatch.undo()
    with visiting(port_of(page)):
        until(page, lambda: page.viewers)
        before = source.asked[0]
        monkeypatch.setattr(page_module.time, "monotonic", lambda: now[0])
        now[0] += 1e6
        for _ in range(100):
            now[0] += 0.02
            page.update()
        assert source.asked[0] - before == pytest.approx(100 * 0.02 * 20 * 5 / 6, abs=10)
        assert source.asked[1:] == [0, 0]


def test_a_browser_gets_the_world_its_first_view_and_the_title(page):
    with visiting(port_of(page)) as visitor:
        until(page, lambda: visitor.of("ReplayDoneMessage"))
        glbs = visitor.of("BatchedGlbMessage")
        assert len(glbs) == 4
        assert visitor.of("SetGuiPanelLabelMessage")[-1]["label"] == "usarmjx \u00b7 three yards"
        theme = visitor.of("ThemeConfigurationMessage")[-1]
        assert (theme["show_share_button"], theme["show_logo"]) == (False, False)
        assert page.server.initial_camera.position[2] > 3.0


def test_browsers_get_a_scoreboard_of_the_chosen_world_and_a_panel_beside_the_picture(page):
    with visiting(port_of(page)) as visitor:
        until(page, lambda: 'data-world="three yards 0"' in str(visitor.heard))
        assert "robot1" in str(visitor.heard)
        position = visitor.of("GuiSetPanelPositionMessage")[-1]["position"]
        assert position == {"kind": "edge", "edge": "right"}
        page.post(lambda: page.choose_world(1))
        until(page, lambda: 'data-world="three yards 1"' in str(visitor.heard))


def test_a_scoreboard_of_many_robots_scrolls_in_the_corner_that_the_arena_leaves_free():
    assert f"max-height:{100 * BOARD_SHARE[1]:.0f}vh;overflow:auto" in STYLE


def test_layers_can_be_on_at_first_that_usually_are_not(page):
    """As if by their boxes, which show it."""
    name = "Radio links"
    assert not LAYERS.get(name).shown_at_first
    page.show_layers([name])
    page.refresh()
    assert page.layers[name] in page._switches.on
    assert page._switches._boxes[name].value
    with pytest.raises(UnknownNameError, match="Radio links"):
        page.show_layers(["Rainbows"])


def test_everybody_sees_all_of_the_arena_in_their_window_and_again_when_it_gets_narrower(page):
    with visiting(port_of(page), aspect=1.6) as visitor:

        def place():
            return visitor.of("SetCameraPositionMessage")[-1]["position"]

        def is_fitted(aspect):
            return visitor.of("SetCameraPositionMessage") and place() == pytest.approx(
                page.first_pose(aspect).pos
            )

        until(page, lambda: page.viewers and is_fitted(1.6))
        visitor.look(place(), 0.5)  # the panel docks, or a phone is turned
        until(page, lambda: is_fitted(0.5))
        assert np.linalg.norm(place()) > 1.3 * np.linalg.norm(page.first_pose(1.6).pos)
        fitted = len(visitor.of("SetCameraPositionMessage"))
        visitor.look(page.server.initial_camera.position, 0.5)  # a slow browser, after it got its view
        until(page, lambda: len(visitor.of("SetCameraPositionMessage")) > fitted)
        assert is_fitted(0.5)
        moved = np.multiply(place(), 0.5)
        visitor.look(moved, 0.5)
        until(page, lambda: camera_of(page).position == pytest.approx(moved))
        before = len(visitor.of("SetCameraPositionMessage"))
        visitor.look(moved, 1.2)
        until(page, lambda: camera_of(page).aspect == pytest.approx(1.2))
        for _ in range(3):
            page.refresh()
        assert len(visitor.of("SetCameraPositionMessage")) == before, "who has moved the view keeps it"


def test_several_people_look_from_where_each_wants_to(page):
    with visiting(port_of(page)) as one, visiting(port_of(page)) as other:
        until(page, lambda: len(page.viewers) == 2)
        until(page, lambda: one.of("RegisterCommandMessage"))
        one.press(NEXT)
        one_robot = lambda: sorted(str(o.robot) for o in page.viewers.values())  # noqa: E731
        until(page, lambda: one_robot() == ["0", "None"])
        other.click((1.0, 0.0, 5.0), (0.0, 0.0, -1.0))
        until(page, lambda: one_robot() == ["0", "1"])
        assert page.robot == 1
    until(page, lambda: not page.viewers)


def test_clicks_and_keys_do_what_they_did_in_the_viewing_client(page, source):
    with visiting(port_of(page)) as visitor:
        until(page, lambda: page.viewers and visitor.of("RegisterCommandMessage"))
        (viewer,) = page.viewers.values()
        nowhere = (0.0, 50.0, 5.0), (0.0, 0.0, -1.0)
        for expected in (0, 1, 0):  # a click beside all robots: the next one
            visitor.click(*nowhere)
            until(page, lambda expected=expected: viewer.robot == expected)
        assert camera_of(page).position == pytest.approx(np.add(CAMERA_AT, (0.0, 0.0, 0.2)))
        visitor.press(TOGGLE)
        until(page, lambda: camera_of(page).position[2] > 0.7)
        visitor.click(*nowhere, modifier="shift")
        until(page, lambda: viewer.robot is None)
        visitor.press(NEXT)
        until(page, lambda: viewer.robot == 0)
        visitor.press(FREE)
        until(page, lambda: viewer.robot is None)


def test_another_world_or_all_side_by_side(page, source):
    with visiting(port_of(page)) as visitor:
        until(page, lambda: page.viewers and visitor.of("GuiDropdownMessage"))
        visitor.set("World", "world 1")
        until(page, lambda: page.world == 1)
        assert page.drawing is source.drawings[1]
        visitor.set("World", SIDE_BY_SIDE)
        until(page, lambda: page.wall)
        assert page.world == 1
        before = list(source.asked)
        until(page, lambda: all(np.subtract(source.asked, before) >= 3))
        # The chosen world's layers stand where it does.
        assert tuple(page._over.position) == tuple(page._cell.offset) != (0.0, 0.0, 0.0)
        assert not any(layer.alone for layer in page.layers.values())
        visitor.set("World", "world 2")
        until(page, lambda: page.world == 2 and not page.wall)
        assert tuple(page._over.position) == (0.0, 0.0, 0.0)
        assert all(layer.alone for layer in page.layers.values())


def test_robots_that_come_are_seen_and_views_of_those_that_went_are_free(page, source):
    with visiting(port_of(page)) as visitor:
        until(page, lambda: page.viewers and visitor.of("RegisterCommandMessage"))
        (viewer,) = page.viewers.values()
        visitor.click((1.0, 0.0, 5.0), (0.0, 0.0, -1.0))
        until(page, lambda: viewer.robot == 1)
        source.change(0, drawing_of(robots=1))
        until(page, lambda: viewer.robot is None)
        assert page.drawing is source.drawings[0]
        source.change(0, drawing_of(robots=4))
        until(page, lambda: len(page.drawing.robots) == 4)


def test_switches_show_and_hide_layers(page):
    name = next(name for name, layer in LAYERS if layer.shown_at_first)
    with visiting(port_of(page)) as visitor:
        until(page, lambda: page.viewers and visitor.of("GuiCheckboxMessage"))
        labels = {message["props"]["label"] for message in visitor.of("GuiCheckboxMessage")}
        assert labels == {name for name, _ in LAYERS}
        layer = page.layers[name]
        assert layer in page._switches.on
        visitor.set(name, False)
        until(page, lambda: layer not in page._switches.on)
        visitor.set(name, True)
        until(page, lambda: layer in page._switches.on)


def test_what_fails_in_a_part_of_the_page_is_logged_and_stops_nobody(page, source, caplog, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("a layer's bug")

    layer = page._switches.on[0]
    monkeypatch.setattr(layer, "update", fail)
    with visiting(port_of(page)) as visitor, caplog.at_level(logging.ERROR):
        until(page, lambda: page.viewers)
        drawing = source.drawings[0]
        source.frames[0] = replace(source.frames[0], pos=source.frames[0].pos + np.float32(0.5))
        until(page, lambda: "a layer's bug" in caplog.text)
        until(page, lambda: visitor.of("SceneNodeUpdateMessage"))
        assert page.frame is source.frames[0]
        assert page.drawing is drawing


def test_nobody_is_handed_the_page_through_a_server_elsewhere(page, monkeypatch):
    monkeypatch.setattr(page_module.viser._viser, "ViserTunnel", None)
    assert page.server.request_share_url() is None
