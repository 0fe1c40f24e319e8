"""Panels of the page's users: the controls, their lock, and the chosen robot's state."""

import html
import math
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np
import viser
from scipy.spatial.transform import Rotation
from viser import uplot

from usarmjx.view.controls import BY_CLIENT, BY_PAGE, BY_POLICY, ControlLock, WorldControls, WorldStatus
from usarmjx.view.drawing import Drawing, DrawnRobot, Frame, RobotFrame
from usarmjx.view.robot_controls import RobotControls, RunControls, SpawnForm, when_taken

if TYPE_CHECKING:
    from usarmjx.view.page import ViewerPage


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
UPDATE_PERIOD = 0.25
"""Interval between two updates of numbers and plots [s]."""
TOAST_PERIOD = 2.0
"""Least interval between two notifications of failures [s]."""
NO_ROBOT: str = "none"
TAKE, LEAVE = "Take the controls", "Give the controls back"


class SensorPlot:
    """Plot of one sensor: over time, or for a long reading over its indices.

    Args:
        gui: GUI of the user.
        title: Title of the plot.
        size: Length of a reading.
    """

    def __init__(self, gui: viser.GuiApi, title: str, size: int) -> None:
        self._over_time = size <= MAX_LINES
        self._past: deque[np.ndarray] = deque(maxlen=MAX_POINTS)
        lines = size if self._over_time else 1
        series = ({"label": "t" if self._over_time else "n"}, *map(_line, range(lines)))
        self._plot = gui.add_uplot(
            tuple(np.zeros(2) for _ in range(lines + 1)),
            cast(tuple[uplot.Series, ...], series),
            title=title,
            # uPlot takes x as seconds since 1970 otherwise, and writes dates.
            scales={"x": cast(uplot.Scale, {"time": False})},
            legend=cast(uplot.Legend, {"show": False}),
            height=HEIGHT,
        )

    def update(self, time: float, reading: np.ndarray) -> None:
        """Show a reading at a simulated time [s]."""
        # An infinity would spoil the plot's scale; NaN leaves a gap.
        values = np.where(np.isfinite(reading), reading, np.nan).astype(float).ravel()
        if not self._over_time:
            # Rounded up, so that no more than `MAX_POINTS` are left.
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
        # A single point has no line.
        if len(self._past) > 1:
            # Copied, as rows of a transposed array are not contiguous in memory.
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
            # The number of lines is fixed: a sensor that has not measured yet gets no plot.
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
        # Each assignment is a message to the browser, even of an equal text.
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
    # Capital letters are SciPy's intrinsic rotations: yaw first, then pitch and roll in the turned axes.
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
        # Angles of wheels grow without bound and tell nothing.
        if "wheel" not in name.lower()
    ]
    return ", ".join(turned[:MAX_JOINTS]) + (" ..." if len(turned) > MAX_JOINTS else "")


