"""Robots with little but cameras, an arena to look at, and an image client as the originals behave."""

import contextlib
import io
import math
import select
import socket
import struct
from dataclasses import replace

import numpy as np
from PIL import Image

from tests.server.lockstep import LOCKSTEP
from tests.server.peers import PATIENCE, Peer, serving
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.server.pictures.image_server import ImageServer, ImageSettings
from usarmjx.server.worlds.dynamic_world import DynamicWorld

MAST = -0.8
"""Cameras are so far above the chassis [m], as z points down."""


def camera(name, yaw=0.0, **fields):
    keys = {"CameraDefFov": 1.0, "CameraMinFov": 0.5, "CameraMaxFov": 2.0} | fields
    return Mount(
        kind="Camera", name=name, at=(0.0, 0.0, MAST), direction=(0.0, 0.0, yaw), options=options(**keys)
    )


def watcher(name, *cameras):
    return replace(
        P2AT,
        name=name,
        packages=(),
        sensors=tuple(mount for mount in P2AT.sensors if mount.kind == "GroundTruth"),
        cameras=cameras,
        effecters=(),
    )


CYCLOPS = watcher("Cyclops", camera("Camera"))
LOOKOUT = watcher(
    "Lookout",
    camera("Ahead"),
    camera("Right", math.pi / 2, CameraMinFov=1.0, CameraMaxFov=1.0),
    camera("Behind", math.pi),
)
"""Cameras in three directions; the second one cannot zoom."""
MOLE = watcher("Mole")

DISTANCE, SIDE = 3.0, 1.0
"""How far ahead of S0 the red target is, and how wide and high [m]; its front is flat."""
EYE = P2AT.origin_height - MAST
"""Height of the cameras [m]."""


def target(x, y, rgba, turn=0.0):
    """A square that faces the origin."""
    return Shape(
        kind="box",
        size=(0.05, SIDE / 2, SIDE / 2),
        at=(x + math.copysign(0.05, x) * (x != 0), y + math.copysign(0.05, y) * (y != 0), EYE),
        rotation=(0.0, 0.0, turn),
        surface="wall",
        rgba=rgba,
    )


GALLERY = ArenaSpec(
    name="gallery",
    extent=((-5, 5), (-5, 5)),
    starts=tuple(StartPose(tag=f"S{i}", at=(0.0, 20.0 * i, 0.188), yaw=0.0) for i in range(6)),
    shapes=(
        target(DISTANCE, 0.0, (1.0, 0.0, 0.0, 1.0)),  # ahead: red
        target(0.0, -DISTANCE, (0.0, 1.0, 0.0, 1.0), math.pi / 2),  # right: green
        target(-DISTANCE, 0.0, (0.0, 0.0, 1.0, 1.0)),  # behind: blue
    ),
)
"""Seen from S0: squares in clear colours; at the other starts there is nothing but floor and sky."""

COLORS = {"red": 0, "green": 1, "blue": 2}


def shows(picture, color):
    """How many pixels of a picture (height, width, 3) are clearly of a target's colour."""
    picture = np.asarray(picture, float)
    others = np.delete(picture, COLORS[color], 2).max(2)
    return int((picture[..., COLORS[color]] > 2 * others + 20).sum())


def gallery():
    world = DynamicWorld(GALLERY, Physics(), 1, max_robots=16)
    for robot in (CYCLOPS, LOOKOUT, MOLE):
        world.prepare(robot)
    return world


class Viewer:
    """An image client as UsarCommander and usarimage2ros read: a header, then exactly so many bytes."""

    def __init__(self, port, address="127.0.0.1", room=None, text=b""):
        self.socket = socket.socket()
        self.socket.settimeout(PATIENCE)
        self.socket.bind((address, 0))
        if room:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, room)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.sendall(text)

    @property
    def name(self):
        """Its address with its port."""
        return "{}:{}".format(*self.socket.getsockname())

    def exactly(self, count):
        data = b""
        while len(data) < count:
            piece = self.socket.recv(count - len(data))
            if not piece:
                raise ConnectionError("the image server hung up")
            data += piece
        return data

    def frame(self):
        """Type and data of the next frame."""
        number, size = struct.unpack(">BI", self.exactly(5))
        return number, self.exactly(size)

    def picture(self):
        """The next picture (height, width, 3)."""
        number, data = self.frame()
        if number:
            return np.asarray(Image.open(io.BytesIO(data)))
        width, height = struct.unpack(">HH", data[:4])
        return np.frombuffer(data[4:], np.uint8).reshape(height, width, 3)

    def acknowledge(self):
        self.socket.sendall(b"OK")

    def next(self):
        """Acknowledge the last picture and return the next."""
        self.acknowledge()
        return self.picture()

    def silent(self, seconds):
        """Whether nothing comes for so long."""
        return not select.select([self.socket], [], [], seconds)[0]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        self.socket.close()


class Show:
    """A running server with its pictures."""

    def __init__(self, world, port, service):
        self.world, self.port, self.service = world, port, service
        self._open = contextlib.ExitStack()

    def robot(self, kind, name, start="S0"):
        peer = Peer(self.port, f"INIT {{ClassName USARBot.{kind}}} {{Name {name}}} {{Start {start}}}")
        self._open.callback(peer.close)
        peer.until(b"STA")
        return peer

    def viewer(self, **how):
        return self._open.enter_context(Viewer(self.service.port, **how))

    def close(self):
        self._open.close()


@contextlib.contextmanager
def on_show(world, *, realtime_factor=LOCKSTEP, **settings):
    """A running server with its pictures, 96 x 72 and raw if nothing else is said.

    It waits for them as long as the tests do: no black ones in between.
    """
    settings = {"port": 0, "size": (96, 72), "format": 0, "fps": 50.0, "patience": PATIENCE} | settings
    service = ImageServer(world, ImageSettings(**settings))
    with serving(world, [service], realtime_factor=realtime_factor) as (port, _):
        show = Show(world, port, service)
        try:
            yield show
        finally:
            show.close()


def classes():
    """Make the robots here known by name for a while."""
    from tests.handy import known

    return known(CYCLOPS, LOOKOUT, MOLE)
