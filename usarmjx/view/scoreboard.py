"""The scoreboard of the page: task, score, victims, map, robots, events; and the legend of its marks."""

import html
import math
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.sensors.base import Sensor
from usarmjx.sensors.ranging import Ir, RangeScanner, Sonar
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX, Drawing, DrawnRobot, Frame, RobotFrame
from usarmjx.view.layers.base import SCALE, robot_colors
from usarmjx.view.layers.bodies import sensors_of
from usarmjx.view.layers.echoes import IR_RGB
from usarmjx.view.layers.light import BEAM_RGB, BULB_RGB
from usarmjx.view.layers.maps import FREE, MAP_RGBA, MARK, UNKNOWN, WALL
from usarmjx.view.layers.marks import DROPPED_RGB, TAG_RGB

if TYPE_CHECKING:
    from usarmjx.view.page import ViewerPage


OWN = "conic-gradient(#00b4ff 25%, #ff4b69 0 50%, #a5ff00 0 75%, #f0b469 0)"
"""Picture of a colour that each robot has of its own."""
UPDATE_PERIOD = 0.5
"""Interval between two updates [s]."""
MAX_EVENTS, MAX_ROBOTS = 6, 16
"""Most events and most robots on the scoreboard."""
STANDING_SPEED = 0.03
"""Speed up to which a robot stands [m/s]."""
TIPPED_COSINE = 0.5
"""Cosine of the lean from which a robot has tipped over."""
LOW_BATTERY = 0.2
"""Share of the battery up to which its bar is red."""
VICTIM_SENSOR = "VictSensor"


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


@dataclass(frozen=True, eq=False)
class BoardFacts:
    """Facts of a world that its drawing and its frames lack.

    Attributes:
        task: Name of the task; empty: none.
        time_left: Time until the episode ends [s]; None: unknown.
        owners: Victim of each row of a victim sensor's reading, negative for none (rows,).
        victims: Number of victims.
    """

    task: str = ""
    time_left: float | None = None
    owners: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    victims: int = 0


class MissionLog:
    """Events of a world: robots that come, go, tip over or run out of battery, and victims that are found.

    Attributes:
        events: The last ones, each with its simulated time [s].
        found: Time and robot of each found victim.
    """

    def __init__(self) -> None:
        self.events: deque[tuple[float, str]] = deque(maxlen=MAX_EVENTS)
        self.found: dict[int, tuple[float, str]] = {}
        self._states: dict[str, str] | None = None
        self._time = -math.inf

    def update(self, drawing: Drawing, frame: Frame, facts: BoardFacts) -> None:
        """Take the present frame; a time before the last one begins anew."""
        # A reset, or a seek in a recording.
        if frame.time < self._time:
            self.events.clear()
            self.found.clear()
            self._states = None
        self._time = frame.time
        robots = {slot: drawing.robots[slot] for slot in frame.robots if slot in drawing.robots}
        # By name: another robot may have taken the slot since the last frame.
        states = {robot.name: state_of(robot, frame.robots[slot]) for slot, robot in robots.items()}
        # Not at the first frame: who is there from the start does not join.
        if self._states is not None:
            for name, state in states.items():
                if name not in self._states:
                    self._add(f"{name} joins")
                elif state != self._states[name] and state in EVENTS:
                    self._add(f"{name} {EVENTS[state]}")
            for name in self._states.keys() - states.keys():
                self._add(f"{name} leaves")
        self._states = states
        for slot, robot in robots.items():
            for victim in seen_victims(robot, frame.robots[slot], facts.owners):
                # The first robot counts: sensors see a victim in every reading from then on.
                if victim not in self.found:
                    self.found[victim] = frame.time, robot.name
                    self._add(f"{robot.name} found victim {victim + 1}")

    def _add(self, text: str) -> None:
        self.events.appendleft((self._time, text))


EVENTS: Mapping[str, str] = {"tipped over": "tips over", "no battery": "has no battery left"}
"""Events by the states that they lead to."""
HEADINGS = "<tr><th>robot</th><th>state</th><th>battery</th><th>radio</th></tr>"


def state_of(robot: DrawnRobot, frame: RobotFrame) -> str:
    """Return the state of a robot in a word or two."""
    if robot.battery_life > 0 and frame.battery <= 0:
        return "no battery"
    # For one small matrix JAX would take longer to call than to compute.
    with numpy_backend():
        up = float(np.asarray(mat_from_quat(np.asarray(frame.quat, float)))[2, 2])
    if up < TIPPED_COSINE:
        return "tipped over"
    return "moves" if math.hypot(*frame.linear) > STANDING_SPEED else "stands"


def seen_victims(robot: DrawnRobot, frame: RobotFrame, owners: np.ndarray) -> list[int]:
    """Return the victims that a robot's victim sensors see."""
    found: set[int] = set()
    for sensor, reading in zip(robot.sensors, frame.readings, strict=False):
        value = np.asarray(reading)
        # A reading whose rows do not fit `owners` is that of another arena, or of a source without facts.
        if sensor.kind == VICTIM_SENSOR and value.ndim == 2 and len(value) == len(owners):
            found |= {int(owner) for owner in owners[(value[:, 0] > 0) & (owners >= 0)]}
    return sorted(found)


def _can_find(drawing: Drawing) -> bool:
    """Return whether a robot has a victim sensor."""
    return any(sensor.kind == VICTIM_SENSOR for robot in drawing.robots.values() for sensor in robot.sensors)


