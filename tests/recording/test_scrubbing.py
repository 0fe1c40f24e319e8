"""A recording in a browser: somebody goes to its end, and nothing comes from elsewhere."""

import time

import pytest

from tests.view.conftest import browser  # noqa: F401 - a fixture
from tests.view.visitor import until, visiting
from usarmjx.recording.reader import Recording
from usarmjx.recording.source import RecordingSource, Timeline, recording_page, write_html
from usarmjx.view.page import ViewerPage

PATIENCE = 60.0  # s: a loaded machine draws slowly


@pytest.fixture
def source(mission):
    return RecordingSource(Recording(mission[0]))


@pytest.mark.alone
def test_somebody_goes_to_the_end(source, browser):  # noqa: F811
    page = ViewerPage(source, panels=[lambda page: Timeline(page, now=lambda: 0.0)])
    visitor = browser.open(f"http://127.0.0.1:{page.server.get_port()}/")
    try:
        visitor.find("[role=slider]", then="e.focus()")
        for kind in ("keyDown", "keyUp"):
            visitor.call("Input.dispatchKeyEvent", type=kind, code="End", key="End", windowsVirtualKeyCode=35)
        deadline = time.monotonic() + PATIENCE
        while source.time < source.end - 0.02 and time.monotonic() < deadline:
            page.update()
            time.sleep(0.05)
        assert source.time == pytest.approx(source.end, abs=0.02)
        assert {robot.name for robot in page.drawing.robots.values()} == {"Second"}
        assert visitor.errors == []
        assert visitor.hosts == {f"127.0.0.1:{page.server.get_port()}"}
    finally:
        visitor.leave()
        page.close()


def test_robots_of_a_recording_are_told_of_as_those_that_run(source):
    page, timeline = recording_page(source)
    timeline.playing = False
    try:
        with visiting(page.server.get_port()) as one:
            until(page, lambda: any(m["props"].get("label") == "Robot" for m in one.of("GuiDropdownMessage")))
            one.set("Robot", "First")
            until(page, lambda: one.of("GuiUplotMessage"))
            assert any("Scout" in str(message) for message in one.of("GuiHtmlMessage"))
            assert not [
                m for m in one.of("GuiButtonMessage") if m["props"].get("visible") and "controls" in str(m)
            ]
    finally:
        page.close()


@pytest.mark.alone
def test_a_page_for_the_web_asks_nobody_for_anything(source, browser, tmp_path):  # noqa: F811
    write_html(source, tmp_path / "mission.html", period=0.3)
    visitor = browser.open((tmp_path / "mission.html").as_uri())
    try:
        visitor.wait("document.querySelector('canvas') !== null")
        assert visitor.errors == []
        assert visitor.hosts == {""}
    finally:
        visitor.leave()
