"""The spectator's console (manual 5.1): `showlog`, `showdebug`, `editactor` and `pause`, as lines of text.

The live page has one for each user. The thread that runs the world runs the lines, too.

`editactor` changes parameters of a robot or sensor while it runs: `editactor name=R1 maxSpinSpeed=3`,
`editactor class=Sonar MaxRange=2.5`, `editactor name=R1 sensor=Scanner1 ScanInterval=0.1`; without a
parameter it lists the present ones. It changes the robots that are there now; a robot that joins later has
its class's own. All but `Battery` need a world of engine `c`: other engines compile robots.
"""

import dataclasses
import html
import shlex
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from usarmjx.base.errors import UnknownNameError, UsageError, UsarmjxError
from usarmjx.base.transforms import angles_from_mat
from usarmjx.models.ini.parameters import SETTERS
from usarmjx.models.types.robot import (
    Mount,
    RobotSpec,
    checked,
    field_name,
    field_names,
    manual_keys,
    resolve_settings,
)
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.cameras.mounts import CameraSettings, resolve_camera
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import clip, two_decimals_list
from usarmjx.server.runtime.logs import MAX_KEPT_LINES, LogTail
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.view.controls import ControlLock
from usarmjx.view.drawing import Drawing, Frame

MAX_ANSWERS = 8000
"""Longest text of answers that stays [characters]."""
MANY_UPDATES = 20
"""Number of the last updates from which the frame rate is computed."""
TAKE_THEM = "take the controls first"
SOMEBODY_ELSE = "this is for who has the controls, and that is somebody else"
STYLE = "font-size:.75em;margin:0 1em .5em;max-height:16em;overflow:auto;white-space:pre-wrap"
EVERY_ROBOT = "KRobot"
"""Base class of all robots in the original."""
BATTERY = "Battery"
"""Parameter that is no property of the class: remaining time of the battery [s]."""
PARAMETERS: dict[str, tuple[float, float]] = {
    BATTERY: (0.0, 1e6),
    "batteryLife": (0.0, 1e6),
    "msgTimer": (0.02, 60.0),
    "Weight": (1e-3, 1e5),
    "ChassisMass": (0.01, 100.0),
    "MaxTorque": (0.01, 1e4),
    "MotorTorque": (0.01, 1e4),
    "MotorSpeed": (1e-3, 100.0),
    "maxSpinSpeed": (1e-3, 1e3),
    "SteerTorque": (1.0, 1e5),
    "SteerSpeed": (1.0, 1e6),
    "SuspStiffness": (1.0, 1e4),
    "SuspDamping": (0.1, 1e3),
}
"""Parameters of a robot, as in USARBot.ini, with their smallest and largest value (chosen)."""
FIXED = frozenset({"weight", "is_stereo", "omni"})
"""Settings that have no effect while a robot runs, or that would make another camera of one."""
FLAGS = {"true": True, "false": False}
LARGEST = 1e6
"""Largest magnitude of a setting: readings in its unit still fit single precision."""
MOST_STEPS = 2**30
"""Most control steps by which the use of a battery is set back."""
MAX_SHOWN = 30
"""Longest part of a refused number that the answer repeats [characters]."""
SELECTORS = ("class", "name", "sensor")
USAGE = "editactor [class=CLASS] [name=ROBOT] [sensor=NAME] [PARAMETER=VALUE ...]"


@dataclass(frozen=True)
class Selection:
    """Objects to edit.

    Attributes:
        robots: The robots.
        kind: Type of the items on them; "": see `item`.
        item: Name of the items; if both are "", the robots themselves.
    """

    robots: tuple[Robot, ...]
    kind: str = ""
    item: str = ""

    def takes(self, mount: Mount) -> bool:
        """Whether a sensor or camera is selected."""
        if not (self.kind or self.item):
            return False
        kind, name = self.kind.lower(), self.item.lower()
        return kind in ("", mount.kind.lower()) and name in ("", mount.name.lower())


