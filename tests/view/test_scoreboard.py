"""The scoreboard, its events, and the page that shows it."""

from dataclasses import replace

import numpy as np
import pytest
import viser

from tests.view.simple_worlds import drawing_of, frame_of
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX, DrawnMount, DrawnTag
from usarmjx.view.layers import LAYERS, maps
from usarmjx.view.layers.marks import DROPPED_RGB, TAG_RGB
from usarmjx.view.page import HELD, ICON, LIBRARY, MARK, PRODUCT, page_folder, page_text
from usarmjx.view.scoreboard import (
    ENTRIES,
    BoardFacts,
    MissionLog,
    board_html,
    clock,
    css_rgb,
    known_area,
    legend_html,
    state_of,
)

OWNERS = np.array([0, 0, -1, 2])
"""Two victims, 1 and 3 for people, and a false alarm between them."""


def with_victim_sensors(drawing):
    """The same drawing, whose robots have a victim sensor."""
    mount = DrawnMount("VictSensor", ("V",), np.zeros(1, int), np.zeros((1, 3)), np.eye(3)[None], ({},))
    robots = {slot: replace(robot, sensors=(mount,)) for slot, robot in drawing.robots.items()}
    return replace(drawing, robots=robots)


def with_robot(frame, slot, **fields):
    return replace(frame, robots={**frame.robots, slot: replace(frame.robots[slot], **fields)})


def reading(*rows):
    value = np.zeros((len(OWNERS), 5))
    value[list(rows), 0] = 1
    return (value,)


def test_a_found_victim_is_an_event_once_with_its_finder():
    drawing, facts, log = (
        with_victim_sensors(drawing_of(2)),
        BoardFacts(owners=OWNERS, victims=2),
        MissionLog(),
    )
    frame = frame_of(drawing)
    log.update(drawing, frame, facts)
    log.update(drawing, with_robot(replace(frame, time=3.0), 1, readings=reading(2, 3)), facts)
    log.update(drawing, with_robot(replace(frame, time=4.0), 0, readings=reading(3)), facts)
    assert [*log.events] == [(3.0, "robot1 found victim 3")]
    text = board_html("yard", drawing, replace(frame, time=65.0, score=12.34), facts, log)
    for wanted in ("1:05", "12.3", "1 of 2", "0:03 robot1 found victim 3", 'data-world="yard"', "robot0"):
        assert wanted in text


def test_robots_that_come_go_and_tip_over_are_events_and_a_reset_begins_anew():
    drawing, log, facts = drawing_of(3), MissionLog(), BoardFacts()
    frame = frame_of(drawing)
    fewer = replace(frame, robots={slot: frame.robots[slot] for slot in (0, 1)})
    log.update(drawing, fewer, facts)
    log.update(drawing, replace(frame, time=1.0), facts)
    lying = with_robot(replace(frame, time=2.0), 0, quat=np.array([0.0, 1.0, 0.0, 0.0]))
    log.update(drawing, lying, facts)
    gone = replace(lying, time=3.0, robots={slot: lying.robots[slot] for slot in (0, 2)})
    log.update(drawing, with_robot(gone, 2, battery=0.0), facts)
    assert [text for _, text in log.events] == [
        *("robot1 leaves", "robot2 has no battery left", "robot0 tips over", "robot2 joins"),
    ]
    log.update(drawing, replace(frame, time=0.0), facts)
    assert not log.events


def test_states_name_what_a_robot_does():
    drawing = drawing_of(1)
    robot, now = drawing.robots[0], frame_of(drawing).robots[0]
    assert state_of(robot, now) == "stands"
    assert state_of(robot, replace(now, linear=np.array([0.2, 0.0, 0.0]))) == "moves"
    assert state_of(robot, replace(now, quat=np.array([0.0, 1.0, 0.0, 0.0]))) == "tipped over"
    assert state_of(robot, replace(now, battery=0.0)) == "no battery"


