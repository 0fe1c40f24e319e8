"""State of one robot beside the picture: pose, battery, live plots."""

import html
import math
from collections import deque
from typing import cast

import numpy as np
import viser
from scipy.spatial.transform import Rotation
from viser import uplot

from usarmjx.view.controls import BY_CLIENT, BY_PAGE, BY_POLICY, WorldStatus
from usarmjx.view.drawing import DrawnRobot, Frame, RobotFrame

MAX_LINES = 6
"""Longest reading that is plotted over time, a line per number; a longer one is plotted over its indices."""
MAX_POINTS = 240
"""Most points of a plot."""
MAX_PLOTS = 10
"""Most sensors of a robot with plots."""
WINDOW = 20.0
"""Time span of plots over time [s]."""
HEIGHT = 110
"""Height of a plot [pixels]."""
LINE_RGB = ("#4a90e2", "#e2574a", "#3cab5a", "#c58b1b", "#8d5fd3", "#5d7d8c")
DRIVEN_BY = {BY_PAGE: "from this page", BY_CLIENT: "by its client", BY_POLICY: "by a policy"}
MAX_JOINTS = 12
"""Most joints in the table of the state."""
LOW_BATTERY = 0.2
"""Share of the battery up to which its bar is red."""


class SensorPlot:
    """Plot of one sensor: over time, or for a long reading over its indices.

    Args:
        gui: GUI of the user.
        title: Title of the plot.
        size: Length of a reading.
    """

    def __init__(self, gui: viser.GuiApi, title: str, size: int) -> None:
        self._over_time, self._size = size <= MAX_LINES, size
        self._past: deque[np.ndarray] = deque(maxlen=MAX_POINTS)
        lines = size if self._over_time else 1
        series = ({"label": "t" if self._over_time else "n"}, *map(_line, range(lines)))
        self._plot = gui.add_uplot(
            tuple(np.zeros(2) for _ in range(lines + 1)),
            cast(tuple[uplot.Series, ...], series),
            title=title,
            scales={"x": cast(uplot.Scale, {"time": False})},
            legend=cast(uplot.Legend, {"show": False}),
            height=HEIGHT,
        )

    def update(self, time: float, reading: np.ndarray) -> None:
        """Show a reading at a simulated time [s]."""
        values = np.where(np.isfinite(reading), reading, np.nan).astype(float).ravel()
        if not self._over_time:
            values = values[:: -(-len(values) // MAX_POINTS)]
            self._plot.data = (np.arange(len(values), dtype=float), values)
            return
        # A reset, a seek or another world has moved the time backwards.
        if self._past and time < self._past[-1][0]:
            self._past.clear()
        elif self._past and time == self._past[-1][0]:  # the world is paused
            self._past.pop()
        self._past.append(np.array([time, *values]))
        while time - self._past[0][0] > WINDOW:
            self._past.popleft()
        if len(self._past) > 1:
            self._plot.data = tuple(np.array(self._past).T.copy())


def _line(number: int) -> dict[str, object]:
    return {"stroke": LINE_RGB[number % len(LINE_RGB)], "width": 1.5, "points": {"show": False}}


class RobotPlots:
    """Plots of a robot's sensors; they go into the present container of the GUI.

    Args:
        gui: GUI of the user.
        robot: The robot.
        frame: Its present frame.
    """

    def __init__(self, gui: viser.GuiApi, robot: DrawnRobot, frame: RobotFrame) -> None:
        self._plots: dict[int, SensorPlot] = {}
        for index, (sensor, reading) in enumerate(zip(robot.sensors, frame.readings, strict=False)):
            size = int(np.size(reading))
            if size and len(self._plots) < MAX_PLOTS:
                title = sensor.kind if len(sensor.names) != 1 else f"{sensor.kind} {sensor.names[0]}"
                self._plots[index] = SensorPlot(gui, title, size)

    def update(self, time: float, frame: RobotFrame) -> None:
        """Show the robot's readings at a simulated time [s]."""
        for index, plot in self._plots.items():
            if index < len(frame.readings):
                plot.update(time, np.asarray(frame.readings[index]))


class RobotReadout:
    """State and sensors of a robot; they go into the present container of the GUI.

    Args:
        gui: GUI of the user.
        robot: The robot.
        frame: Present frame of the world.
    """

    def __init__(self, gui: viser.GuiApi, robot: DrawnRobot, frame: Frame) -> None:
        self._robot = robot
        self._text = ""
        self._state = gui.add_html("")
        with gui.add_folder("Sensors"):
            self._plots = RobotPlots(gui, robot, frame.robots[robot.slot])

    def update(self, frame: Frame, status: WorldStatus | None) -> None:
        """Show the present state of the robot."""
        now = frame.robots.get(self._robot.slot)
        if now is None:
            return
        driver = None if status is None else status.drivers.get(self._robot.slot)
        text = state_html(self._robot, now, driver)
        if text != self._text:
            self._state.content = self._text = text
        self._plots.update(frame.time, now)


def state_html(robot: DrawnRobot, frame: RobotFrame, driver: str | None = None) -> str:
    """Return a table of a robot's state.

    Args:
        robot: The robot.
        frame: The robot now.
        driver: Its driver; None: unknown.
    """
    yaw, pitch, roll = Rotation.from_quat(frame.quat, scalar_first=True).as_euler("ZYX", degrees=True)
    x, y, z = frame.pos
    rows = [
        ("class", html.escape(robot.robot)),
        ("driven", DRIVEN_BY.get(driver, html.escape(driver))) if driver else ("", ""),
        ("at", f"{x:.2f}, {y:.2f}, {z:.2f} m"),
        ("roll, pitch, yaw", f"{roll:.0f}, {pitch:.0f}, {yaw:.0f}&deg;"),
        ("speed", f"{math.hypot(*frame.linear):.2f} m/s"),
        ("battery", _battery(frame.battery, robot.battery_life)),
        ("headlight", "on" if frame.light else "off"),
        (
            "DRIVE",
            ", ".join(
                f"{key} {value:.2g}" for key, value in zip(robot.drive_keys, frame.drive, strict=False)
            ),
        ),
        ("joints", _joints(robot, frame)),
    ]
    cells = "".join(f"<tr><td>{name}</td><td>{text}</td></tr>" for name, text in rows if text)
    return (
        "<style>.robotstate{font-size:.8em;margin:0 1em .5em;width:calc(100% - 2em)}"
        ".robotstate td:first-child{opacity:.65;padding-right:.8em;white-space:nowrap;vertical-align:top}"
        "</style>"
        f'<table class="robotstate">{cells}</table>'
    )


def _battery(left: float, life: float) -> str:
    share = max(0.0, min(1.0, left / life)) if life > 0 else 0.0
    colour = "#3cab5a" if share > LOW_BATTERY else "#e2574a"
    bar = (
        '<span style="display:inline-block;width:5em;height:.6em;background:#8884;border-radius:.3em">'
        f'<span style="display:block;width:{100 * share:.0f}%;height:100%;background:{colour};'
        'border-radius:.3em"></span></span>'
    )
    return f"{bar} {100 * share:.0f} %, {left:.0f} s"


def _joints(robot: DrawnRobot, frame: RobotFrame) -> str:
    turned = [
        f"{html.escape(name)} {value:.2f}"
        for name, value in zip(robot.joints, frame.joint_pos, strict=False)
        if "wheel" not in name.lower()
    ]
    return ", ".join(turned[:MAX_JOINTS]) + (" ..." if len(turned) > MAX_JOINTS else "")
