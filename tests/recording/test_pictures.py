"""Maps and pictures of cameras in exported recordings, read by three independent readers."""

import io
import math
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from PIL import Image
from typer.testing import CliRunner

from tests.recording.missions import ROOM, SIDE
from usarmjx.cli.app import app
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.plots.films.picture import SIZE
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.recorded import record_worlds

pytest.importorskip("mcap_protobuf")
pytest.importorskip("rosbags")
from mcap_protobuf.decoder import DecoderFactory
from mcap_ros2.reader import read_ros2_messages
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

FOV = 1.0
"""Field of view along a picture's rows [rad]."""
EYE = Mount(
    kind="Camera",
    name="Eye",
    at=(0.1, 0.0, -0.2),
    options=options(CameraDefFov=FOV, CameraMinFov=FOV, CameraMaxFov=FOV),
)
WATCHER = replace(ROBOTS.get("P2DX"), name="Watcher", sensors=(), cameras=(EYE,))
TARGET = (1.2, 0.5, 0.9)
"""Middle of a red box [m], before the camera, to its left and above it."""
EDGE = 0.2
"""Length of its edges [m]."""
BOX = Shape(kind="box", size=(EDGE / 2,) * 3, at=TARGET, surface="wall", rgba=(1.0, 0.0, 0.0, 1.0))
PIXELS = 2.5
"""Tolerance of a place in a picture [pixels]: JPEG blurs colours over two."""


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A folder with a recording, as protobuf and as a bag of ROS 2, with a picture every 0.4 s."""
    folder = tmp_path_factory.mktemp("pictures")
    world = DynamicWorld(replace(ROOM, shapes=(*ROOM.shapes[:4], BOX), loose=()), max_robots=1, seed=5)
    file = record_worlds([world], folder / "m.mcap")
    world.spawn_at(WATCHER, "R1", [((-1.5, 0.0, 0.3), (0.0, 0.0, 0.0))])
    for _ in range(60):
        world.step()
    file.close()
    for words in (
        ["view", "m.mcap", "--protobuf", "p.mcap", "--pictures", "0.4"],
        ["export", "m.mcap", "--out", "m.rosbag2", "--pictures", "0.4"],
    ):
        words = [str(folder / word) if word.endswith(("mcap", "rosbag2")) else word for word in words]
        result = CliRunner().invoke(app, words)
        assert result.exit_code == 0, result.output
    return folder


@pytest.fixture(scope="module")
def protobuf(exported):
    """Decoded messages by topic, each with its time [s]."""
    found = {}
    with (exported / "p.mcap").open("rb") as file:
        for _, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time * 1e-9, decoded))
    return found


@pytest.fixture(scope="module")
def bag(exported):
    store, found = get_typestore(Stores.ROS2_KILTED), {}
    with Reader(exported / "m.rosbag2") as reader:
        for connection, stamp, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp * 1e-9, message))
    return found


def test_a_map_has_the_walls_and_the_floor_between_them(protobuf, bag):
    ((_, grid),), ((_, theirs),) = protobuf["/map"], bag["/map"]
    rows = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.column_count)
    cell, low = grid.cell_size.x, (grid.pose.position.x, grid.pose.position.y)
    assert (grid.row_stride, grid.cell_stride, grid.frame_id) == (grid.column_count, 1, "world")
    assert [(field.name, field.type) for field in grid.fields] == [("occupancy", 1)]

    def value(x, y):
        return rows[int((y - low[1]) / cell), int((x - low[0]) / cell)]

    assert value(SIDE, 1.0) == value(-SIDE, 0.0) == value(0.5, SIDE) == 100
    assert value(-1.5, 0.0) == value(1.0, -2.0) == 0
    assert value(*TARGET[:2]) == 0, "the box hangs above 0.6 m"
    # A wall of 6 m and 0.1 m, and 0.05 m wider and longer: two cells to three.
    side = int((SIDE - low[0]) / cell)
    assert 2 <= (rows[len(rows) // 2, side - 4 : side + 4] == 100).sum() <= 4
    assert (theirs.info.width, theirs.info.height) == rows.shape[::-1]
    np.testing.assert_array_equal(theirs.data.reshape(rows.shape), rows)
    at = theirs.info.origin.position
    assert (at.x, at.y, theirs.info.resolution) == pytest.approx((*low, cell))


def test_pictures_show_what_is_before_the_camera(protobuf):
    """A red box is where a pinhole of the camera's field of view has it."""
    pictures = protobuf["/camera/R1_Eye"]
    poses = {
        time: one
        for time, message in protobuf["/tf"]
        for one in message.transforms
        if one.child_frame_id == "R1/Eye_optical"
    }
    assert len(pictures) == 3
    assert np.diff([time for time, _ in pictures]) == pytest.approx(0.4, abs=1e-6)
    for time, picture in pictures:
        assert (picture.format, picture.frame_id) == ("jpeg", "R1/Eye_optical")
        rgb = np.asarray(Image.open(io.BytesIO(picture.data)).convert("RGB")).astype(int)
        assert rgb.shape[1::-1] == SIZE
        red = (rgb[..., 0] > 2 * rgb[..., 1]) & (rgb[..., 0] > 2 * rgb[..., 2])
        rows, columns = np.nonzero(red)
        place = poses[time]
        turn, at = place.rotation, place.translation
        assert (turn.x, turn.y, turn.z, turn.w) == pytest.approx((-0.5, 0.5, -0.5, 0.5), abs=0.02), "level"
        right, down, ahead = _local(turn, np.subtract(TARGET, (at.x, at.y, at.z)))
        near = ahead - EDGE / 2  # its front face, of which the outline is that of the box from here
        focal = SIZE[0] / 2 / math.tan(FOV / 2)
        assert right < 0
        assert down < 0
        assert columns.min() == pytest.approx(SIZE[0] / 2 + focal * (right - EDGE / 2) / near, abs=PIXELS)
        assert rows.min() == pytest.approx(SIZE[1] / 2 + focal * (down - EDGE / 2) / near, abs=PIXELS)