def known_area(frame: Frame) -> float | None:
    """Return the area that the robots' maps know together [m2]; None without maps."""
    grid = frame.extra.get(MAP_GRID)
    # The grid's own name begins with the same prefix.
    maps = [value for name, value in frame.extra.items() if name.startswith(MAP_PREFIX) and name != MAP_GRID]
    if grid is None or not maps:
        return None
    # Together and not added up: robots map the same squares.
    known = np.any([one != UNKNOWN for one in maps], axis=0)
    # The third number of the grid is the side of a square [m].
    return float(known.sum() * grid[2] ** 2)


def board_html(
    title: str,
    drawing: Drawing,
    frame: Frame,
    facts: BoardFacts,
    log: MissionLog,
    layers: Collection[str] = (),
) -> str:
    """Return the scoreboard and the legend as HTML; `page` puts them over the picture.

    Args:
        title: Name of the world.
        drawing: Drawing of the world.
        frame: Its present frame.
        facts: Further facts of the world.
        log: Events of the world.
        layers: Names of the layers that are on.
    """
    lines = [("task", html.escape(facts.task)), ("time", clock(frame.time))]
    if facts.time_left is not None:
        lines.append(("time left", clock(facts.time_left)))
    if frame.score is not None:
        lines.append(("score", f"{frame.score:.1f}"))
    if facts.victims and _can_find(drawing):
        lines.append(("victims found", f"{len(log.found)} of {facts.victims}"))
    # Without a victim sensor no count of found ones can rise: only their number is shown.
    elif facts.victims:
        lines.append(("victims", f"{facts.victims}"))
    area = known_area(frame)
    if area is not None:
        lines.append(("explored", f"{area:.0f} m&sup2;"))
    # A world without a task has an empty text in the first line.
    cells = "".join(f"<tr><td>{name}</td><td>{text}</td></tr>" for name, text in lines if text)
    slots = [slot for slot in sorted(frame.robots) if slot in drawing.robots]
    robots = HEADINGS if slots else ""
    robots += "".join(_robot_row(drawing.robots[slot], frame, slot) for slot in slots[:MAX_ROBOTS])
    more = (
        f"<tr><td colspan=4>and {len(slots) - MAX_ROBOTS} more</td></tr>" if len(slots) > MAX_ROBOTS else ""
    )
    # Escaped: names in it come from clients.
    events = "".join(f"<li>{clock(at)} {html.escape(text)}</li>" for at, text in log.events)
    return (
        f'<div class="usarmjx-board" data-world="{html.escape(title, quote=True)}">'
        f"<div><table>{cells}</table><table>{robots}{more}</table><ul>{events}</ul></div>"
        f"<div>{legend_html(layers, drawing, frame)}</div></div>"
    )


def _robot_row(robot: DrawnRobot, frame: Frame, slot: int) -> str:
    now = frame.robots[slot]
    red, green, blue = robot_colors(np.array(slot)).tolist()
    share = min(1.0, max(0.0, now.battery / robot.battery_life)) if robot.battery_life > 0 else 0.0
    colour = "#3cab5a" if share > LOW_BATTERY else "#e2574a"
    return (
        f'<tr><td><i style="background:rgb({red},{green},{blue})"></i>{html.escape(robot.name)}</td>'
        f"<td>{state_of(robot, now)}</td>"
        f'<td><b title="battery {share:.0%}"><s style="width:{share:.0%};background:{colour}"></s></b></td>'
        f"<td>{_link(frame, slot)}</td></tr>"
    )


def _link(frame: Frame, slot: int) -> str:
    """Return the number of robots that one hears; empty without a radio."""
    if frame.links is None:
        return ""
    heard = np.asarray(frame.links.in_range)[slot]
    count = sum(bool(heard[other]) for other in frame.robots if other != slot and other < len(heard))
    return f"{count} link{'' if count == 1 else 's'}" if count else "no link"


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    # Rounded down, or a clock would show a second that has not yet passed.
    whole = max(0, math.floor(seconds))
    return f"{whole // 60}:{whole % 60:02d}"


class ScoreboardPanel:
    """A `page.Panel`: the scoreboard of the chosen world.

    Args:
        page: The page.
    """

    def __init__(self, page: "ViewerPage") -> None:
        self._page = page
        self._logs: dict[int, MissionLog] = {}
        # First in the sidebar, whichever panels come later; the page's script moves it over the picture.
        self._shown = page.server.gui.add_html("", order=-1000)
        self._text, self._due = "", 0.0
        self._world: int | None = None

    def begin(self, drawing: Drawing) -> None:
        """Do nothing: the next update shows the new drawing."""
        del drawing

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the present frame of the world."""
        now, world = time.monotonic(), self._page.world
        # Another world at once, or the old one's board would stand beside it.
        if now < self._due and world == self._world:
            return
        self._due, self._world = now + UPDATE_PERIOD, world
        facts = board_facts(self._page.source, world)
        # One for each world: a user who comes back to a world finds its events.
        log = self._logs.setdefault(world, MissionLog())
        log.update(drawing, frame, facts)
        layers = [layer.name for layer in self._page.layers_on]
        number = f" {world}" if self._page.source.num_worlds > 1 else ""
        text = board_html(f"{self._page.title or drawing.arena}{number}", drawing, frame, facts, log, layers)
        # Each assignment is a message to all browsers, even of an equal text.
        if text != self._text:
            self._shown.content = self._text = text


def board_facts(source: object, world: int) -> BoardFacts:
    """Return the facts of a source's world; without a method for them there are none."""
    facts = getattr(source, "board_facts", None)
    return BoardFacts() if facts is None else facts(world)