def edit_actor(world: ServedWorld, words: Sequence[str]) -> str:
    """Carry out the words after `editactor`; return the text to show.

    Args:
        world: The served world.
        words: `key=value` each: class, name and sensor select, all others are parameters.

    Raises:
        UsageError: A word, parameter or value is not valid, or nothing is selected; lists the valid ones.
        SpecError: Values that contradict each other. Nothing has changed after either.
    """
    wanted, parameters = _split(words)
    selection = _select(world, wanted)
    if selection.kind or selection.item:
        return _edit_items(world, selection, parameters)
    return _edit_robots(world, selection.robots, parameters)


def _split(words: Sequence[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the selectors and the parameters."""
    wanted: dict[str, str] = {}
    parameters: dict[str, str] = {}
    for word in words:
        key, _, value = word.partition("=")
        if not (key and value):
            raise UsageError(f"{word!r} is not of the form KEY=VALUE; say: {USAGE}")
        if key.lower() in SELECTORS:
            wanted[key.lower()] = value
        else:
            parameters[key] = value
    if not wanted:
        raise UsageError(f"say which one: {USAGE}")
    return wanted, parameters


def _select(world: ServedWorld, wanted: Mapping[str, str]) -> Selection:
    """Return the selection: class is one of robots or a type of sensors, sensor also a camera's name."""
    kind, name = wanted.get("class", ""), wanted.get("name", "").lower()
    present = [robot for _, robot in sorted(world.robots.items())]
    robots = [robot for robot in present if name in ("", robot.name.lower())]
    if kind.lower() in {EVERY_ROBOT.lower(), *(robot.spec.name.lower() for robot in present)}:
        robots = [r for r in robots if kind.lower() in (EVERY_ROBOT.lower(), r.spec.name.lower())]
        # The class has chosen the robots: empty, it selects no items on them.
        kind = ""
    selection = Selection(tuple(robots), kind, wanted.get("sensor", ""))
    of_items = bool(selection.kind or selection.item)
    if not robots or (of_items and not any(map(selection.takes, _mounts(robots)))):
        query = " ".join(f"{key}={value}" for key, value in wanted.items())
        here = ", ".join(f"{robot.name} ({robot.spec.name})" for robot in present) or "none"
        # Without a robot of that name the items of all are listed: the name may be what is wrong.
        items = ", ".join(sorted({f"{mount.kind} {mount.name}" for mount in _mounts(robots or present)}))
        raise UnknownNameError(f"nothing here is {query}; robots: {here}; on them: {items or 'nothing'}")
    return selection


def _mounts(robots: Iterable[Robot]) -> list[Mount]:
    return [mount for robot in robots for mount in (*robot.spec.sensors, *robot.spec.cameras)]


# Robots


def _edit_robots(world: ServedWorld, robots: Sequence[Robot], parameters: Mapping[str, str]) -> str:
    if not parameters:
        return "\n".join(_robot_line(world, robot) for robot in robots)
    values = {_parameter(key): value for key, value in parameters.items()}
    numbers = {key: _in_limits(key, value) for key, value in values.items()}
    # All descriptions before the first change: a refusal leaves all robots as they are.
    specs = {robot: _with_parameters(robot, numbers) for robot in robots}
    _redescribe(world, specs)
    for robot in robots:
        robot.parameters |= {key: value for key, value in numbers.items() if key != BATTERY}
        if BATTERY in numbers:
            _charge(world, robot, numbers[BATTERY])
    return "\n".join(_robot_line(world, robot) for robot in robots)


def _parameter(key: str) -> str:
    """Return a robot's parameter in its own spelling."""
    for known in PARAMETERS:
        if known.lower() == key.lower():
            return known
    raise UnknownNameError(
        f"a robot has no parameter {key!r}; those that can be changed: {', '.join(PARAMETERS)}"
    )


def _in_limits(key: str, text: str) -> float:
    low, high = PARAMETERS[key]
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    # NaN fails every comparison, and is refused only in this form.
    if not low <= value <= high:
        raise UsageError(f"{key} is {text!r}, expected a number from {low:g} to {high:g}")
    return value


def _with_parameters(robot: Robot, numbers: Mapping[str, float]) -> RobotSpec:
    """Return a robot's new description: that of its class with all parameters so far, and new ones."""
    # From the class anew, in the order of SETTERS: the order of edits makes no difference.
    spec, parameters = robot.class_spec, robot.parameters | dict(numbers)
    for key, (_, set_to) in SETTERS.items():
        if key not in parameters:
            continue
        if not _has_effect(spec, key):
            raise UsageError(f"{key} changes nothing: {spec.name} has no joint that it is about")
        spec = set_to(spec, parameters[key])
    # Sensors and cameras may have been edited by themselves.
    return replace(spec, sensors=robot.spec.sensors, cameras=robot.spec.cameras)


def _has_effect(spec: RobotSpec, key: str) -> bool:
    set_to = SETTERS[key][1]
    # A parameter that no joint has makes equal descriptions of two values.
    low, high = PARAMETERS[key]
    return set_to(spec, low or high) != set_to(spec, high / 2)


def _charge(world: ServedWorld, robot: Robot, left: float) -> None:
    """Set the remaining time of a robot's battery [s]; a robot that water has stopped works again."""
    now = int(world.one_world()[0].step)
    # Limited, as `battery_start` is an int32.
    used = round(min((robot.spec.battery_life - left) / world.period, MOST_STEPS))
    world.edit(robot, battery_start=np.int32(now - used), drowned=False)
    robot.drowned = False


def _robot_line(world: ServedWorld, robot: Robot) -> str:
    spec = robot.spec
    known = {BATTERY: world.battery(robot), "batteryLife": spec.battery_life, "msgTimer": spec.msg_timer}
    # The edited parameters come last: they are in force, not those of the class.
    known |= {"Weight": spec.mass, "MaxTorque": spec.max_torque} | robot.parameters
    if spec.drive.max_speed and "maxSpinSpeed" not in known:
        known["maxSpinSpeed"] = spec.drive.max_speed
    shown = " ".join(f"{key}={known[key]:g}" for key in PARAMETERS if key in known)
    rest = ", ".join(key for key in PARAMETERS if key not in known and _has_effect(spec, key))
    return f"{robot.name} ({spec.name}): {shown}" + (f"; also: {rest}" if rest else "")


# Sensors and cameras


def _settings_class(mount: Mount) -> type[Any]:
    return CameraSettings if mount.kind == "Camera" else SENSORS.get(mount.kind).settings_class


def _edit_items(world: ServedWorld, selection: Selection, parameters: Mapping[str, str]) -> str:
    if parameters:
        specs = {robot: _with_settings(robot.spec, selection, parameters) for robot in selection.robots}
        _redescribe(world, specs)
    lines: dict[tuple[str, str, str], list[str]] = {}
    for robot in selection.robots:
        for mount in filter(selection.takes, _mounts([robot])):
            lines.setdefault((robot.name, mount.kind, _settings_text(mount)), []).append(mount.name)
    return "\n".join(
        f"{robot}: {kind} {' '.join(names)}: {text}" for (robot, kind, text), names in lines.items()
    )


def _with_settings(spec: RobotSpec, selection: Selection, parameters: Mapping[str, str]) -> RobotSpec:
    def changed(mount: Mount) -> Mount:
        return _with_options(mount, parameters) if selection.takes(mount) else mount

    return replace(spec, sensors=tuple(map(changed, spec.sensors)), cameras=tuple(map(changed, spec.cameras)))


def _with_options(mount: Mount, parameters: Mapping[str, str]) -> Mount:
    """Return a mount with other settings.

    Raises:
        UnknownNameError: It has no such setting; lists those it has.
        UsageError: See `robot.checked`.
    """
    kind = _settings_class(mount)
    names, can = field_names(kind), _editable(kind)
    spelt = {key.lower(): key for key in can.values()}
    changes: dict[str, object] = {}
    for key, text in parameters.items():
        if key.lower() not in spelt:
            raise UnknownNameError(
                f"{mount.kind} {mount.name} has no parameter {key!r}; those that can be changed: "
                f"{', '.join(can.values())}"
            )
        changes[spelt[key.lower()]] = _value(text)
    checked(kind, tuple(changes.items()), f"{mount.kind} {mount.name}")

    def field_of(key: str) -> str:
        return names.get(field_name(key), field_name(key))

    # By field, as a setting has several spellings: the earlier value must not stay under another.
    fields = set(map(field_of, changes))
    kept = [(key, value) for key, value in mount.options if field_of(key) not in fields]
    return replace(mount, options=(*kept, *changes.items()))


def _editable(kind: type[Any]) -> dict[str, str]:
    """Return the settings of one number, word or flag: fields and the manual's keys."""
    keys, simple = manual_keys(kind), (int, float, str)
    return {
        field.name: keys[field.name]
        for field in dataclasses.fields(kind)
        # A flag counts, too, as a bool is an int in Python.
        if isinstance(field.default, simple) and field.name not in FIXED
    }


def _value(text: str) -> object:
    """Return the value of a text of the console: true, false, a number or a word.

    Raises:
        UsageError: A number beyond `LARGEST`.
    """
    if text.lower() in FLAGS:
        return FLAGS[text.lower()]
    try:
        number = float(text)
    except ValueError:
        return text
    if abs(number) > LARGEST:
        raise UsageError(f"{text[:MAX_SHOWN]} is out of reach: settings go to {LARGEST:g} and -{LARGEST:g}")
    return int(number) if text.isdecimal() else number


def _settings_text(mount: Mount) -> str:
    kind = _settings_class(mount)
    if kind is CameraSettings:
        settings = _settings_of(mount)
    else:
        settings = resolve_settings(kind, mount.all_options, f"{mount.kind} {mount.name}")
    pairs = ((key, getattr(settings, field)) for field, key in _editable(kind).items())
    return " ".join(
        f"{key}={value:g}" if isinstance(value, float) else f"{key}={value}" for key, value in pairs
    )


def _redescribe(world: ServedWorld, specs: Mapping[Robot, RobotSpec]) -> None:
    """Replace the descriptions of robots; all of them, or none if one is refused."""
    done: list[tuple[Robot, RobotSpec]] = []
    try:
        for robot, spec in specs.items():
            before = robot.spec
            if spec != before:
                world.update_robot_spec(robot, spec)
                done.append((robot, before))
    except Exception:  # an engine may refuse the third robot after two have changed: undo those
        for robot, before in done:
            world.update_robot_spec(robot, before)
        raise
    for robot, before in done:
        _settle_cameras(world, robot, before)


def _settle_cameras(world: ServedWorld, robot: Robot, before: RobotSpec) -> None:
    """Apply changed limits to the fields of view; a new default is in force at once."""
    if robot.spec.cameras == before.cameras:
        return
    for index, camera in enumerate(robot.cameras):
        old = _settings_of(before.cameras[index]).camera_def_fov
        world.zoom(robot, index, camera.default_fov if old != camera.default_fov else robot.fovs[index])


def _settings_of(mount: Mount) -> CameraSettings:
    return resolve_camera(mount, mount.name)


if TYPE_CHECKING:
    from usarmjx.view.controls import WorldControls
    from usarmjx.view.page import ViewerPage

MAX_LINE = 500
"""Longest line that is accepted [characters]."""
SHOWN_LINES = 20
"""Lines of the log that `showlog` shows by default."""
NOT_ALLOWED = "this is for clients on the server's own machine, or with its token"
"""Refusal of a command of a peer without permission."""


@dataclass(frozen=True)
class SpectatorCamera:
    """Viewpoint of a spectator.

    Attributes:
        pos: Position [m] (3,).
        mat: Orientation (3, 3).
        rate: Recent frame rate [Hz].
        about: Description of the view.
    """

    pos: np.ndarray
    mat: np.ndarray
    rate: float
    about: str = ""


class SpectatorConsole:
    """Console of one spectator.

    Args:
        world: The served world.
        controls: Controls that pause it; None without any.
        number: Number of the world among those of `controls`.
        camera: Returns the spectator's present viewpoint; None without one.
        tail: Last lines of the log; None when it is not kept.
        trusted: Whether more than looking is allowed.
        refusal: Answer to a command that is not allowed.
    """

    def __init__(
        self,
        world: ServedWorld,
        controls: "WorldControls | None" = None,
        *,
        number: int = 0,
        camera: Callable[[], SpectatorCamera | None] | None = None,
        tail: LogTail | None = None,
        trusted: bool = True,
        refusal: str = NOT_ALLOWED,
    ) -> None:
        self._world, self._controls, self._number = world, controls, number
        self._camera, self._tail, self._trusted, self._refusal = camera, tail, trusted, refusal
        self._commands: dict[str, tuple[Callable[[list[str]], str], str]] = {
            "showlog": (self._show_log, "showlog [LINES]: the last lines of the server's log"),
            "showdebug": (self._show_debug, "showdebug: place of the camera, and rate of pictures"),
            "editactor": (self._edit_actor, f"{USAGE}: parameters of robots and sensors; none: show them"),
            "pause": (self._pause, "pause: let the world stand still, or go on"),
            "help": (self._help, "help: this"),
        }

    @property
    def commands(self) -> list[str]:
        """Names of the commands, for completion."""
        return list(self._commands)

    def run(self, line: str) -> str:
        """Carry out a line; return the text to show, which is the reason of a refusal."""
        try:
            return self._run(line)
        except UsarmjxError as error:
            return str(error)

    def _run(self, line: str) -> str:
        if len(line) > MAX_LINE:
            raise UsageError(f"a line has at most {MAX_LINE} characters")
        try:
            head, *words = shlex.split(line) or [""]
        except ValueError as error:
            raise UsageError(f"{clip(line)}: {error}") from error
        if not head:
            return ""
        if head.lower() not in self._commands:
            raise UsageError(f"no command {clip(head)}; known: {', '.join(self._commands)}")
        command, _ = self._commands[head.lower()]
        # All others change worlds, or show the server's log.
        if not self._trusted and command not in (self._show_debug, self._help):
            raise UsageError(f"{head.lower()}: {self._refusal}")
        return command(words)

    def _help(self, words: list[str]) -> str:
        del words
        return "\n".join(about for _, about in self._commands.values())

    def _show_log(self, words: list[str]) -> str:
        count = words[0] if words else str(SHOWN_LINES)
        if len(words) > 1 or not (
            # By its length first: Python refuses to read thousands of digits, with an error of another kind.
            count.isdecimal() and len(count) <= len(str(MAX_KEPT_LINES)) and int(count)
        ):
            raise UsageError(f"showlog: {clip(' '.join(words))} is no number of lines")
        if self._tail is None:
            raise UsageError("showlog: this server does not keep its log")
        # A list: a deque has no slices, and other threads may log meanwhile.
        return "\n".join(list(self._tail.lines)[-int(count) :]) or "nothing has been logged yet"

    def _show_debug(self, words: list[str]) -> str:
        if words:
            raise UsageError("showdebug takes nothing")
        camera = None if self._camera is None else self._camera()
        lines: list[str] = []
        if camera is not None:
            location = two_decimals_list(flip_wire_vector(camera.pos.tolist()))
            turn = two_decimals_list(flip_wire_angles(angles_from_mat(camera.mat).tolist()))
            shown = f"{camera.about}, " if camera.about else ""
            lines = [f"camera: {{Location {location}}} {{Rotation {turn}}}"]
            lines += [f"{shown}{camera.rate:.1f} pictures a second"]
        world = self._world
        robots = ", ".join(f"{robot.name} ({robot.spec.name})" for _, robot in sorted(world.robots.items()))
        goes = ""
        if self._controls is not None:
            status = self._controls.status(self._number)
            goes = ", paused" if status.paused else f", real-time factor {status.realtime_factor:.2f}"
        return "\n".join(
            [*lines, f"{world.arena.name} at {world.time:.2f} s{goes}", f"robots: {robots or 'none'}"]
        )

    def _edit_actor(self, words: list[str]) -> str:
        return edit_actor(self._world, words)

    def _pause(self, words: list[str]) -> str:
        if words:
            raise UsageError("pause takes nothing")
        if self._controls is None:
            raise UsageError("pause: nothing here can make this world stand still")
        on = not self._controls.status(self._number).paused
        self._controls.pause(on)
        return "it stands still" if on else "it goes on"


class ConsolePanel:
    """A `view.page.Panel`: a console for each user of the page.

    The user with the controls may use all of it, the others may look: see `SpectatorConsole`.

    Args:
        page: The page.
        worlds: The worlds of the page, by number.
        lock: Lock of the controls.
        tail: Last lines of the log; None when it is not kept.
    """

    def __init__(
        self,
        page: "ViewerPage",
        worlds: Sequence[ServedWorld],
        lock: ControlLock,
        tail: LogTail | None = None,
    ) -> None:
        self._page, self._worlds, self._lock, self._tail = page, worlds, lock, tail
        self._people: dict[int, UserConsole] = {}
        self._updates: deque[float] = deque(maxlen=MANY_UPDATES)

    def begin(self, drawing: Drawing) -> None:
        """Do nothing: the console does not depend on the drawing."""

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Give new users a console."""
        self._updates.append(time.monotonic())
        viewers = self._page.viewers
        for number in self._people.keys() - viewers.keys():
            del self._people[number]
        for number, viewer in viewers.items():
            if number not in self._people:
                self._people[number] = UserConsole(
                    viewer.client, partial(self.run, viewer.client), self._page
                )

    def run(self, client: viser.ClientHandle, line: str) -> str:
        """Carry out a user's line, in the thread that runs the worlds; return the text to show."""
        page = self._page
        # Made for each line: the page may show another world by now, and the controls may have another
        # holder.
        console = SpectatorConsole(
            self._worlds[page.world],
            page.controls,
            number=page.world,
            camera=partial(self._camera, client),
            tail=self._tail,
            trusted=self._lock.allowed and self._lock.holder == client.client_id,
            refusal=self._refusal(),
        )
        return console.run(line)

    def _refusal(self) -> str:
        if not self._lock.allowed:
            return NOT_ALLOWED
        return SOMEBODY_ELSE if self._lock.holder is not None else TAKE_THEM

    def _camera(self, client: viser.ClientHandle) -> SpectatorCamera | None:
        """Return a user's viewpoint; None where worlds stand side by side."""
        if self._page.wall:
            return None
        spent = self._updates[-1] - self._updates[0] if self._updates else 0.0
        rate = (len(self._updates) - 1) / spent if spent else 0.0
        w, x, y, z = client.camera.wxyz
        # A camera of viser's looks along its z axis, and its y axis points down.
        right, down, ahead = Rotation.from_quat([x, y, z, w]).as_matrix().T
        return SpectatorCamera(np.array(client.camera.position), np.stack([ahead, -right, -down], 1), rate)


class UserConsole:
    """Console of one user."""

    def __init__(self, client: viser.ClientHandle, run: partial[str], page: "ViewerPage") -> None:
        self._run, self._page, self._text = run, page, ""
        gui = client.gui
        with gui.add_folder("Console", expand_by_default=False, order=1000):
            self._line = gui.add_text("Line", "help", hint="help, showlog, showdebug, editactor, pause")
            # viser calls back in threads of its own: the line must wait for the thread of the worlds.
            gui.add_button("Run").on_click(lambda _: page.post(self.enter))
            self._shown = gui.add_html("")

    def enter(self) -> None:
        """Carry out the line."""
        line = self._line.value.strip()
        # The end of the text stays: the last answer is the one that is read.
        self._text = f"{self._text}> {line}\n{self._run(line)}\n"[-MAX_ANSWERS:]
        # The log has texts of clients, which must not become part of the page.
        self._shown.content = f'<pre style="{STYLE}">{html.escape(self._text)}</pre>'