def _local(turn, vector):
    """Return a vector (3,) of the world in the axes of a quaternion's frame."""
    w, axis = turn.w, np.array([turn.x, turn.y, turn.z])
    return vector - 2 * w * np.cross(axis, vector) + 2 * np.cross(axis, np.cross(axis, vector))


def test_bags_have_the_same_pictures(protobuf, bag, exported):
    theirs = bag["/R1/Eye/compressed"]
    for (time, one), (stamp, other) in zip(protobuf["/camera/R1_Eye"], theirs, strict=True):
        assert stamp == pytest.approx(time, abs=1e-6)
        assert (other.format, other.header.frame_id) == ("jpeg", "R1/Eye_optical")
        assert other.data.tobytes() == one.data
    lenses = bag["/R1/Eye/camera_info"]
    assert [stamp for stamp, _ in lenses] == [stamp for stamp, _ in theirs]
    lens = lenses[0][1]
    assert (lens.width, lens.height, lens.header.frame_id) == (*SIZE, "R1/Eye_optical")
    assert lens.k[0] == lens.k[4] == pytest.approx(SIZE[0] / 2 / math.tan(FOV / 2))
    frames = {one.child_frame_id for _, message in bag["/tf"] for one in message.transforms}
    assert "R1/Eye_optical" in frames
    third = [
        bytes(message.ros_msg.data)
        for message in read_ros2_messages(exported / "m.rosbag2" / "m_0.mcap", ["/R1/Eye/compressed"])
    ]
    assert third == [other.data.tobytes() for _, other in theirs]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["view", "m.mcap", "--pictures", "1"], "--pictures needs --protobuf FILE"),
        (["export", "m.mcap", "--out", "x.csv", "--pictures", "1"], "--pictures needs a file that ends in"),
        (["view", "m.mcap", "--protobuf", "q.mcap", "--pictures", "0"], "pictures every 0 s; expected 0.02"),
    ],
)
def test_pictures_that_cannot_be_are_refused(exported, monkeypatch, words, says):
    monkeypatch.chdir(exported)
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert says in " ".join(result.output.split())
    assert not (exported / "q.mcap").exists()
