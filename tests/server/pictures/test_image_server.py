"""The image server on real sockets: pictures of a running world, pace, and clients that misbehave.

A world is served from a thread of this process. Where the picture itself does not matter, a painter takes the
camera's place, which counts what it paints.
"""

import contextlib
import re
import socket
import struct
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.scripts import load
from tests.server.peers import PATIENCE, wait_until
from tests.server.watchers import DISTANCE, SIDE, classes, gallery, on_show, shows
from usarmjx.cli.app import app
from usarmjx.server.pictures import image_server
from usarmjx.server.protocol.viewports import MultiView
from usarmjx.server.viewing.controls import ServedControls
from usarmjx.server.viewing.viewer_service import ViewerService

WIDTH, HEIGHT = 96, 72


@pytest.fixture(scope="module")
def gallery_world():
    with classes():
        yield gallery()


@pytest.fixture
def world(gallery_world):
    """The one world, in which a test leaves no traces: painters have no depths to draw them at."""
    yield gallery_world
    gallery_world.traces.points.clear()


class Painter:
    """Paints plain pictures in the colour of their number."""

    def __init__(self):
        self.count = 0

    def snapshot(self, shots):
        self.count += 1
        number = self.count
        rgbs = [np.full((shot.height, shot.width, 3), number % 256, np.uint8) for shot in shots]
        return lambda: [SimpleNamespace(rgb=rgb) for rgb in rgbs]


@pytest.fixture
def painter(world, monkeypatch):
    painter = Painter()
    monkeypatch.setattr(world, "snapshot", painter.snapshot)
    return painter


@pytest.fixture
def painted(world, painter):
    """A server of plain pictures, and a robot that nobody disturbs; its reports must come in step."""
    with on_show(world) as show:
        bystander = show.robot("Cyclops", "R1")
        yield show
        bystander.sta_times(5)
        np.testing.assert_allclose(np.diff(bystander.times), 0.2, atol=0.011)  # two decimals


# Pictures of the world


@contextlib.contextmanager
def looking(world, start="S0", **settings):
    """A robot that has come to rest, and a client that has got the first picture of its camera Ahead."""
    with on_show(world, **settings) as show:
        robot = show.robot("Lookout", "R1", start)
        robot.say("SET {Type Viewports} {Config SingleView}")
        robot.sta_times(3)
        viewer = show.viewer()
        viewer.picture()
        yield robot, viewer


def test_a_wall_of_known_width_covers_the_right_number_of_pixels_and_zoom_changes_it(world):
    """A pinhole: f = (width / 2) / tan(fov / 2) pixels, and a side of the target has f * side / distance."""
    with looking(world) as (robot, viewer):
        for fov in (1.0, 0.5, 2.0, 0.75):
            robot.say(f"SET {{Type Camera}} {{Name Ahead}} {{FOV {fov}}}")
            assert f"{{Name Ahead}} {{FOV {fov:.4f}}} {{Status OK}}".encode() in robot.until(b"RES")
            picture = viewer.next()
            assert picture.shape == (HEIGHT, WIDTH, 3)
            side = WIDTH / 2 / np.tan(fov / 2) * SIDE / DISTANCE
            # The edges are somewhere within a pixel.
            assert (side - 1) ** 2 < shows(picture, "red") < (side + 1) ** 2
            rows, columns = np.nonzero(picture[..., 0] > 2.0 * picture[..., 1])
            np.testing.assert_allclose([rows.mean(), columns.mean()], [35.5, 47.5], atol=1.0)


