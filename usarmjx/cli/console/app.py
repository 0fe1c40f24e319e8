"""The console with panes: messages, sensors, ranges, a picture, and the line that is typed."""

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from math import isfinite
from pathlib import Path
from typing import ClassVar

from rich.color import Color
from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual import events
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.message import Message as Event
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Button, Footer, Input, RichLog, Static, TabbedContent, TabPane, Tree
from textual.widgets.tree import TreeNode

from usarmjx.base.errors import PeerError, UsageError, UsarmjxError
from usarmjx.cli.console.client import ConsoleClient, Received, fault_of
from usarmjx.cli.console.driving import JoystickDevice, JoystickDriver, KeyDriver
from usarmjx.cli.console.knowledge import Completer, common_beginning
from usarmjx.cli.console.pictures import HALF_BLOCK, HalfBlocks, PictureFiles, PictureStream, half_blocks
from usarmjx.server.protocol.grammar import Message, to_vector

COLUMNS_PER_STEP, ROWS_PER_STEP = 4, 2
"""So far the mouse goes for a step of the camera [characters]."""
DRIVING_KEYS = {
    **{"up": "forward", "down": "backward", "left": "left", "right": "right"},
    **{"w": "forward", "s": "backward", "a": "left", "d": "right", "space": "stop", "x": "straight"},
    **{"plus": "faster", "equals_sign": "faster", "minus": "slower"},
    **{"pageup": "up", "pagedown": "down", "home": "level"},
    **{"i": "tilt_up", "k": "tilt_down", "j": "pan_left", "l": "pan_right", "o": "zoom_in", "u": "zoom_out"},
    **{"h": "light", "t": "trace", "f": "flip"},
}
"""Actions of keys while the pad is in use."""


