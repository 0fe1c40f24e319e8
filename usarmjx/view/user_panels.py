"""Panels of the page's users: the controls, their lock, and the chosen robot's state."""

import html
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import viser

from usarmjx.view.controls import ControlLock, WorldControls, WorldStatus
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.receipts import when_taken
from usarmjx.view.robot_controls import RobotControls, RunControls, SpawnForm
from usarmjx.view.robot_panel import RobotReadout

if TYPE_CHECKING:
    from usarmjx.view.page import ViewerPage

UPDATE_PERIOD = 0.25
"""Interval between two updates of numbers and plots [s]."""
TOAST_PERIOD = 2.0
"""Least interval between two notifications of failures [s]."""
NO_ROBOT: str = "none"
TAKE, LEAVE = "Take the controls", "Give the controls back"


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
        for number in self._people.keys() - viewers.keys():
            del self._people[number]
        for number, viewer in list(viewers.items()):
            if number not in self._people:
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
        if followed != self._followed:
            self._followed = followed
            if followed is not None and followed in self._names:
                self._choice.value = self._names[followed]
                self._slot = followed
        if self._held != self.may():
            self._held = self.may()
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
            self._client.add_notification("Not done", status.last_error, auto_close_seconds=8.0, color="red")


def _names(drawing: Drawing) -> dict[int, str]:
    """Return the robots' names for a list, by slot: equal names get their slots."""
    names = [robot.name for robot in drawing.robots.values()]
    return {
        slot: robot.name if names.count(robot.name) == 1 else f"{robot.name} ({slot})"
        for slot, robot in drawing.robots.items()
    }
