"""The panes of the console that show: messages, sensors, ranges, a picture."""

from collections import deque
from datetime import datetime

from rich.color import Color
from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import RichLog, Static, TabbedContent, TabPane, Tree
from textual.widgets.tree import TreeNode

from usarmjx.base.errors import PeerError
from usarmjx.console.pictures import HALF_BLOCK, HalfBlocks
from usarmjx.console.readings import branch, longest_range, range_bars, title
from usarmjx.server.protocol.grammar import Message

KINDS = ("NFO", "STA", "MISSTA", "SEN", "GEO", "CONF", "RES")
ALL, OTHERS, SENT = "All", "Others", "Sent"
MAX_LINES = 500
"""So many lines a pane keeps."""
SHORT = 300
"""So much of a line is shown among all the others [characters]."""
DIRECTIONS = {"<": "", ">": "bold cyan", "#": "yellow"}
"""How lines look: messages, commands, remarks."""


class MessagePanes(Vertical):
    """All messages, and those of each type in a pane of its own.

    Only the pane that is looked at is written to; the others wait.
    """

    def __init__(self) -> None:
        super().__init__(id="messages")
        self._tabs = TabbedContent()
        self._logs: dict[str, RichLog] = {}
        self._pending = {name: deque[Text](maxlen=MAX_LINES) for name in (ALL, *KINDS, OTHERS, SENT)}

    def compose(self) -> ComposeResult:
        """Make the panes."""
        with self._tabs:
            for name in self._pending:
                with TabPane(name, id=f"pane-{name}"):
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
        if direction != "#":
            self._pending[own].append(Text(f"{when} {line}", style))

    def flush(self) -> None:
        """Write what waits for the pane that is looked at."""
        name = self._tabs.active.removeprefix("pane-")
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
        latest, self._latest = self._latest, {}
        for name, message in latest.items():
            for item, fields in branch(message).items():
                for key, value in fields.items():
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
"""Bars stand in so many columns; of names and numbers beside them so much is shown [characters]."""


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
        try:
            longest = longest_range(message)
        except PeerError:
            return
        if longest > 0:
            kind = title(message)
            self._longest[kind] = max(longest, self._longest.get(kind, 0.0))
            self._latest[kind if message.get("Range") == "" else f"{kind} {message.get('Name')}"] = message

    def show_latest(self) -> None:
        """Draw the bars; all is laid out anew only where there are more of them."""
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
        row = self._rows[y] if y < len(self._rows) else []
        return Strip(
            [
                Segment(HALF_BLOCK, Style.from_color(Color.from_rgb(*upper), Color.from_rgb(*lower)))
                for upper, lower in row
            ]
        )
