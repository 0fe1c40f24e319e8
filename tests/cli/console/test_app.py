"""The panes, by textual's pilot and against a served world."""

import asyncio
import contextlib
import io
import os
from unittest.mock import patch

import numpy as np
import pytest
from PIL import Image
from textual._wait import wait_for_idle
from textual.app import App
from textual.widgets import Input, RichLog, Static, TabbedContent

from tests.server.peers import PATIENCE, serving
from tests.server.watchers import classes, gallery
from usarmjx.base.errors import UsageError
from usarmjx.cli.console.app import (
    BUTTONS,
    VIEW,
    CommandLine,
    ConsoleApp,
    ConsoleOptions,
    KeyPad,
    PictureView,
    SensorTree,
    branch,
    longest_range,
    range_bars,
)
from usarmjx.cli.console.client import ConsoleClient, Transcript
from usarmjx.cli.console.driving import ACTIONS, AXIS, EVENT, FULL
from usarmjx.cli.console.pictures import PictureFiles, PictureStream, decode, half_blocks
from usarmjx.models.robots import ROBOTS
from usarmjx.server.pictures.image_server import ImageServer, ImageSettings
from usarmjx.server.protocol.grammar import parse_message
from usarmjx.server.protocol.images import encode_frame

IDLE_WAIT = 0.2
"""Longest time that a pilot waits for an idle process after each key [s].

Textual's is 1 s, all of which passes where the server is in the same process and never idle; `until` waits
for what a key brings about.
"""
INIT = "INIT {ClassName USARBot.Lookout} {Name Eye} {Start S0}"


@contextlib.contextmanager
def served():
    """The gallery with its pictures: its world, and the ports of robots and pictures."""
    with classes():
        world = gallery()
        images = ImageServer(
            world, ImageSettings(port=0, size=(64, 48), format=0, fps=50.0, patience=PATIENCE)
        )
        with serving(world, [images], realtime_factor=1.0) as (port, _):
            yield world, port, images.port


def with_app(app, script):
    """Run a console and let a pilot do something with it."""

    async def main():
        async with app.run_test(size=(110, 34)) as pilot:
            await script(pilot)

    def wait(least=0.0):
        return wait_for_idle(least, IDLE_WAIT)

    with patch("textual.pilot.wait_for_idle", wait), patch("textual.app.wait_for_idle", wait):
        asyncio.run(asyncio.wait_for(main(), 4 * PATIENCE))


async def until(pilot, true, what="what was waited for"):
    """Wait for something."""
    for _ in range(round(PATIENCE / 0.05)):
        if true():
            return
        await asyncio.sleep(0.05)
    raise AssertionError(f"{what} has not come")


def written(app, name):
    """The text of a pane of messages."""
    return "\n".join(strip.text.rstrip() for strip in app.query_one(f"#pane-{name}").query_one(RichLog).lines)


async def say(app, pilot, line):
    app.query_one(CommandLine).value = line
    await pilot.press("enter")


async def brings_a_robot(app, pilot, client):
    """Commands are typed, completed, sent, and brought back."""
    line = app.query_one(CommandLine)
    await until(pilot, lambda: client.knowledge.starts, "start poses")
    await until(pilot, lambda: app._robot_classes, "the classes")
    await pilot.press(*"ini", "tab", *"{cl", "tab", *"p2", "tab")
    assert line.value == "INIT {ClassName USARBot.P2"
    await pilot.pause()
    assert "USARBot.P2AT  USARBot.P2DX" in str(app.query_one("#offered", Static).content), "what it may be"
    await pilot.press("tab")
    assert line.value == "INIT {ClassName USARBot.P2AT}"
    assert "USARBot.P2DX" in str(app.query_one("#offered", Static).content)
    await pilot.press("tab")
    assert line.value == "INIT {ClassName USARBot.P2DX}", "the next one"
    await say(app, pilot, INIT)
    assert line.value == ""
    await until(pilot, lambda: client.knowledge.fovs and client.knowledge.steering, "the robot's answers")
    await pilot.press("up")
    assert line.value == INIT, "what was sent comes back"
    await pilot.press("down")
    line.value = "SET {Type Camera} {N"
    line.cursor_position = len(line.value)
    await pilot.press("tab", "b", "tab")
    assert line.value == "SET {Type Camera} {Name Behind}"
    line.value = ""


