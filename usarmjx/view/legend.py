"""The legend of the page: what the marks mean that are drawn over a world."""

from collections.abc import Callable, Collection
from functools import partial
from typing import NamedTuple

import numpy as np

from usarmjx.sensors.base import Sensor
from usarmjx.sensors.ranging import Ir, RangeScanner, Sonar
from usarmjx.view.drawing import MAP_GRID, Drawing, Frame
from usarmjx.view.layers.base import SCALE
from usarmjx.view.layers.bodies import sensors_of
from usarmjx.view.layers.echoes import IR_RGB
from usarmjx.view.layers.light import BEAM_RGB, BULB_RGB
from usarmjx.view.layers.maps import FREE, MAP_RGBA, MARK, WALL
from usarmjx.view.layers.marks import DROPPED_RGB, TAG_RGB

OWN = "conic-gradient(#00b4ff 25%, #ff4b69 0 50%, #a5ff00 0 75%, #f0b469 0)"
"""Picture of a colour that each robot has of its own."""


def _always(drawing: Drawing, frame: Frame) -> bool:
    del drawing, frame
    return True


class Entry(NamedTuple):
    """A line of the legend.

    Attributes:
        picture: Background of CSS.
        text: Meaning.
        is_there: Whether a world has any of these marks.
    """

    picture: str
    text: str
    is_there: Callable[[Drawing, Frame], bool] = _always


def css_rgb(rgb: Collection[float]) -> str:
    """Return a colour, 0 to 255, in CSS."""
    red, green, blue = (round(channel) for channel in rgb)
    return f"rgb({red},{green},{blue})"


def _has_robots(drawing: Drawing, frame: Frame) -> bool:
    del drawing
    return bool(frame.robots)


def _has_sensor(family: type[Sensor], drawing: Drawing, frame: Frame) -> bool:
    del frame
    return bool(sensors_of(drawing, family))


def _has_trail(drawing: Drawing, frame: Frame) -> bool:
    del drawing
    return frame.trace is not None and bool(np.any(frame.trace.shown))


def _has_tags(drawing: Drawing, frame: Frame) -> bool:
    del frame
    return bool(drawing.tags)


def _has_dropped(drawing: Drawing, frame: Frame) -> bool:
    del drawing
    return len(frame.dropped_tags) > 0


def _has_links(drawing: Drawing, frame: Frame) -> bool:
    del drawing
    return frame.links is not None


def _has_marks(drawing: Drawing, frame: Frame) -> bool:
    del drawing
    return MAP_GRID in frame.extra


def _has_lamps(drawing: Drawing, frame: Frame) -> bool:
    del frame
    return bool((np.asarray(drawing.lamp_rgb) > 0).any())


def _has_headlights(drawing: Drawing, frame: Frame) -> bool:
    del drawing
    return any(robot.light for robot in frame.robots.values())


LINK_SCALE = f"linear-gradient(90deg, {', '.join(css_rgb(rgb) for rgb in SCALE.tolist())})"
MAP_COLOURS = {state: css_rgb(MAP_RGBA[state, :3].tolist()) for state in (FREE, WALL, MARK)}
ENTRIES: dict[str, tuple[Entry, ...]] = {
    "Rings": (Entry(OWN, "robot; the tip of its ring is ahead", _has_robots),),
    "Laser fans": (Entry(OWN, "laser scan, in its robot's colour", partial(_has_sensor, RangeScanner)),),
    "Sonar cones": (Entry(OWN, "sonar, in its robot's colour", partial(_has_sensor, Sonar)),),
    "Infrared lines": (Entry(css_rgb(IR_RGB.tolist()), "infrared sensor", partial(_has_sensor, Ir)),),
    "Trails": (Entry(OWN, "trail of a robot", _has_trail),),
    "Tags": (
        Entry(css_rgb(TAG_RGB), "radio tag (RFID) with its number", _has_tags),
        Entry(css_rgb(DROPPED_RGB), "tag that a robot dropped", _has_dropped),
    ),
    "Radio links": (Entry(LINK_SCALE, "radio link, weak to strong", _has_links),),
    "Map": (
        Entry(MAP_COLOURS[FREE], "map: free"),
        Entry(MAP_COLOURS[WALL], "map: wall"),
        Entry(MAP_COLOURS[MARK], "map: found", _has_marks),
    ),
    "Lamps": (Entry(css_rgb(BULB_RGB), "lamp", _has_lamps),),
    "Headlights": (Entry(css_rgb(BEAM_RGB), "headlight", _has_headlights),),
}
"""Lines by the names of layers; the others explain themselves."""


def legend_html(layers: Collection[str], drawing: Drawing, frame: Frame) -> str:
    """Return the legend of the marks that are drawn, as HTML.

    Args:
        layers: Names of the layers that are on.
        drawing: Drawing of the world.
        frame: Its present frame.
    """
    shown = [
        entry
        for name, entries in ENTRIES.items()
        if name in layers
        for entry in entries
        if entry.is_there(drawing, frame)
    ]
    return "".join(f'<div><i style="background:{entry.picture}"></i>{entry.text}</div>' for entry in shown)
