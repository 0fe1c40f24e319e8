"""The viewing client: what a spectator's buttons and keys do, and the page over HTTP."""

import contextlib
import http.client
import io
import json
import math
import re
import socket
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from tests.server.peers import PATIENCE, Peer, serving
from tests.server.watchers import DISTANCE, EYE, SIDE, classes, gallery, shows
from usarmjx.cli.app import app
from usarmjx.sensors.cameras.paint import ROBOT_LABEL
from usarmjx.server.gamebots.console import NOT_ALLOWED
from usarmjx.server.network.access import AccessRules
from usarmjx.server.pictures.spectator import (
    CHASE_ABOVE,
    CHASE_BEHIND,
    LOOK_DOWN,
    MAX_MOVE,
    STEEPEST,
    Spectator,
    start_position,
)
from usarmjx.server.pictures.spectator_server import Page, SpectatorServer, SpectatorSettings
from usarmjx.server.protocol.viewports import MultiView
from usarmjx.server.runtime.loop import StepClock
from usarmjx.server.viewing.controls import ServedControls

SIZE = (96, 72)


@pytest.fixture(scope="module")
def world():
    with classes():
        yield gallery()


@pytest.fixture
def robots(world):
    """A robot with three cameras at the origin, one with one, one with none, 20 m apart."""
    kinds = [world_class(name) for name in ("Lookout", "Cyclops", "Mole")]
    here = [
        world.spawn(kind, f"R{i}", (0.0, 20.0 * i, 0.188), (0.0, 0.0, 0.5 * i))
        for i, kind in enumerate(kinds)
    ]
    yield here
    for robot in here:
        if robot.slot in world.robots:
            world.remove(robot)


def world_class(name):
    from usarmjx.models.robots import ROBOTS

    return ROBOTS.get(name)


def picture(spectator):
    """What a spectator sees."""
    from usarmjx.server.pictures.views import snapshot

    view = spectator.view()
    shots = [shot for shot, _, _ in view.tiles]
    return view.compose(dict(zip(shots, snapshot(spectator.world, shots)(), strict=True)))


def test_the_left_button_goes_from_robot_to_robot_and_the_right_one_lets_go(world, robots):
    watcher = Spectator(world, SIZE)
    assert watcher.caption() == "free view"
    names = []
    for _ in range(4):
        watcher.handle_message({"click": "left"})
        names.append(watcher.robot.name)
    assert names == ["R0", "R1", "R2", "R0"]
    assert watcher.caption() == "R0, Lookout"
    watcher.handle_message({"click": "right"})
    assert watcher.caption() == "free view"
    watcher.handle_message({"click": "left"})
    world.remove(robots[0])
    assert watcher.caption() == "free view", "who is looked at has gone"
    watcher.handle_message({"click": "left"})
    assert watcher.robot is robots[1]


def test_after_the_last_robot_comes_the_multi_view(world, robots, monkeypatch):
    monkeypatch.setattr(world, "multi_view", MultiView(camera_num=4))
    watcher, seen = Spectator(world, SIZE), []
    for _ in range(5):
        watcher.handle_message({"click": "left"})
        seen.append(watcher.caption())
    assert seen == ["R0, Lookout", "R1, Cyclops", "R2, Mole: over it", "MultiView", "R0, Lookout"]


def test_an_attached_view_is_that_of_the_robots_cameras(world, robots):
    """A robot with several cameras starts with four viewports (manual 9.4): ahead, right, behind, none."""
    watcher = Spectator(world, SIZE)
    watcher.handle_message({"click": "left"})
    seen = picture(watcher)
    half = SIZE[1] // 2, SIZE[0] // 2
    quarters = seen[: half[0], : half[1]], seen[: half[0], half[1] :], seen[half[0] :, : half[1]]
    for quarter, color in zip(quarters, ("red", "green", "blue"), strict=True):
        assert shows(quarter, color) > 50
    assert not seen[half[0] :, half[1] :].any()
    robots[0].viewports = type(robots[0].viewports).of(["Ahead"])
    assert shows(picture(watcher), "red") > shows(quarters[0], "red")