async def drives(app, pilot, robot):
    """By F2 and arrows, by buttons, and back to the command line."""
    await pilot.press("f2")
    assert app.focused is app.query_one(KeyPad)
    await pilot.press("plus", "up")
    await until(pilot, lambda: np.any(robot().command.setpoint > 1.0), "driving")
    await pilot.press("space")
    await until(pilot, lambda: not np.any(robot().command.setpoint), "standing")
    await pilot.press("escape")
    assert app.focused is app.query_one(CommandLine)
    await pilot.click("#do-light")
    await until(pilot, lambda: bool(robot().command.light), "light")
    assert app.focused is app.query_one(CommandLine), "buttons leave the keyboard where it is"


async def looks_at_panes(app, pilot):
    """The tree, the status, and a pane for each type of message."""
    tree = app.query_one(SensorTree)

    def shown():
        return {str(node.label): node for node in tree.root.children}

    await until(pilot, lambda: {"STA", "GroundTruth"} <= set(shown()), "the tree")
    leaves = [str(leaf.label) for node in shown()["GroundTruth"].children for leaf in node.children]
    assert any(leaf.startswith("Location ") for leaf in leaves)
    tabs = app.query_one(TabbedContent)
    tabs.active = "pane-CONF"
    await until(pilot, lambda: "CONF {Type GroundVehicle}" in written(app, "CONF"), "CONF")
    assert "STA" not in written(app, "CONF")
    tabs.active = "pane-Sent"
    await until(pilot, lambda: "> DRIVE {Light True}" in written(app, "Sent"), "what was sent")
    status = app.query_one("#status", Static)
    await until(
        pilot, lambda: "Lookout" in str(status.content) and "speed 50 %" in str(status.content), "status"
    )
    await pilot.click("#do-view")
    await until(pilot, lambda: "{Robot Eye} {Name Right}" in written(app, "Sent"), "the next camera")


def test_a_robot_is_brought_and_seen_and_driven(tmp_path):
    """All of it in one session: typing, completion, panes, driving, pictures, and another connection."""
    with served() as (world, port, image_port), Transcript(tmp_path / "talk.txt") as kept:
        client = ConsoleClient("127.0.0.1", port, transcript=kept)
        pictures = PictureStream("127.0.0.1", image_port, fps=2.0)
        app = ConsoleApp(client, ConsoleOptions(ROBOTS.names, pictures, PictureFiles(tmp_path / "seen")))

        def bound():
            host, _, number = pictures.address.rpartition(":")
            return number and world.view_bindings.get(host, int(number)) == ("Eye", "Ahead")

        def robot():
            return next(iter(world.robots.values()))

        async def script(pilot):
            await brings_a_robot(app, pilot, client)
            # The picture is bound to the robot's camera by itself.
            await until(pilot, bound, "the view")
            await until(pilot, lambda: list((tmp_path / "seen").iterdir()), "a picture")
            await drives(app, pilot, robot)
            await looks_at_panes(app, pilot)
            await pilot.press("f3")
            await until(pilot, lambda: not world.robots, "the robot has left")
            assert client.is_connected

        with_app(app, script)
    talk = (tmp_path / "talk.txt").read_text()
    assert f"> {INIT}" in talk
    assert "< SEN " in talk
    assert talk.count("# connected to") == 2


def test_a_joystick_drives_and_may_go(tmp_path):
    os.mkfifo(tmp_path / "js0")
    with served() as (world, port, _), contextlib.ExitStack() as open_files:
        app = ConsoleApp(ConsoleClient("127.0.0.1", port), ConsoleOptions(joystick=tmp_path / "js0"))

        async def script(pilot):
            device = open_files.enter_context(open(tmp_path / "js0", "wb", buffering=0))
            await say(app, pilot, INIT)
            await until(pilot, lambda: app._client.knowledge.steering)
            device.write(EVENT.pack(0, -FULL, AXIS, 1))
            robot = next(iter(world.robots.values()))
            await until(pilot, lambda: np.all(robot.command.setpoint > 5.0), "full speed")
            device.close()
            await until(pilot, lambda: "the joystick has gone" in written(app, "All"))

        with_app(app, script)


