"""Small live plots of what a robot's sensors measure, in the page's sidebar."""

from collections import deque
from typing import cast

import numpy as np
import viser
from viser import uplot

from usarmjx.view.drawing import DrawnRobot, RobotFrame

MAX_LINES = 6
"""A reading of no more numbers is plotted over time, one line each; a longer one over its numbers."""
MAX_POINTS = 240
"""So many points a plot has at most."""
MAX_PLOTS = 10
"""So many sensors of a robot have plots."""
WINDOW = 20.0
"""Plots over time show so much of it [s]."""
HEIGHT = 110
"""Of a plot [pixels]."""
LINE_RGB = ("#4a90e2", "#e2574a", "#3cab5a", "#c58b1b", "#8d5fd3", "#5d7d8c")


class SensorPlot:
    """What one sensor measures: over time, or where it measures much at once, over its numbers.

    Args:
        gui: Whose page.
        title: What stands over it.
        size: How many numbers a reading has.
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
        if self._past and time < self._past[-1][0]:
            self._past.clear()
        elif self._past and time == self._past[-1][0]:  # it stands still
            self._past.pop()
        self._past.append(np.array([time, *values]))
        while time - self._past[0][0] > WINDOW:
            self._past.popleft()
        if len(self._past) > 1:
            self._plot.data = tuple(np.array(self._past).T.copy())


def _line(number: int) -> dict[str, object]:
    return {"stroke": LINE_RGB[number % len(LINE_RGB)], "width": 1.5, "points": {"show": False}}


class RobotPlots:
    """Plots of a robot's sensors; they go where the present container of the GUI is.

    Args:
        gui: Whose page.
        robot: The robot.
        frame: What is known of it now.
    """

    def __init__(self, gui: viser.GuiApi, robot: DrawnRobot, frame: RobotFrame) -> None:
        self._plots: dict[int, SensorPlot] = {}
        for index, (sensor, reading) in enumerate(zip(robot.sensors, frame.readings, strict=False)):
            size = int(np.size(reading))
            if size and len(self._plots) < MAX_PLOTS:
                title = sensor.kind if len(sensor.names) != 1 else f"{sensor.kind} {sensor.names[0]}"
                self._plots[index] = SensorPlot(gui, title, size)

    def update(self, time: float, frame: RobotFrame) -> None:
        """Show what the robot has measured at a simulated time [s]."""
        for index, plot in self._plots.items():
            if index < len(frame.readings):
                plot.update(time, np.asarray(frame.readings[index]))