def test_quad_view_follows_set_and_a_jpeg_is_nearly_the_raw_picture(world):
    """Manual 9.4: viewport 1 is top left, 2 top right, 3 bottom left."""
    corners = [np.s_[:HEIGHT, :WIDTH], np.s_[:HEIGHT, WIDTH:], np.s_[HEIGHT:, :WIDTH], np.s_[HEIGHT:, WIDTH:]]
    pictures = []
    for kind in (0, 1):
        with looking(world, size=(2 * WIDTH, 2 * HEIGHT), format=kind) as (robot, viewer):
            robot.say("SET {Type Viewports} {Config QuadView} {Viewport3 Disable} {Viewport4 Ahead}")
            robot.until(b"RES")
            pictures.append(viewer.next())
    raw, jpeg = pictures
    assert [shows(raw[part], "red") > 500 for part in corners] == [True, False, False, True]
    assert [shows(raw[part], "green") > 500 for part in corners] == [False, True, False, False]
    assert not raw[corners[2]].any()
    # Super quality rounds 64 frequencies and three colours to whole numbers: an error of some tenths.
    assert np.sqrt(((jpeg.astype(float) - raw) ** 2).mean()) < 1.0


def test_a_trace_is_visible_and_stays(world):
    """Manual 9.4, 5.2.5.1. The camera looks ahead, so the robot drives backwards from its trace."""
    with looking(world, "S2") as (robot, viewer):
        assert shows(viewer.next(), "green") == 0
        robot.say("Trace {On true} {Color Green}")
        robot.say("DRIVE {Left -5} {Right -5}")
        # The reports of the seconds in which the first picture was compiled come before the answer to this.
        robot.say("SET {Type Camera} {Name Ahead} {FOV 1.0}")
        robot.until(b"RES")
        robot.sta_times(40)
        robot.say("DRIVE {Left 0} {Right 0}")
        robot.say("Trace {On false}")
        robot.sta_times(2)
        assert shows(viewer.next(), "green") > 20
        assert shows(viewer.next(), "red") == 0


def test_reports_keep_coming_while_pictures_are_pulled(world):
    """0.2 s apart on an idle machine; this one may have other things to do."""
    with looking(world, fps=10.0, realtime_factor=1.0) as (robot, viewer):
        ended, gaps = threading.Event(), []

        def pull():
            while not ended.is_set():
                viewer.next()

        puller = threading.Thread(target=pull)
        puller.start()
        robot.sta_times(2)
        before = time.monotonic()
        for _ in range(10):
            robot.sta_times(1)
            gaps.append(time.monotonic() - before)
            before += gaps[-1]
        ended.set()
        puller.join(PATIENCE)
        np.testing.assert_allclose(np.diff(robot.times[-10:]), 0.2, atol=0.011)
        assert max(gaps) < 1.0


# The protocol


def test_a_picture_comes_when_a_client_connects_and_then_one_for_each_ok(painted):
    """Manual 14.5.3."""
    viewer = painted.viewer()
    number, data = viewer.frame()
    assert (number, len(data), data[:4]) == (0, 4 + 3 * WIDTH * HEIGHT, struct.pack(">HH", WIDTH, HEIGHT))
    assert viewer.silent(0.3)
    for _ in range(3):
        viewer.next()
    assert viewer.silent(0.3)


def test_a_client_that_asks_first_gets_one_picture_at_a_time(painted):
    """usarimage2ros: OK right after connecting, and no frame may follow another before the next OK."""
    viewer = painted.viewer(text=b"OK\r\n")
    viewer.picture()
    assert viewer.silent(0.3)


def test_nobody_waits_and_nothing_is_painted(painted, painter):
    assert painter.count == 0
    viewer = painted.viewer()
    viewer.picture()
    time.sleep(0.3)
    assert painter.count == 1


def test_who_waits_for_too_long_gets_a_black_picture_or_the_last_one(world, painter, monkeypatch):
    """A picture may take seconds; others are sent meanwhile, one for each that is asked for."""
    gate, paint = threading.Event(), painter.snapshot

    def snapshot(shots):
        take = paint(shots)
        return lambda: take() if gate.wait(PATIENCE) else []

    monkeypatch.setattr(world, "snapshot", snapshot)
    with on_show(world, patience=0.1) as show:
        robot = show.robot("Cyclops", "R1")
        viewer = show.viewer()
        assert not viewer.picture().any()
        assert not viewer.next().any()
        assert viewer.silent(0.3)
        robot.sta_times(2)

        gate.set()
        wait_until(lambda: viewer.next().any(), "a picture of the world")
        gate.clear()
        viewer.next()  # perhaps that which was on its way
        pictures = [viewer.next() for _ in range(3)]
        last = pictures[0].max()
        assert last > 0
        assert all((picture == last).all() for picture in pictures)
        viewer.socket.sendall(b"U" + struct.pack(">4I", 90, 10, 20, 30))
        part = viewer.picture()
        assert part.shape == (30, 6, 3)
        assert not part.any(), "of this part there was none yet"
        gate.set()
        wait_until(lambda: (viewer.next() > last).all(), "the next picture of the world")