class CommandLine(Input):
    """The command that is being typed: Tab completes it, the arrows bring back what was sent.

    Args:
        complete: Returns what a line may become.
        offer: Shows what it may become, if that is more than one line.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        # Before the screen, which moves the focus by Tab.
        Binding("tab", "complete", "complete", priority=True),
        Binding("up", "recall(-1)", show=False),
        Binding("down", "recall(1)", show=False),
    ]

    def __init__(self, complete: Callable[[str], list[str]], offer: Callable[[Sequence[str]], None]) -> None:
        super().__init__(id="command", placeholder="a command; Tab completes, F2 drives")
        self._complete, self._offer = complete, offer
        self._sent: list[str] = []
        self._recalled = 0
        self._offered: list[str] = []
        self._begun = ""  # what the lines that are shown have in common

    def action_complete(self) -> None:
        """Write what all completions have in common; then one after the other."""
        if self.value in self._offered:
            self._put(self._offered[(self._offered.index(self.value) + 1) % len(self._offered)])
            return
        found = self._complete(self.value)
        common = common_beginning(found)
        # Only where Tab cannot add a letter do the lines themselves come in turn.
        self._offered = [] if len(found) < 2 or len(common) > len(self.value) else found
        self._begun = common if len(found) > 1 else ""
        self._offer(found if len(found) > 1 else ())
        if self._offered:
            self._put(self._offered[0])
        elif found:
            self._put(common)

    def on_input_changed(self) -> None:
        """Clear the completions that were offered for another line."""
        # The event also follows what `_put` has written: completions must survive that.
        if self.value not in (*self._offered, self._begun):
            self._offered, self._begun = [], ""
            self._offer(())

    def remember(self, line: str) -> None:
        """Take a line that was sent, and begin anew."""
        self._sent.append(line)
        self._recalled, self.value = len(self._sent), ""

    def action_recall(self, step: int) -> None:
        """Bring back a line that was sent."""
        # One place behind the last line stands for the line that is being typed.
        self._recalled = min(max(self._recalled + step, 0), len(self._sent))
        self._put(self._sent[self._recalled] if self._recalled < len(self._sent) else "")

    def _put(self, line: str) -> None:
        self.value = line
        self.cursor_position = len(line)


class KeyPad(Static, can_focus=True):
    """Drives while it is in use: by keys, and the mouse turns the camera (manual 5.2.1)."""

    class Pressed(Event):
        """Something shall be done.

        Attributes:
            action: One of `driving.ACTIONS`.
        """

        def __init__(self, action: str) -> None:
            super().__init__()
            self.action = action

    class Left(Event):
        """The pad is in use no more."""

    def __init__(self) -> None:
        super().__init__("", id="pad")
        self._mouse: tuple[int, int] | None = None

    def on_key(self, event: events.Key) -> None:
        """Drive, or go back to the command line."""
        if event.key == "escape":
            self.post_message(self.Left())
        elif event.key in DRIVING_KEYS:
            self.post_message(self.Pressed(DRIVING_KEYS[event.key]))
        else:
            return
        # Keys that drive must not reach the app's own bindings.
        event.stop()

    def on_mouse_down(self, event: events.MouseDown) -> None:
        """The right button ends driving."""
        # Terminals number the buttons 1 left, 2 middle, 3 right.
        if event.button == 3:
            self.post_message(self.Left())

    def on_mouse_move(self, event: events.MouseMove) -> None:
        """Turn the camera by a step when the mouse has moved by `COLUMNS_PER_STEP` or `ROWS_PER_STEP`."""
        # Movements reach whatever lies under the pointer, also while somebody types a command.
        if not self.has_focus:
            return
        # The first place is only where the count begins.
        if self._mouse is None:
            self._mouse = event.x, event.y
        right, down = event.x - self._mouse[0], event.y - self._mouse[1]
        if abs(right) >= COLUMNS_PER_STEP:
            self.post_message(self.Pressed("pan_right" if right > 0 else "pan_left"))
            # By axis, so that a slant movement loses no step of the other.
            self._mouse = event.x, self._mouse[1]
        if abs(down) >= ROWS_PER_STEP:
            self.post_message(self.Pressed("tilt_down" if down > 0 else "tilt_up"))
            self._mouse = self._mouse[0], event.y

    def on_leave(self) -> None:
        """The mouse has gone elsewhere."""
        # Else the camera would turn when the mouse comes back at another edge.
        self._mouse = None


NEAR, MIDDLE = 0.2, 0.5
"""Up to these shares of the longest distance a reading is near, or in the middle."""
COLORS = ("red", "yellow", "green")
"""Of what is near, in the middle, and far (manual 5.2.5.1: a color code)."""
LEVELS = "▁▂▃▄▅▆▇█"
MAX_VALUE = 60
"""A longer value is shown by its beginning [characters]."""

Branch = dict[str, dict[str, str]]
"""Fields by name of a sensor, or other part; those of none are under ""."""
Bar = tuple[str, str, str]
"""A name, what is drawn, and its colour."""


def title(message: Message) -> str:
    """Return the title of a message's values: the type of sensor, or the mission package."""
    if message.kind == "SEN":
        return message.get("Type")
    return f"{message.kind} {message.get('Name')}".strip() if message.kind == "MISSTA" else message.kind


def branch(message: Message) -> Branch:
    """Return a message's values by the names in it."""
    found: Branch = {}
    name = ""
    for key, value in message.segments:
        words = value.split()
        if key.lower() == "name" and words:
            name = words[0]
            # A last field without its value is dropped, as peers may send what they like.
            pairs = zip(words[1::2], words[2::2], strict=False)  # `{Name F1 Range 2.5}`
            found.setdefault(name, {}).update((field, brief(text)) for field, text in pairs)
        elif key.lower() not in ("type", "name") or message.kind != "SEN":
            # The time is that of the message, not of the item that was named before it.
            fields = found.setdefault(name if key.lower() != "time" else "", {})
            fields[_free(fields, key)] = brief(value)
    return found


def _free(fields: dict[str, str], key: str) -> str:
    """Return a unique key for a segment that may come several times, by numbering it."""
    # Keys that have a number already count, too.
    count = sum(known.split(" ")[0] == key for known in fields)
    return f"{key} {count + 1}" if count else key


