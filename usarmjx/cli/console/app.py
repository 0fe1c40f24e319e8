"""The console with panes."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Button, Footer, Input, Static

from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.cli.console.client import ConsoleClient, Received, fault_of
from usarmjx.cli.console.completion import Completer
from usarmjx.cli.console.driving import JoystickDevice, JoystickDriver, KeyDriver
from usarmjx.cli.console.panes import CommandLine, KeyPad, MessagePanes, PictureView, RangeBars, SensorTree
from usarmjx.cli.console.pictures import PictureFiles, PictureStream, half_blocks

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
        self._pilot, self._viewed = KeyDriver(self._client.knowledge), -1
        self._stick = JoystickDriver(self._pilot)
        self.say(f"connected to {self._client.host}:{self._client.port}")
        self.run_worker(self._listen(), group="connection", exclusive=True)

    async def _listen(self) -> None:
        try:
            async for received in self._client.messages():
                await self._hear(received)
        except UsarmjxError as error:
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
        return Completer(self._client.knowledge, self._robot_classes, address).complete(text)

    def _offer(self, lines: Sequence[str]) -> None:
        words = (line.rstrip(" }").rpartition("{")[2].rpartition(" ")[2] or line for line in lines)
        self._offers.update(Text("  ".join(words)))

    async def _learn_classes(self, load: Callable[[], Sequence[str]]) -> None:
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
                self.run_worker(self.send(line))

    # Pictures

    async def _watch(self, pictures: PictureStream) -> None:
        view = self._picture
        try:
            async for picture in pictures.pictures():
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
        self._state_line.update(Text(" | ".join(parts)), layout=False)