def test_who_is_not_there_ends_the_console_with_one_line():
    app = ConsoleApp(ConsoleClient("127.0.0.1", 1))

    async def main():
        async with app.run_test():
            await asyncio.sleep(0)
        return app.return_value

    assert asyncio.run(main()) == "no connection to 127.0.0.1:1: Connection refused"


def test_a_server_that_goes_and_a_robot_that_is_not_there_are_told():
    with contextlib.ExitStack() as server:
        _, port, _ = server.enter_context(served())
        app = ConsoleApp(
            ConsoleClient("127.0.0.1", port), ConsoleOptions(pictures=PictureStream("127.0.0.1", 1))
        )

        async def script(pilot):
            await until(
                pilot, lambda: "no pictures from 127.0.0.1:1: Connection refused" in written(app, "All")
            )
            for button in ("#do-forward", "#do-light", "#do-trace"):
                await pilot.click(button)
            await until(
                pilot, lambda: written(app, "All").count("there is no robot yet: send INIT first") == 3
            )
            assert "DRIVE" not in written(app, "All")
            await say(app, pilot, "INIT {ClassName USARBot.Lookout {Name Eye}")
            await until(pilot, lambda: "no server can read that: a '{' opens inside" in written(app, "All"))
            await asyncio.to_thread(server.close)
            await until(pilot, lambda: "the server has hung up; F3 connects anew" in written(app, "All"))
            await pilot.click("#do-forward")
            await until(pilot, lambda: written(app, "All").count("has hung up; F3 connects anew") == 2)
            await say(app, pilot, "GETSTARTPOSES")
            await until(pilot, lambda: f"not connected to 127.0.0.1:{port}" in written(app, "All"))
            await pilot.press("f3")
            await until(pilot, lambda: "Connection refused" in written(app, "All").split("not connected")[1])

        with_app(app, script)


class Pad(App):
    """A pad, and what it says."""

    def __init__(self):
        super().__init__()
        self.said = []

    def compose(self):
        yield KeyPad()
        yield Input()

    def on_key_pad_pressed(self, event):
        self.said.append(event.action)

    def on_key_pad_left(self):
        self.said.append("left the pad")


def test_the_mouse_turns_the_camera_while_the_pad_is_in_use():
    """As USAR_UI had it: the mouse tilts and pans, its right button ends that (manual 5.2.1)."""
    app = Pad()

    async def script(pilot):
        pad = app.query_one(KeyPad)
        pad.styles.height = 10
        app.query_one(Input).focus()
        await pilot.pause()
        await pilot.hover(pad, offset=(2, 0))
        await pilot.hover(pad, offset=(20, 5))
        assert app.said == [], "it is not in use"
        pad.focus()
        for place in ((20, 5), (23, 5), (25, 5), (20, 5), (20, 8), (20, 6)):
            await pilot.hover(pad, offset=place)
        assert app.said == ["pan_right", "pan_left", "tilt_down", "tilt_up"]
        await pilot.mouse_down(pad, offset=(20, 6), button=3)
        await pilot.press("escape", "q", "up")
        assert app.said[4:] == ["left the pad", "left the pad", "forward"]

    with_app(app, script)


def test_every_button_does_something():
    names = [name for row in BUTTONS for name, _ in row]
    assert set(names) <= {*ACTIONS, VIEW}
    assert {"left", "forward", "backward", "right", "stop", "faster", "slower", "straight"} <= set(names)
    assert {"tilt_up", "tilt_down", "pan_left", "pan_right", "zoom_in", "zoom_out", "light", "trace"} <= set(
        names
    )


# What panes show