def brief(value: str) -> str:
    """Return a value that fits into a line; of many numbers how many there are, and their extremes."""
    if len(value) <= MAX_VALUE:
        return value
    # A text with commas is no vector, as which the grammar reads it: its words would be zeros.
    with suppress(ValueError):
        numbers = [float(part) for part in value.split(",")]
        if len(numbers) > 4 and all(map(isfinite, numbers)):
            return f"{len(numbers)} numbers, {min(numbers):g} to {max(numbers):g}"
    return value[:MAX_VALUE] + "..."


def range_bars(message: Message, longest: float, width: int) -> list[Bar]:
    """Return the distances of a message as bars, none if it has none.

    Args:
        message: A message of sonars, infrareds or scanners.
        longest: The longest distance so far [m].
        width: Longest bar, without its number [characters].
    """
    whole = message.get("Range")
    if whole:  # a scan: from right to left on the wire
        ranges = to_vector(whole)[::-1]
        # The nearest echo of each cell: a mean would hide an obstacle.
        cells = [min(part) for part in _split(ranges, width) if part]
        # The longest distance itself would be one level beyond the last.
        drawn = "".join(LEVELS[min(int(len(LEVELS) * cell / longest), len(LEVELS) - 1)] for cell in cells)
        return [(message.get("Name"), drawn, _color(min(ranges), longest))]
    bars: list[Bar] = []
    for words in (value.split() for value in message.all("Name")):
        if len(words) == 3 and words[1].lower() == "range":
            (distance,) = to_vector(words[2])
            length = round(width * min(distance / longest, 1.0))
            bars.append((words[0], f"{'█' * length} {distance:.2f}", _color(distance, longest)))
    return bars


def longest_range(message: Message) -> float:
    """Return the longest distance in a message [m]; 0: there is none."""
    lists = [
        message.get("Range"),
        *(words.split()[-1] for words in message.all("Name") if " Range " in words),
    ]
    return max((number for text in lists for number in to_vector(text)), default=0.0)