@pytest.mark.parametrize("number", [0, 1, 2])
def test_c_shows_a_robot_from_behind_and_above(world, robots, number):
    watcher, robot = Spectator(world, SIZE), robots[number]
    for _ in range(number + 1):
        watcher.handle_message({"click": "left"})
    if robot.cameras:
        watcher.handle_message({"key": "C"})
    assert watcher.caption().endswith(": over it")
    eye = watcher.view().tiles[0][0].viewpoint
    yaw, length = 0.5 * number, max(robot.spec.dimensions[:2])
    behind, above = (at + share * length for at, share in (CHASE_BEHIND, CHASE_ABOVE))
    at = world.state(robot).pos
    expected = at + np.array([-behind * math.cos(yaw), -behind * math.sin(yaw), above])
    np.testing.assert_allclose(eye.pos, expected, atol=1e-4)
    ahead = [math.cos(yaw) * math.cos(LOOK_DOWN), math.sin(yaw) * math.cos(LOOK_DOWN), -math.sin(LOOK_DOWN)]
    np.testing.assert_allclose(eye.mat[:, 0], ahead, atol=1e-4)
    taken = world.snapshot([watcher.view().tiles[0][0]])()[0]
    row, column = np.nonzero(taken.segmentation == ROBOT_LABEL + robot.slot)
    assert len(row) > 100
    assert abs(column.mean() - SIZE[0] / 2) < SIZE[0] / 8, "it is in the middle"
    if robot.cameras:
        watcher.handle_message({"key": "c"})
        assert not watcher.caption().endswith("over it")


def test_the_free_view_is_moved_and_turned(world):
    """From in front of the red target, whose height in the picture follows from the field of view."""
    watcher = Spectator(world, SIZE)
    watcher.pos, watcher.yaw, watcher.pitch = np.array([0.0, 0.0, EYE]), math.pi / 2, 0.0
    watcher.handle_message({"turn": [-math.pi / 2, 0.0]})
    before = shows(picture(watcher), "red")
    assert shows(picture(watcher), "green") == 0
    pixels = SIZE[0] / 2 / math.tan(math.radians(37.5))  # of 1 m in a distance of 1 m
    assert before == pytest.approx((SIDE / DISTANCE * pixels) ** 2, rel=0.15)
    watcher.handle_message({"move": [1.0, 0.0, 0.0]})
    np.testing.assert_allclose(watcher.pos, [1.0, 0.0, EYE], atol=1e-6)
    assert shows(picture(watcher), "red") == pytest.approx(
        before * (DISTANCE / (DISTANCE - 1)) ** 2, rel=0.15
    )
    watcher.handle_message({"move": [0.0, 2.0, 1.0], "turn": [0.0, 9.0]})
    np.testing.assert_allclose(watcher.pos, [1.0, 2.0, EYE + 1.0], atol=1e-6)
    assert watcher.pitch == STEEPEST


@pytest.mark.parametrize(
    "message",
    [None, 3, [], {}, {"move": "ahead"}, {"move": [1, 2]}, {"move": [math.nan, 0, 0]}, {"turn": [None, 1]}],
)
def test_what_is_not_understood_changes_nothing(world, message):
    watcher = Spectator(world, SIZE)
    before = (*watcher.pos, watcher.yaw, watcher.pitch)
    watcher.handle_message(message)
    assert (*watcher.pos, watcher.yaw, watcher.pitch) == before


def test_nobody_moves_far_at_once(world):
    watcher = Spectator(world, SIZE)
    start = watcher.pos.copy()
    watcher.pitch = 0.0
    watcher.handle_message({"move": [1e9, 0.0, 0.0]})
    assert np.linalg.norm(watcher.pos - start) == pytest.approx(MAX_MOVE)


# On sockets


@contextlib.contextmanager
def watched(world, **settings):
    """The port of Gamebots, and that of the page."""
    service = SpectatorServer(world, SpectatorSettings(port=0, size=SIZE, **settings))
    with serving(world, [service]) as (port, _):
        yield port, service.port