def test_a_message_as_a_tree():
    sonar = parse_message("SEN {Time 1.5} {Type Sonar} {Name F1 Range 2.5} {Name F2 Range 0.4}")
    assert branch(sonar) == {"": {"Time": "1.5"}, "F1": {"Range": "2.5"}, "F2": {"Range": "0.4"}}
    scan = parse_message("SEN {Type RangeScanner} {Name S} {Range " + ",".join(["1.5"] * 40 + ["0.2"]) + "}")
    assert branch(scan) == {"S": {"Range": "41 numbers, 0.2 to 1.5"}}
    words = "red, green, blue, white and black doors, 3.5, " + "and so on, " * 5
    said = branch(parse_message(f"SEN {{Type RFID}} {{Name T}} {{Text {words}}}"))
    assert said["T"]["Text"].startswith("red, green")
    assert said["T"]["Text"].endswith("...")
    holes = parse_message("SEN {Type RangeScanner} {Name S} {Range " + ",".join(["1.5"] * 40 + ["nan"]) + "}")
    assert branch(holes)["S"]["Range"].startswith("1.5,1.5,")
    package = parse_message("MISSTA {Time 1.0} {Name P} {Link 1} {Value 0.5} {Link 2} {Value 0.7}")
    assert branch(package)["P"] == {"Link": "1", "Value": "0.5", "Link 2": "2", "Value 2": "0.7"}


def test_ranges_as_bars_whose_colour_says_how_near():
    sonar = parse_message("SEN {Type Sonar} {Name F1 Range 5.0} {Name F2 Range 2.0} {Name F3 Range 0.5}")
    assert longest_range(sonar) == 5.0
    bars = range_bars(sonar, 5.0, 10)
    assert [(name, drawn.count("█"), color) for name, drawn, color in bars] == [
        ("F1", 10, "green"),
        ("F2", 4, "yellow"),
        ("F3", 1, "red"),
    ]
    scan = parse_message("SEN {Type RangeScanner} {Name S} {Range 1.0,1.0,8.0,8.0}")
    ((name, drawn, color),) = range_bars(scan, longest_range(scan), 2)
    assert (name, drawn, color) == ("S", "█▂", "red"), "the left is on the left, though it comes last"
    assert range_bars(parse_message("SEN {Type Odometry} {Name O} {Pose 1,2,3}"), 1.0, 10) == []


# Pictures


@pytest.mark.parametrize("number", [0, 1])
def test_pictures_of_either_type_are_read(number):
    pixels = np.zeros((4, 6, 3), np.uint8)
    pixels[:2, :, 0] = 255
    image = decode(number, encode_frame(number, pixels)[5:])
    assert image.size == (6, 4)
    assert np.asarray(image)[0, 0, 0] > 200


@pytest.mark.parametrize(
    ("number", "data"), [(0, b"\x00"), (0, b"\x00\x02\x00\x02abc"), (3, b"nothing"), (3, b"")]
)
def test_what_is_no_picture_is_one_line(number, data):
    with pytest.raises(UsageError, match="a picture that cannot be read"):
        decode(number, data)


def test_two_pixels_in_a_character():
    image = Image.new("RGB", (4, 4))
    image.paste((255, 0, 0), (0, 0, 4, 2))
    image.paste((0, 0, 255), (0, 2, 4, 4))
    rows = half_blocks(image, 4, 2)
    assert rows == [[((255, 0, 0), (255, 0, 0))] * 4, [((0, 0, 255), (0, 0, 255))] * 4]
    assert half_blocks(image, 4, 1) == [[((255, 0, 0), (0, 0, 255))] * 2], "in proportion"
    view = PictureView()
    view._rows = rows
    strip = view.render_line(1)
    assert strip.text == "▀▀▀▀"
    assert next(iter(strip)).style.color.triplet == (0, 0, 255)


def test_pictures_go_into_a_folder_under_free_numbers(tmp_path):
    files = PictureFiles(tmp_path / "a" / "b")
    first = files.save(Image.new("RGB", (2, 2)))
    second = PictureFiles(tmp_path / "a" / "b").save(Image.new("RGB", (2, 2), (9, 8, 7)))
    assert (first.name, second.name) == ("picture-000000.png", "picture-000001.png")
    assert Image.open(io.BytesIO(second.read_bytes())).getpixel((0, 0)) == (9, 8, 7)