class UserPanels:
    """A `page.Panel`: a banner for all, and a panel for each user.

    Args:
        page: The page.
        lock: Lock of the controls; None: no user can have them.
    """

    def __init__(self, page: "ViewerPage", lock: ControlLock | None = None) -> None:
        self._page, self._lock = page, lock or ControlLock(allowed=False)
        self._banner_text = ""
        self._banner = page.server.gui.add_html("")
        self._people: dict[int, UserPanel] = {}
        self._next_update = 0.0
        # At once, in viser's thread: robots must stop although no update follows when the last user leaves.
        page.server.on_client_disconnect(lambda client: self._leave(client.client_id))

    def begin(self, drawing: Drawing) -> None:
        """Show other robots, or another world."""
        for person in self._people.values():
            person.begin(drawing, self._page.frame)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the present frame of the world."""
        now = time.monotonic()
        if now < self._next_update:
            return
        self._next_update = now + UPDATE_PERIOD
        controls, viewers = self._page.controls, self._page.viewers
        status = None if controls is None else controls.status(self._page.world)
        if status is not None:
            self._show_banner(status)
        # Nothing to remove: viser has dropped the GUI of a user who has left.
        for number in self._people.keys() - viewers.keys():
            del self._people[number]
        for number, viewer in list(viewers.items()):
            if number not in self._people:
                # A user's elements are ordered with the server's: below the banner of all.
                order = self._banner.order
                self._people[number] = UserPanel(self._page, viewer.client, self._lock, order)
                self._people[number].begin(drawing, frame)
            self._people[number].update(frame, status, viewer.robot)

    def _show_banner(self, status: WorldStatus) -> None:
        text = banner_html(status, self._lock)
        if text != self._banner_text:
            self._banner.content = self._banner_text = text

    def _leave(self, person: int) -> None:
        if self._lock.leave(person) and self._page.controls is not None:
            self._page.controls.release_all()


def banner_html(status: WorldStatus, lock: ControlLock) -> str:
    """Return the status of a world, in a few lines."""
    goes = "paused" if status.paused else f"x {status.realtime_factor:.2f} real time"
    held = "" if not lock.allowed else ", somebody has the controls" if lock.holder is not None else ""
    lines = [f"<b>{status.time:.1f} s</b>, {goes}, {_clients(status.connections)}{held}"]
    if status.bad_worlds:
        lines.append(f"physics went bad: world reset {status.bad_worlds} times")
    if status.put_back:
        # Escaped: clients name their robots.
        names = ", ".join(status.put_back_names)
        lines.append(f"{status.put_back} put back, last {html.escape(names)}")
    return f'<div style="font-size:.85em;margin:0 1em .5em">{"<br>".join(lines)}</div>'


def _clients(count: int) -> str:
    return f"{count} client{'s' * (count != 1)} connected"


class UserPanel:
    """Panel of one user.

    Args:
        page: The page.
        client: The user.
        lock: Lock of the controls.
        order: Sort key of its first element.
    """

    def __init__(
        self, page: "ViewerPage", client: viser.ClientHandle, lock: ControlLock, order: float
    ) -> None:
        self._page, self._client, self._lock, self._order = page, client, lock, order
        self._slot: int | None = None
        self._followed: int | None = None
        self._held = False
        self._errors, self._toast_due = 0, 0.0
        self._shown_world: tuple[int, str] | None = None
        self._names: dict[int, str] = {}
        self._folders: dict[str, viser.GuiFolderHandle] = {}
        self._run: RunControls | None = None
        self._robot: tuple[object, RobotReadout, RobotControls | None] | None = None
        self._take = client.gui.add_button(TAKE, order=order + 0.1, visible=False)
        self._take.on_click(lambda _: self._toggle_control())
        nobody: tuple[str, ...] = (NO_ROBOT,)
        self._choice = client.gui.add_dropdown("Robot", nobody, order=order + 0.4)
        # Posted: the callback runs on a thread of viser's, what it changes belongs to the page's.
        self._choice.on_update(lambda _: page.post(self._chosen))

    @property
    def _controls(self) -> WorldControls | None:
        return self._page.controls

    def may(self) -> bool:
        """Return whether this user has the controls."""
        return self._lock.holder == self._client.client_id

    def do(self, act: Callable[[], None]) -> None:
        """Run an action, if this user has the controls."""
        if self.may():
            act()

    def begin(self, drawing: Drawing, frame: Frame) -> None:
        """Show other robots, or another world."""
        self._names = names = _names(drawing)
        if self._slot not in names:
            self._slot = None
        options = (NO_ROBOT, *names.values())
        if tuple(self._choice.options) != options:
            self._choice.options = options
        self._choice.value = NO_ROBOT if self._slot is None else names[self._slot]
        # Start poses are those of an arena, so its form must change with it.
        if self._held and self._shown_world != (self._page.world, drawing.arena):
            self._show_run(drawing)
        self._show_robot(drawing, frame)

    def update(self, frame: Frame, status: WorldStatus | None, followed: int | None) -> None:
        """Show the present frame of the world.

        Args:
            frame: The frame.
            status: Status of the world; None: it is only shown.
            followed: Slot of the robot that this user's view is attached to; None: none.
        """
        drawing = self._page.drawing
        # Only when that changes, or the next update would undo a user's choice.
        if followed != self._followed:
            self._followed = followed
            if followed is not None and followed in self._names:
                self._choice.value = self._names[followed]
                self._slot = followed
        if self._held != self.may():
            self._held = self.may()
            # Failures from before are those of whoever had the controls.
            self._errors = 0 if status is None else status.errors
            self._show_run(drawing)
        self._show_robot(drawing, frame)
        self._show_lock(status)
        if self._robot is not None:
            self._robot[1].update(frame, status)
        if status is not None and self._held:
            if self._run is not None:
                self._run.update(status)
            if self._robot is not None and self._robot[2] is not None:
                self._robot[2].update(status)
            self._toast(status)

    def _chosen(self) -> None:
        slots = {name: slot for slot, name in self._names.items()}
        self._slot = slots.get(self._choice.value)

    def _toggle_control(self) -> None:
        person = self._client.client_id
        if not self.may():
            self._lock.take(person)
        elif self._lock.leave(person) and self._controls is not None:
            self._controls.release_all()

    def _show_lock(self, status: WorldStatus | None) -> None:
        visible = status is not None and self._lock.allowed and (self.may() or self._lock.holder is None)
        if self._take.visible != visible:
            self._take.visible = visible
        label = LEAVE if self.may() else TAKE
        if self._take.label != label:
            self._take.label = label

    def _folder(self, title: str, offset: float, expanded: bool = True) -> viser.GuiFolderHandle:
        """Return a new folder that replaces the one of that title."""
        self._drop(title)
        order = self._order + offset
        self._folders[title] = self._client.gui.add_folder(title, order=order, expand_by_default=expanded)
        return self._folders[title]

    def _drop(self, title: str) -> None:
        folder = self._folders.pop(title, None)
        if folder is not None:
            folder.visible = False
            # Of messages that the browser takes together, it carries out removals before changes of values,
            # and reports an error for those of elements that are gone.
            when_taken(self._client, self._page.post, folder.remove)

    def _show_run(self, drawing: Drawing) -> None:
        """Show the user's controls of the world."""
        controls, world = self._controls, self._page.world
        self._run, self._shown_world = None, (world, drawing.arena)
        if not self._held or controls is None:
            self._drop("Run")
            self._drop("New robot")
            return
        with self._folder("Run", 0.2):
            self._run = RunControls(self._client, world, controls, self.do)
        with self._folder("New robot", 0.3, expanded=False):
            SpawnForm(self._client.gui, world, drawing, controls, self.do)

    def _show_robot(self, drawing: Drawing, frame: Frame) -> None:
        """Show the chosen robot, unless it is shown already."""
        robot = drawing.robots.get(-1 if self._slot is None else self._slot)
        if robot is None or robot.slot not in frame.robots:
            self._robot = None
            self._drop("Robot state")
            return
        # With name and class, as a slot may go to another robot between two updates.
        key = self._page.world, robot.slot, robot.name, robot.robot, self._held
        if self._robot is not None and self._robot[0] == key:
            return
        commands = None
        with self._folder("Robot state", 0.5):
            if self._held and self._controls is not None:
                commands = RobotControls(
                    self._client, robot, frame, self._page.world, self._controls, self.may
                )
            state = RobotReadout(self._client.gui, robot, frame)
        self._robot = key, state, commands

    def _toast(self, status: WorldStatus) -> None:
        """Notify the user of a failed request."""
        now = time.monotonic()
        if status.errors > self._errors and now >= self._toast_due:
            self._errors, self._toast_due = status.errors, now + TOAST_PERIOD
            # Several failures between two notifications show as the last of them.
            self._client.add_notification("Not done", status.last_error, auto_close_seconds=8.0, color="red")


def _names(drawing: Drawing) -> dict[int, str]:
    """Return the robots' names for a list, by slot: equal names get their slots."""
    # A list in the page returns the chosen name, which must say which robot is meant.
    names = [robot.name for robot in drawing.robots.values()]
    return {
        slot: robot.name if names.count(robot.name) == 1 else f"{robot.name} ({slot})"
        for slot, robot in drawing.robots.items()
    }
