"""Recordings on the page: at any time, by the timeline, and as one file for the web."""

import re

import numpy as np
import pytest

from usarmjx.base.errors import UsageError
from usarmjx.recording.reader import Recording
from usarmjx.recording.source import RecordingSource, Timeline, write_html
from usarmjx.view.page import ViewerPage

STEP = 0.02


@pytest.fixture
def source(mission):
    return RecordingSource(Recording(mission[0]))


def chassis(source, name):
    drawing, frame = source.drawing(0), source.frame(0)
    robot = next(robot for robot in drawing.robots.values() if robot.name == name)
    return frame.pos[robot.body]


def test_robots_are_where_they_were_at_any_time(source, mission):
    places = mission[1]
    for step in (1, 15, 17, 31, 50, 60):
        source.seek(step * STEP)
        np.testing.assert_allclose(
            chassis(source, "Second" if step > 40 else "First"),
            places[step - 1]["Second" if step > 40 else "First"],
            atol=0.03,  # between two frames bodies move evenly
        )


def test_who_hears_whom_is_kept_where_a_server_has_the_radio(source):
    source.seek(0.3)
    assert source.frame(0).links is None, "one robot alone"
    source.seek(0.7)
    links = source.frame(0).links
    slots = sorted(source.frame(0).robots)
    assert links.in_range[slots[0], slots[1]]
    assert -90.0 < links.power[slots[0], slots[1]] < 0.0


def test_who_has_joined_and_left_is_drawn_from_then_on(source):
    def names(time):
        source.seek(time)
        return {robot.name for robot in source.drawing(0).robots.values()}

    assert [names(time) for time in (0.0, 0.7, 1.2)] == [{"First"}, {"First", "Second"}, {"Second"}]
    assert names(0.1) == {"First"}  # and back again


def test_a_drawing_stays_the_same_object_as_long_as_nothing_changes(source):
    source.seek(0.05)
    first = source.drawing(0)
    source.seek(0.35)
    assert source.drawing(0) is first
    source.seek(0.75)
    assert source.drawing(0) is not first
    source.seek(0.05)
    assert source.drawing(0) is first


def test_times_beyond_the_ends_are_the_ends(source):
    source.seek(-5.0)
    assert source.time == source.start
    source.seek(500.0)
    assert source.time == source.end == pytest.approx(60 * STEP)


def test_a_recording_without_frames_is_named(tmp_path, mission):
    whole = Recording(mission[0])
    whole._channels = {
        number: channel for number, channel in whole._channels.items() if channel.kind != "frames"
    }
    with pytest.raises(UsageError, match="nothing to be seen"):
        RecordingSource(whole)


@pytest.fixture
def page(source):
    clock = [100.0]
    page = ViewerPage(source, panels=[lambda page: Timeline(page, now=lambda: clock[0])])
    yield page, clock
    page.close()


def test_the_timeline_plays_pauses_and_goes_anywhere_at_any_speed(page, source):
    shown, clock = page
    timeline, _ = shown.panels  # and the scoreboard

    def tick(seconds):
        clock[0] += seconds
        timeline.tick()
        shown.refresh()
        return round(shown.source.time - source.start, 6)

    assert tick(0.3) == 0.3
    timeline._speed.value = "x 2"
    timeline._change_speed()
    assert tick(0.2) == 0.7
    timeline.toggle()
    assert tick(0.2) == 0.7
    timeline.go_to(source.start + 0.1)
    assert tick(0.2) == 0.1
    assert shown.drawing.robots.keys() == {0}
    assert timeline._slider.value == pytest.approx(source.start + 0.1, abs=STEP)
    timeline.toggle()
    tick(5.0)
    assert source.time == source.end
    assert not timeline.playing  # and from the beginning the next time
    timeline.toggle()
    assert tick(0.1) == pytest.approx(0.2)


def test_a_page_for_the_web_needs_nothing_but_itself(source, tmp_path):
    path = tmp_path / "mission.html"
    write_html(source, path, period=0.3)
    text = path.read_text(encoding="utf-8")
    page = text[: text.index("__VISER_EMBED_DATA__")] + text[text.index("</script>") :]
    assert "__VISER_EMBED_DATA__" in text
    assert not re.findall(r"""<(?:script|link|img)[^>]*(?:src|href)=["']?https?:""", text)
    assert not re.findall(r"""(?:fetch|import)\(["']https?://""", page)