@pytest.mark.alone
def test_the_frame_rate_is_held(world, painter):
    with on_show(world, fps=5.0, realtime_factor=1.0) as show:
        show.robot("Cyclops", "R1")
        viewer = show.viewer()
        viewer.picture()
        began = time.monotonic()
        for _ in range(6):
            viewer.next()
        # Six pictures after the first one, each on a time that the frame rate sets; each a control step late
        # at most on an idle machine.
        assert 1.2 - 0.05 <= time.monotonic() - began < 3.0


def test_clients_that_wait_for_the_same_share_a_picture(world, painter):
    with on_show(world, fps=2.0) as show:
        show.robot("Cyclops", "R1")
        viewers = [show.viewer() for _ in range(4)]
        for viewer in viewers:
            viewer.picture()
        time.sleep(1.0)
        painter.count = 0
        for viewer in viewers:
            viewer.acknowledge()
        for viewer in viewers:
            viewer.picture()
        assert painter.count <= 2


def test_a_part_of_the_picture(painted):
    """The U request of the later versions' image server."""
    viewer = painted.viewer(text=b"OK")
    viewer.picture()
    viewer.socket.sendall(b"U" + struct.pack(">4I", 90, 10, 20, 30))
    assert viewer.picture().shape == (30, 6, 3)


@pytest.mark.parametrize("number", range(6))
def test_every_format(world, painter, number):
    with on_show(world, format=number) as show:
        viewer = show.viewer()
        kind, data = viewer.frame()
        assert kind == number
        assert data.startswith(b"\xff\xd8") == (number > 0)


def test_without_a_robot_the_picture_is_black(painted, painter):
    with contextlib.closing(painted.viewer(address="127.0.0.9")) as viewer:
        operator = painted.robot("Mole", "M", "S1")
        operator.say("SET {Type Camera} {Robot Nobody} {Client 127.0.0.9}")
        operator.sta_times(1)
        viewer.picture()
        assert not viewer.next().any()
        operator.say("SET {Type Camera} {Client 127.0.0.9}")
        operator.sta_times(1)
        viewer.next()
        assert viewer.next().any()


def test_views_are_tied_by_address(painted, world, monkeypatch):
    """Manual 9.4; several operators, each with a camera of its own."""

    def snapshot(shots):
        levels = {"R1": 50, "R2": 100}
        rgbs = [np.full((s.height, s.width, 3), levels[s.robot.name] + s.camera, np.uint8) for s in shots]
        return lambda: [SimpleNamespace(rgb=rgb) for rgb in rgbs]

    monkeypatch.setattr(world, "snapshot", snapshot)
    other = painted.robot("Lookout", "R2", "S1")
    first, second = painted.viewer(address="127.0.0.2"), painted.viewer(address="127.0.0.3")
    other.say("SET {Type Camera} {Robot R2} {Name Behind} {Client 127.0.0.3}")
    other.sta_times(1)
    for viewer, level in ((first, 50), (second, 102)):
        viewer.picture()
        assert (viewer.next() == level).all()
    other.close()
    wait_until(lambda: len(world.robots) == 1, "R2 to leave")
    second.next()
    assert not second.next().any()
    assert (first.next() == 50).all()