def ask(port, path, *headers):
    """Status, type and text of what HTTP answers; further headers stand in place of the usual Host."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.putrequest("GET", path, skip_host=bool(headers))
    for header in headers:
        connection.putheader(*header)
    connection.endheaders()
    answer = connection.getresponse()
    return answer.status, answer.headers["Content-Type"], answer.read().decode()


def view_as(port, host, **how):
    """A connection for pictures under a name that leads to this machine."""
    return connect(f"ws://{host}/view", sock=socket.create_connection(("127.0.0.1", port)), **how)


def look(socket, **told):
    """Caption and picture of the next view after what is told."""
    for key, value in told.items():
        socket.send(json.dumps({key: value}))
    socket.send(json.dumps({"ready": True}))
    caption = json.loads(socket.recv(timeout=PATIENCE))
    return caption, np.asarray(Image.open(io.BytesIO(socket.recv(timeout=PATIENCE))))


def test_a_browser_gets_the_page_and_the_page_its_pictures(world):
    with watched(world) as (port, page):
        status, kind, text = ask(page, "/")
        assert (status, kind) == (200, "text/html; charset=utf-8")
        assert "/view" in text
        assert ask(page, "/etc/passwd")[0] == 404
        robot = Peer(port, "INIT {ClassName USARBot.Cyclops} {Name Eye} {Start S0}")
        robot.until(b"STA")
        with connect(f"ws://127.0.0.1:{page}/view") as socket:
            caption, seen = look(socket)
            assert caption["caption"] == "free view"
            assert seen.shape == (SIZE[1], SIZE[0], 3)
            assert np.ptp(seen) > 50
            socket.send("nonsense")
            socket.send(json.dumps({"click": "elsewhere"}))
            caption, seen = look(socket, click="left")
            assert caption["caption"] == "Eye, Cyclops"
            assert shows(seen, "red") > 100
            later, _ = look(socket, key="c")
            assert later["caption"] == "Eye, Cyclops: over it"
            assert later["time"] > caption["time"]
        robot.close()


def tell(socket, line):
    """What the console answers."""
    socket.send(json.dumps({"console": line}))
    return json.loads(socket.recv(timeout=PATIENCE))["console"]


def test_the_pages_console_edits_robots_and_says_where_the_camera_is(world):
    with watched(world) as (port, page):
        robot = Peer(port, "INIT {ClassName USARBot.Cyclops} {Name Eye} {Start S0}")
        robot.until(b"STA")
        with connect(f"ws://127.0.0.1:{page}/view") as socket:
            for _ in range(3):
                look(socket)
            x, y, z = start_position(world.arena)
            camera, shown, *_ = tell(socket, "showdebug").splitlines()
            assert camera.startswith(f"camera: {{Location {x:.2f},{-y:.2f},{-z:.2f}}}")
            assert float(re.fullmatch(r"free view, ([0-9.]+) pictures a second", shown)[1]) > 0
            assert "Eye (Cyclops)" in tell(socket, "editactor class=Cyclops")
            assert "msgTimer=0.5" in tell(socket, "editactor name=Eye msgTimer=0.5")
            for _ in range(200):  # the first ones have been on their way for long
                if np.ptp(times := robot.sta_times(3)) > 0.9:
                    break
            assert np.diff(times) == pytest.approx([0.5, 0.5], abs=0.03)
            assert "nothing here can make this world stand still" in tell(socket, "pause")
            look(socket, click="left")
            assert "Eye, Cyclops" in tell(socket, "showdebug")
        robot.close()


def test_the_pages_console_lets_the_world_stand_still_and_go_on(world):
    service, clock = SpectatorServer(world, SpectatorSettings(port=0, size=SIZE)), StepClock(1.0)
    with serving(world, [service], realtime_factor=clock) as (_, server):
        service.controls = ServedControls([server], clock)
        with connect(f"ws://127.0.0.1:{service.port}/view") as socket:
            assert tell(socket, "pause") == "it stands still"
            first, _ = look(socket)
            assert ", paused" in tell(socket, "showdebug")
            assert look(socket)[0]["time"] == first["time"]
            assert tell(socket, "pause") == "it goes on"
            for _ in range(200):
                if look(socket)[0]["time"] > first["time"]:
                    break
            else:
                raise AssertionError("it still stands still")


@pytest.mark.parametrize(
    ("address", "token", "may"),
    [("192.0.2.1", "", False), ("192.0.2.1", "secret", True), ("::ffff:127.0.0.1", "", True)],
)
def test_the_console_of_a_page_is_for_this_machine_or_those_with_the_token(world, address, token, may):
    service = SpectatorServer(world, SpectatorSettings(port=0, size=SIZE, access=AccessRules(token=token)))
    page = Page(SimpleNamespace(remote_address=(address, 1)), Spectator(world, SIZE))
    told = service._console(page).run("editactor")
    assert told.startswith("say which one") if may else told == f"editactor: {NOT_ALLOWED}"


def test_pages_from_elsewhere_and_too_many_are_turned_away(world):
    with watched(world, max_connections=1) as (_, page):
        address = f"ws://127.0.0.1:{page}/view"
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin="http://example.org")
        with connect(address, origin=f"http://127.0.0.1:{page}") as first:
            look(first)
            with connect(address) as second, pytest.raises(ConnectionClosed, match="1 pages are open"):
                second.recv(timeout=PATIENCE)
            look(first)


def test_another_sites_name_gets_nothing(world, caplog):
    """Who makes a name of his own lead here (DNS rebinding) has the browser say that name."""
    with watched(world, names=("sim.example.org", "192.0.2.7")) as (_, page):
        own = ["localhost", "LOCALHOST.", f"a.localhost:{page}", f"127.0.0.1:{page}", "Sim.Example.org:80"]
        for host in (*own, "192.0.2.7"):
            assert ask(page, "/", ("Host", host))[0] == 200, host
        wrong = ["evil.example", f"evil.example:{page}", "192.0.2.8", "localhost.evil.example", "[::1]", ""]
        for host in (*wrong, "evil@localhost", "localhost/x"):
            assert ask(page, "/", ("Host", host))[0] == 403, host
        assert "--allow-host" in ask(page, "/view", ("Host", "evil.example"))[2]
        assert ask(page, "/", ("Host", "localhost"), ("Host", "evil.example"))[0] == 403
        assert ask(page, "/view", ("Host", "localhost"), *[("Origin", "http://localhost")] * 2)[0] != 500
        for host in ("evil.example", f"evil.example:{page}"):
            with pytest.raises(InvalidStatus, match="403"):
                view_as(page, host, origin=f"http://{host}")
        with view_as(page, f"localhost:{page}", origin=f"http://localhost:{page}") as socket:
            look(socket)
        with pytest.raises(InvalidStatus, match="403"):
            view_as(page, f"localhost:{page}", origin="http://[")
    assert not [record for record in caplog.records if record.exc_info]


@pytest.mark.parametrize(
    "text",
    [
        "[" * 1000,
        "[" * 500 + "]" * 500,
        '{"key": ' + "[" * 400 + "]" * 400 + "}",
        '{"move": [%s, 0, 0]}' % ("9" * 400),
        '{"turn": [0, -%s]}' % ("9" * 400),
        b'{"move": [%s, 0, 0]}' % (b"9" * 400),
    ],
    ids=["open", "nested", "key", "move", "turn", "bytes"],
)
def test_messages_that_no_page_sends_end_the_connection(world, caplog, text):
    with watched(world) as (_, page):
        with connect(f"ws://127.0.0.1:{page}/view") as socket:
            socket.send(text)
            with pytest.raises(ConnectionClosed) as closed:
                socket.recv(timeout=PATIENCE)
        assert closed.value.rcvd.code == 1008
        assert re.search("at most .* (brackets|digits)", closed.value.rcvd.reason)
        with connect(f"ws://127.0.0.1:{page}/view") as socket:
            look(socket, move=[1, 0, 0.5], turn=[0.1, 0])
    (record,) = caplog.records
    assert "a message has at most" in record.getMessage() or "a number has at most" in record.getMessage()
    assert not record.exc_info


def test_a_name_that_is_none_is_one_clear_line():
    options = ["--port", "0", "--spectator-port", "0", "--allow-host", "http://sim.example.org"]
    done = CliRunner().invoke(app, ["serve", *options])
    assert done.exit_code == 2
    assert "--allow-host: 'http://sim.example.org' is no host; expected a name" in done.output


def test_a_taken_port_is_one_clear_line(world):
    with watched(world) as (_, page):
        options = ["--port", "0", "--no-images", "--no-wireless", "--spectator-port", str(page)]
        done = CliRunner().invoke(app, ["serve", "--engine", "c", *options])
        assert done.exit_code == 2
        assert f"cannot listen on 127.0.0.1:{page}" in done.output