def test_the_area_of_maps_is_what_any_robot_knows():
    frame = frame_of(drawing_of(2))
    one, other = np.zeros((4, 4), np.uint8), np.zeros((4, 4), np.uint8)
    one[0], other[:, 0], other[3, 3] = maps.FREE, maps.WALL, maps.MARK
    extra = {MAP_GRID: np.array([0.0, 0.0, 0.5]), f"{MAP_PREFIX}a": one, f"{MAP_PREFIX}b": other}
    assert known_area(replace(frame, extra=extra)) == 8 * 0.25
    assert known_area(frame) is None


def test_the_legend_has_what_is_drawn_and_nothing_else():
    drawing = drawing_of(2)
    frame = frame_of(drawing)
    layers = ["Rings", "Tags", "Radio links", "Grid"]
    assert "robot; the tip" in legend_html(layers, drawing, frame)
    assert "tag" not in legend_html(layers, drawing, frame)
    tagged = replace(drawing, tags=(DrawnTag(7, np.zeros(3)),))
    dropped = replace(frame, dropped_tags=np.zeros((1, 3)))
    text = legend_html(layers, tagged, dropped)
    for wanted in (
        f"background:{css_rgb(TAG_RGB)}",
        "radio tag",
        f"background:{css_rgb(DROPPED_RGB)}",
        "dropped",
    ):
        assert wanted in text
    assert legend_html([], tagged, dropped) == ""
    assert "radio tag" in board_html("yard", tagged, frame, BoardFacts(), MissionLog(), layers)
    assert set(ENTRIES) <= {name for name, _ in LAYERS}


@pytest.mark.parametrize(
    ("kind", "layer"),
    [
        ("RangeScanner", "Laser fans"),
        ("IRScanner", "Laser fans"),
        ("Sonar", "Sonar cones"),
        ("IR", "Infrared lines"),
    ],
)
def test_the_legend_has_echoes_only_of_sensors_that_a_robot_has(kind, layer):
    drawing = drawing_of(1)
    frame = frame_of(drawing)
    assert legend_html([layer], drawing, frame) == ""
    mount = replace(drawing.robots[0].cameras[0], kind=kind, settings=({},))
    equipped = replace(drawing, robots={0: replace(drawing.robots[0], sensors=(mount,))})
    assert len(ENTRIES[layer]) == legend_html([layer], equipped, frame).count("<div>") == 1


def test_names_of_people_are_no_html():
    drawing = drawing_of(1)
    robots = {0: replace(drawing.robots[0], name="<b>")}
    text = board_html(
        '"x"', replace(drawing, robots=robots), frame_of(drawing), BoardFacts(task="<t>"), MissionLog()
    )
    assert "&lt;b&gt;" in text
    assert "&lt;t&gt;" in text
    assert 'data-world="&quot;x&quot;"' in text


def test_the_page_has_our_name_icon_and_loading_state_before_visers_script():
    text = (page_folder() / "index.html").read_text(encoding="utf-8")
    assert f"<title>{PRODUCT}</title>" in text
    assert MARK not in text
    assert ICON in text
    assert "f9e20b" not in text  # a colour of viser's icon
    assert text.index("usarmjx-loading") < text.index("data-p=")
    assert text.count(HELD) == 1, "the long script waits for the first picture"
    assert LIBRARY not in text
    # The library shows its picture at a twentieth of its strength on white until its light is loaded.
    assert "#root canvas{opacity:1!important}" in text
    assert text.rstrip().endswith("</html>")
    assert page_text("something else") == "something else"
    assert viser.__version__


def test_victims_are_found_only_where_a_robot_can_find_them():
    drawing, facts = drawing_of(1), BoardFacts(victims=3)
    for world, text in ((drawing, "<td>victims</td><td>3</td>"), (with_victim_sensors(drawing), "0 of 3")):
        assert text in board_html("yard", world, frame_of(drawing), facts, MissionLog())


def test_clocks_count_minutes():
    assert [clock(seconds) for seconds in (0.0, 59.9, 61.0, -3.0)] == ["0:00", "0:59", "1:01", "0:00"]