def test_multi_view_is_one_picture_that_clients_split(world, monkeypatch):
    """Manual 3.2.6.2: the tile is the View of the robot's STA."""

    def snapshot(shots):
        rgbs = [np.full((s.height, s.width, 3), int(s.robot.name[1:]), np.uint8) for s in shots]
        return lambda: [SimpleNamespace(rgb=rgb) for rgb in rgbs]

    monkeypatch.setattr(world, "snapshot", snapshot)
    shared = MultiView(camera_num=4, wide_mode=4, camera_x_res=40, camera_y_res=30)
    with on_show(world, size=shared.size, multi_view=shared) as show:
        robots = {level: show.robot("Cyclops", f"R{level}", f"S{i}") for i, level in enumerate((60, 70, 80))}
        viewer = show.viewer()
        viewer.picture()
        picture = viewer.next()
        assert picture.shape == (30, 160, 3)
        for level, robot in robots.items():
            view = int(re.search(rb"{View (\d)}", robot.until(b"STA"))[1])
            assert (picture[:, 40 * view : 40 * view + 40] == level).all()
        assert not picture[:, 120:].any()
    world.multi_view = None


def test_the_bundled_client(painted):
    """usarmjx/client."""
    client = load("usarsim_client")
    with client.CameraClient(port=painted.service.port, timeout=PATIENCE) as images:
        for _ in range(3):
            image = images.picture()
            assert (image.width, image.height, len(image.rgb)) == (WIDTH, HEIGHT, 3 * WIDTH * HEIGHT)
        with client.UsarsimClient(port=painted.port, timeout=PATIENCE) as robot:
            robot.init("USARBot.Lookout", "R2", (0.0, -20.0, -0.2))
            assert robot.zoom("Behind", 0.75) == 0.75
            robot.view(images.name, "Nobody")
            images.picture()
            wait_until(lambda: not any(images.picture().rgb), "a view of nobody")
            robot.view(images.name)
            wait_until(lambda: any(images.picture().rgb), "the view to be let go")


# Clients that misbehave


def test_a_flood_of_acknowledgements_and_junk(painted, painter):
    vandal = painted.viewer()
    vandal.socket.settimeout(0.2)
    junk = np.random.default_rng(0).bytes(50_000)
    for _ in range(20):
        with contextlib.suppress(TimeoutError):
            vandal.socket.sendall(b"OK" * 50_000 + junk)
    viewer = painted.viewer()
    for _ in range(5):
        viewer.next()
    for client in painted.service._clients:  # whoever does not read has no more than one picture waiting
        assert client.writer.transport.get_write_buffer_size() <= 9 + 3 * WIDTH * HEIGHT
        assert len(client.session._pending) < 17


def test_who_does_not_read_is_dropped(world, painter, monkeypatch):
    monkeypatch.setattr(image_server, "STALL", 0.5)
    with on_show(world, size=(640, 480)) as show:
        robot = show.robot("Cyclops", "R1")
        deaf = show.viewer(room=4096, text=b"OK")
        wait_until(lambda: show.service._clients, "the client to come in")
        wait_until(lambda: not show.service._clients, "it to be dropped")
        robot.sta_times(2)
        assert not deaf.silent(1.0)


def test_who_never_acknowledges_costs_one_picture(painted, painter):
    idle = [painted.viewer() for _ in range(5)]
    for viewer in idle:
        viewer.picture()
    before = painter.count
    time.sleep(0.5)
    assert painter.count == before <= 5


def test_who_leaves_in_the_middle_of_everything(painted):
    for text in (b"", b"O", b"OK", b"U\x00\x00", b"OKOK"):
        with painted.viewer(text=text):
            pass
        rude = painted.viewer(text=text)
        rude.exactly(3)
        rude.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        rude.close()
    painted.viewer().picture()
    wait_until(lambda: len(painted.service._clients) == 1, "the others to be gone")


def test_the_most_silent_client_yields_when_all_places_are_taken(world, painter):
    with on_show(world, max_connections=3) as show:
        show.robot("Cyclops", "R1")
        viewers = [show.viewer() for _ in range(3)]
        for viewer in viewers:
            viewer.picture()
        for viewer in (viewers[0], viewers[2]):
            viewer.next()
        late = show.viewer()
        late.picture()
        viewers[1].acknowledge()
        with pytest.raises(ConnectionError):
            viewers[1].frame()
        for viewer in (viewers[0], viewers[2], late):
            viewer.next()