def _split(values: Sequence[float], parts: int) -> list[Sequence[float]]:
    count = len(values)
    return (
        [values[i * count // parts : (i + 1) * count // parts] for i in range(parts)]
        if count > parts
        else [(value,) for value in values]
    )


def _color(distance: float, longest: float) -> str:
    share = distance / longest
    return COLORS[0 if share <= NEAR else 1 if share <= MIDDLE else 2]


KINDS = ("NFO", "STA", "MISSTA", "SEN", "GEO", "CONF", "RES")
ALL, OTHERS, SENT = "All", "Others", "Sent"
MAX_LINES = 500
"""Number of lines that a pane keeps."""
SHORT = 300
"""Length of a line among all the others [characters]."""
DIRECTIONS = {"<": "", ">": "bold cyan", "#": "yellow"}
"""Styles of lines: messages, commands, remarks."""


class MessagePanes(Vertical):
    """All messages, and those of each type in a pane of its own.

    Only the pane that is looked at is written to; the others wait.
    """

    def __init__(self) -> None:
        super().__init__(id="messages")
        self._tabs = TabbedContent()
        self._logs: dict[str, RichLog] = {}
        # Bounded: a pane that nobody looks at would grow for as long as the server talks.
        self._pending = {name: deque[Text](maxlen=MAX_LINES) for name in (ALL, *KINDS, OTHERS, SENT)}

    def compose(self) -> ComposeResult:
        """Make the panes."""
        with self._tabs:
            for name in self._pending:
                with TabPane(name, id=f"pane-{name}"):
                    # The library wraps at 78 columns at least, which a narrow terminal would cut off.
                    self._logs[name] = RichLog(max_lines=MAX_LINES, wrap=True, min_width=20)
                    yield self._logs[name]

    def on_mount(self) -> None:
        """Write now and then, not with each message."""
        self.set_interval(0.2, self.flush)

    def add(self, direction: str, kind: str, line: str) -> None:
        """Take a line."""
        own = SENT if direction == ">" else kind if kind in KINDS else OTHERS
        when, style = f"{datetime.now():%H:%M:%S} {direction}", DIRECTIONS[direction]
        short = (
            line if len(line) <= SHORT else f"{line[:SHORT]} ... ({len(line)} characters, whole under {own})"
        )
        self._pending[ALL].append(Text(f"{when} {short}", style))
        # Remarks are no messages: only the pane of all lines has them.
        if direction != "#":
            self._pending[own].append(Text(f"{when} {line}", style))

    def flush(self) -> None:
        """Write what waits for the pane that is looked at."""
        name = self._tabs.active.removeprefix("pane-")
        # Before the first layout no pane is active.
        pending = self._pending.get(name)
        while pending:
            self._logs[name].write(pending.popleft())


class SensorTree(Tree[None]):
    """The last values of every sensor, and of the robot; branches can be closed (manual 5.2.5.1)."""

    def __init__(self) -> None:
        super().__init__("robot", id="sensors")
        self.show_root = False
        self._latest: dict[str, Message] = {}
        self._branches: dict[tuple[str, ...], TreeNode[None]] = {}

    def on_mount(self) -> None:
        """Show new values now and then."""
        self.set_interval(0.5, self.show_latest)

    def hear(self, message: Message) -> None:
        """Take a message."""
        if message.kind in ("SEN", "STA", "MISSTA", "RES"):
            self._latest[title(message)] = message

    def show_latest(self) -> None:
        """Show what has come since the last time."""
        # Only what has come since: a label that is set is drawn anew, even by the same text.
        latest, self._latest = self._latest, {}
        for name, message in latest.items():
            for item, fields in branch(message).items():
                for key, value in fields.items():
                    # One value makes one line, not a branch that must be opened to see it.
                    if item and len(fields) > 1:
                        self._node(name, item, key).set_label(Text(f"{key} {value}"))
                    else:
                        self._node(name, f"{item} {key}").set_label(Text(f"{item} {key} {value}".strip()))

    def _node(self, *path: str) -> TreeNode[None]:
        """Return a value's node, in the branches above it."""
        node = self._branches.get(path)
        if node is None:
            parent = self.root
            for count in range(1, len(path)):
                if path[:count] not in self._branches:
                    self._branches[path[:count]] = parent.add(Text(path[count - 1]), expand=count == 1)
                parent = self._branches[path[:count]]
            node = self._branches[path] = parent.add_leaf(Text(path[-1]))
        return node


COLUMNS, NAME_WIDTH, NUMBER_WIDTH = 2, 6, 6
"""Number of columns of bars, and widths of their names and numbers [characters]."""


class RangeBars(Static):
    """Distances as bars, by how near things are (manual 5.2.5.1)."""

    def __init__(self) -> None:
        super().__init__(id="ranges")
        self._height = 0
        self._latest: dict[str, Message] = {}
        self._longest: dict[str, float] = {}

    def on_mount(self) -> None:
        """Show new values now and then."""
        self.set_interval(0.5, self.show_latest)

    def hear(self, message: Message) -> None:
        """Take a message."""
        if message.kind != "SEN":
            return
        # Numbers that cannot be read make no bars; the panes show the line all the same.
        try:
            longest = longest_range(message)
        except PeerError:
            return
        if longest > 0:
            kind = title(message)
            # The scale only grows, so that bars of one sensor compare over time.
            self._longest[kind] = max(longest, self._longest.get(kind, 0.0))
            # A scan has a row of its own, so two scanners of a type must not replace each other.
            self._latest[kind if message.get("Range") == "" else f"{kind} {message.get('Name')}"] = message

    def show_latest(self) -> None:
        """Draw the bars; all is laid out anew only where there are more of them."""
        # Before the first layout the width is 0.
        text, column = Text(), max(20, self.size.width // COLUMNS)
        for message in self._latest.values():
            is_scan = bool(message.get("Range"))
            width = (self.size.width if is_scan else column) - NAME_WIDTH - NUMBER_WIDTH
            bars = range_bars(message, self._longest[title(message)], max(4, width))
            for number, (name, drawn, color) in enumerate(bars):
                text.append(f"{name[: NAME_WIDTH - 1]:{NAME_WIDTH}}").append(drawn, color)
                ends = is_scan or number % COLUMNS == COLUMNS - 1 or number == len(bars) - 1
                text.append("\n" if ends else " " * max(1, column - NAME_WIDTH - len(drawn)))
        rows = text.plain.count("\n")
        if rows or self._height:
            # A new layout of the screen takes much longer than new text.
            self.update(text, layout=rows != self._height)
        self._height = rows


class PictureView(Widget):
    """A picture of the image server, as half blocks."""

    def __init__(self) -> None:
        super().__init__(id="picture")
        self._rows: HalfBlocks = []

    def show(self, rows: HalfBlocks) -> None:
        """Show another picture."""
        self._rows = rows
        self.refresh()

    def render_line(self, y: int) -> Strip:
        """Return a row of characters."""
        # A picture keeps its proportions, so rows of the pane may be left over.
        row = self._rows[y] if y < len(self._rows) else []
        return Strip(
            [
                Segment(HALF_BLOCK, Style.from_color(Color.from_rgb(*upper), Color.from_rgb(*lower)))
                for upper, lower in row
            ]
        )


BUTTONS = (
    (("left", "◀"), ("forward", "▲"), ("backward", "▼"), ("right", "▶"), ("stop", "Stop")),
    (("slower", "Slower"), ("faster", "Faster"), ("straight", "Straight"), ("up", "Up"), ("down", "Down")),
    (
        ("pan_left", "Cam◀"),
        ("tilt_up", "Cam▲"),
        ("tilt_down", "Cam▼"),
        ("pan_right", "Cam▶"),
        ("flip", "Flip"),
    ),
    (("zoom_in", "Zoom+"), ("zoom_out", "Zoom-"), ("light", "Light"), ("trace", "Trace"), ("view", "View")),
)
"""Labels of the buttons, row by row: SimpleUI's wheels, camera and light (manual 5.2.5.1)."""
VIEW = "view"
"""The button, and the key, that show the next camera in the picture."""
GONE = "the server has hung up; F3 connects anew"
PAD_TEXT = "F2: drive by arrows, Space, + -, I J K L, U O, H, T; Esc or the right button ends"


@dataclass
class ConsoleOptions:
    """Options of a console beside its connection.

    Attributes:
        load_classes: Returns the robot classes, in a thread as it may take a while; None: they are not known.
        pictures: The image server's pictures; None: none are shown.
        files: Folder for pictures; None: none are saved.
        joystick: A joystick's device; None: there is none.
        ask: Whether to ask GETGEO and GETCONF by itself, for completion.
    """

    load_classes: Callable[[], Sequence[str]] | None = None
    pictures: PictureStream | None = None
    files: PictureFiles | None = None
    joystick: Path | None = None
    ask: bool = True


class Key(Button, can_focus=False):
    """A button that leaves the keyboard to whom it was with."""


class ConsoleApp(App[str]):
    """The console; `run` returns why it could not begin, else nothing.

    Args:
        client: A client that is not connected yet.
        extras: Further commands.
    """

    TITLE = "usarmjx console"
    CSS = """
    #left { width: 3fr; }
    #right { width: 2fr; min-width: 40; }
    #messages { height: 1fr; }
    #offered { height: auto; max-height: 4; color: $text-muted; }
    #status { height: 1; background: $panel; }
    #sensors { height: 2fr; }
    #ranges { height: auto; max-height: 14; }
    #picture { height: 3fr; }
    #pad { height: 2; background: $panel; }
    #pad:focus { background: $success; }
    .buttons { height: 1; }
    .buttons Button { width: 1fr; min-width: 6; height: 1; border: none; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f2", "drive", "drive", priority=True),
        Binding("f3", "reconnect", "connect anew", priority=True),
        Binding("ctrl+q", "quit", "quit", priority=True),
    ]
    ENABLE_COMMAND_PALETTE = False

    def __init__(self, client: ConsoleClient, extras: ConsoleOptions | None = None) -> None:
        super().__init__()
        self._client, self._extras = client, extras or ConsoleOptions()
        self._robot_classes: Sequence[str] = ()
        self._pilot, self._stick = KeyDriver(client.knowledge), None
        self._device: JoystickDevice | None = None
        self._viewed = -1
        self._messages, self._sensors, self._ranges = MessagePanes(), SensorTree(), RangeBars()
        self._offers, self._state_line = Static(id="offered"), Static(id="status")
        self._command, self._pad = CommandLine(self._complete, self._offer), KeyPad()
        self._picture = PictureView()

    def compose(self) -> ComposeResult:
        """Make the panes."""
        with Horizontal():
            with Vertical(id="left"):
                yield from (self._messages, self._offers, self._command, self._state_line)
            with Vertical(id="right"):
                if self._extras.pictures is not None:
                    yield self._picture
                yield from (self._ranges, self._sensors, self._pad)
                for row in BUTTONS:
                    with Horizontal(classes="buttons"):
                        for name, text in row:
                            yield Key(text, id=f"do-{name}")
        yield Footer()

    async def on_mount(self) -> None:
        """Connect, and begin what goes on beside."""
        self._command.focus()
        self._pad.update(PAD_TEXT)
        try:
            await self._begin()
            if self._extras.joystick is not None:
                self._device = JoystickDevice(self._extras.joystick, self._feed_stick)
        except UsageError as error:
            # The panes would cover a line on the terminal: the command prints it once they are gone.
            self.exit(str(error))
            return
        if self._extras.load_classes is not None:
            self.run_worker(self._learn_classes(self._extras.load_classes))
        if self._extras.pictures is not None:
            self.run_worker(self._watch(self._extras.pictures))
        self.set_interval(0.5, self._show_status)

    def on_unmount(self) -> None:
        """Hang up."""
        if self._device is not None:
            self._device.close()
        self._client.close()

    # The connection

    async def _begin(self) -> None:
        await self._client.connect()
        # All that the client knows of the robot belongs to the old connection.
        self._pilot, self._viewed = KeyDriver(self._client.knowledge), -1
        self._stick = JoystickDriver(self._pilot)
        self.say(f"connected to {self._client.host}:{self._client.port}")
        # Exclusive: the listener of the connection before ends.
        self.run_worker(self._listen(), group="connection", exclusive=True)

    async def _listen(self) -> None:
        try:
            async for received in self._client.messages():
                await self._hear(received)
        except UsarmjxError as error:
            # A transcript that cannot be written any more ends the reading, not the console.
            self.say(str(error))
        self.say(GONE)

    async def _hear(self, received: Received) -> None:
        self._messages.add("<", received.kind, received.line)
        if received.message is not None:
            self._sensors.hear(received.message)
            self._ranges.hear(received.message)
        if self._extras.ask:
            for line in self._client.knowledge.questions():
                await self.send(line)
        # Only the first camera is shown without a request: which one follows is the user's choice.
        if self._viewed < 0 and self._client.knowledge.fovs:
            await self._show_next_camera()

    async def send(self, line: str) -> None:
        """Send a line and show it; why it could not be is shown too."""
        try:
            shown = await self._client.send(line)
        except UsarmjxError as error:
            self.say(str(error))
        else:
            self._messages.add(">", "", shown)
            if fault := fault_of(line):
                self.say(f"no server can read that: {fault}")

    def say(self, text: str) -> None:
        """Show a remark."""
        self._messages.add("#", "", text)

    async def action_reconnect(self) -> None:
        """Connect anew: the robot leaves, and another one may come."""
        try:
            await self._begin()
        except UsageError as error:
            self.say(str(error))

    # The command line

    def _complete(self, text: str) -> list[str]:
        pictures = self._extras.pictures
        address = pictures.address if pictures is not None else ""
        # Made anew each time: classes and the address become known later, in other tasks.
        return Completer(self._client.knowledge, self._robot_classes, address).complete(text)

    def _offer(self, lines: Sequence[str]) -> None:
        words = (line.rstrip(" }").rpartition("{")[2].rpartition(" ")[2] or line for line in lines)
        self._offers.update(Text("  ".join(words)))

    async def _learn_classes(self, load: Callable[[], Sequence[str]]) -> None:
        # In a thread: the import takes a second, in which the panes would stand still.
        self._robot_classes = await asyncio.to_thread(load)

    async def on_input_submitted(self, event: Input.Submitted) -> None:
        """Send what was typed."""
        line = event.value.strip()
        if line and isinstance(event.input, CommandLine):
            event.input.remember(line)
            await self.send(line)

    # Driving

    def action_drive(self) -> None:
        """Drive, or drive no more."""
        (self._command if self._pad.has_focus else self._pad).focus()

    def on_key_pad_left(self) -> None:
        """Back to the command line."""
        self._command.focus()

    async def on_key_pad_pressed(self, event: KeyPad.Pressed) -> None:
        """Carry out the action of a key."""
        await self._press(event.action)

    async def on_button_pressed(self, event: Button.Pressed) -> None:
        """Carry out the action of a button."""
        await self._press((event.button.id or "").removeprefix("do-"))

    async def _press(self, action: str) -> None:
        if action == VIEW:
            await self._show_next_camera()
            return
        if not self._client.is_connected:
            self.say(GONE)
            return
        lines = self._pilot.press(action)
        for line in lines:
            await self.send(line)
        if not lines and (problem := self._pilot.problem()):
            self.say(problem)

    def _feed_stick(self, data: bytes) -> None:
        if not data:
            self.say("the joystick has gone")
        elif self._stick is not None:
            for line in self._stick.feed(data):
                # The loop calls this as a plain function, which cannot wait for a send.
                self.run_worker(self.send(line))

    # Pictures

    async def _watch(self, pictures: PictureStream) -> None:
        view = self._picture
        try:
            async for picture in pictures.pictures():
                # Before the first layout the pane has no size.
                view.show(half_blocks(picture, max(1, view.size.width), max(1, view.size.height)))
                if self._extras.files is not None:
                    self._extras.files.save(picture)
            self.say("the image server has hung up")
        except UsarmjxError as error:
            self.say(str(error))

    async def _show_next_camera(self) -> None:
        """Let the picture be that of the robot's next camera (manual 9.4, SET of a viewpoint)."""
        known, pictures = self._client.knowledge, self._extras.pictures
        if pictures is None or not pictures.address or not known.fovs:
            return
        if not known.robot:
            self.say("whose picture? say {Name ...} in INIT")
            # Said once: below 0 each message would ask again.
            self._viewed = 0
            return
        names = list(known.fovs)
        self._viewed = (self._viewed + 1) % len(names)
        await self.send(
            f"SET {{Type Camera}} {{Robot {known.robot}}} {{Name {names[self._viewed]}}}"
            f" {{Client {pictures.address}}}"
        )

    def _show_status(self) -> None:
        known = self._client.knowledge
        parts = [
            f"{self._client.host}:{self._client.port}" + ("" if self._client.is_connected else " (gone)")
        ]
        parts += [known.level] if known.level else []
        if known.has_robot:
            parts += [known.class_name or known.robot, f"{known.time:.1f} s", f"battery {known.battery}"]
            parts += [f"light {'on' if known.light else 'off'}", f"speed {self._pilot.speed:g} %"]
        if self._device is not None:
            parts.append("joystick")
        # One line for ever: a new layout of the screen takes much longer than the text.
        self._state_line.update(Text(" | ".join(parts)), layout=False)