def test_a_camera_that_fails_loses_its_clients_and_nothing_else(painted, world, monkeypatch, caplog):
    def broken(shots):
        def take():
            raise RuntimeError("the film is torn")

        return take

    with monkeypatch.context() as patch:
        patch.setattr(world, "snapshot", broken)
        with pytest.raises(ConnectionError):
            painted.viewer().frame()
    wait_until(lambda: "the film is torn" in caplog.text, "the log to say why")
    painted.viewer().picture()


def test_the_end_of_the_server_is_the_end_of_the_connections(world, painter):
    with on_show(world) as show:
        viewer = show.viewer()
        viewer.picture()
        show._open.pop_all()
    with pytest.raises(ConnectionError):
        viewer.frame()
    viewer.close()


# Starting


def test_the_port_is_announced(world, painter, capfd):
    with on_show(world) as show:
        port = show.service.port
    assert f"usarmjx: pictures on 127.0.0.1:{port}\n" in capfd.readouterr().out


def asked_for(server):
    """The services of a server but the live page, which all have, and its controls."""
    return [one for one in server.services if not isinstance(one, (ViewerService, ServedControls))]


def served(monkeypatch, *words):
    """The services and the result of a command line that is not carried out."""
    box = {"services": []}
    monkeypatch.setattr(
        "usarmjx.server.worlds.make.make_worlds", lambda *args, **kwargs: [SimpleNamespace(period=0.02)]
    )
    monkeypatch.setattr(
        "usarmjx.server.runtime.loop.serve", lambda servers, *_: box.update(services=asked_for(servers[0]))
    )
    result = CliRunner().invoke(app, ["serve", "--no-wireless", *words])
    return box["services"], result


def test_options_of_the_command_line(monkeypatch, tmp_path):
    """Manual 3.2.5.2: address, format, resolution and frames per second are chosen when it starts."""
    (service,), _ = served(monkeypatch)
    usual = service._settings
    assert (usual.host, usual.port, usual.size, usual.fps) == ("127.0.0.1", 5003, (320, 240), 10.0)
    assert (usual.format, usual.multi_view) == (3, None)
    words = ["--image-port", "5403", "--image-size", "64x48", "--image-fps", "2.5", "--image-format", "raw"]
    (service,), _ = served(monkeypatch, *words, "--host", "0.0.0.0")
    mine = service._settings
    assert (mine.host, mine.port, mine.size, mine.fps, mine.format) == ("0.0.0.0", 5403, (64, 48), 2.5, 0)
    ini = tmp_path / "USARBot.ini"
    ini.write_text("[USARBot.MultiView]\nCameraNum=2\nWideMode=2\nCameraXres=100\nCameraYres=75\n")
    (service,), _ = served(monkeypatch, "--multi-view", "--ini", str(ini))
    assert service._settings.size == (200, 75)
    assert service._world.multi_view == MultiView(2, 2, 100, 75)
    (service,), _ = served(monkeypatch, "--multi-view", "--image-size", "64x48")
    assert (service._settings.size, service._world.multi_view) == ((64, 48), MultiView())
    assert served(monkeypatch, "--no-images")[0] == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--image-size", "big"], "'big' is not of the form 320x240"),
        (["--image-format", "gif"], "no picture format 'gif'"),
    ],
)
def test_a_wrong_option_is_one_clear_line_and_exit_code_2(monkeypatch, words, says):
    _, result = served(monkeypatch, *words)
    assert result.exit_code == 2
    assert re.fullmatch(rf"usarmjx: .*{re.escape(says)}.*\n", result.stderr)


def test_a_taken_port_is_one_clear_line_and_exit_code_2(world, monkeypatch):
    monkeypatch.setattr("usarmjx.server.worlds.make.make_worlds", lambda *args, **kwargs: [world])
    with contextlib.closing(socket.create_server(("127.0.0.1", 0))) as taken:
        number = taken.getsockname()[1]
        words = ["serve", "--port", "0", "--no-wireless", "--image-port", str(number)]
        result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert re.fullmatch(rf"usarmjx: cannot listen on 127\.0\.0\.1:{number}: .*\n", result.stderr)
