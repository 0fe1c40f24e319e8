"""Somebody at the page without a browser: a websocket that speaks viser's messages."""

import contextlib
import threading
import time
from dataclasses import asdict

import msgspec.msgpack
import viser
import zstandard
from viser import _messages
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

PATIENCE = 20.0
"""A test waits no longer for something to happen [s]."""


class Visitor:
    """Somebody who looks: says where its camera is, and hears what is drawn.

    Args:
        port: The page's.
        aspect: Width of the window over its height.
        path: What comes after the port in the address.

    Attributes:
        heard: All messages so far, as mappings.
    """

    def __init__(self, port, aspect=1.6, path=""):
        protocol = f"viser-v{viser.__version__}"
        self._socket = connect(f"ws://127.0.0.1:{port}{path}", subprotocols=[protocol], max_size=None)
        self.heard = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.look((0.0, 0.0, 5.0), aspect)

    def look(self, position, aspect):
        """Say where its camera is, and how wide its window."""
        self.say(
            _messages.ViewerCameraMessage(
                wxyz=(1.0, 0.0, 0.0, 0.0),
                position=tuple(float(x) for x in position),
                fov=0.9,
                near=0.1,
                far=100.0,
                image_height=500,
                image_width=round(500 * aspect),
                look_at=(0.0, 0.0, 0.0),
                up_direction=(0.0, 0.0, 1.0),
            )
        )

    def say(self, message):
        """Send a message of viser's."""
        self._socket.send(msgspec.msgpack.encode({"type": type(message).__name__, **asdict(message)}))

    def click(self, start, ray, modifier=None):
        """Click where a ray goes."""
        self.say(
            _messages.ScenePointerMessage(
                event_type="click",
                ray_origin=start,
                ray_direction=ray,
                screen_pos=((0.5, 0.5),),
                modifier=modifier,
            )
        )

    def press(self, label):
        """Press the key, or choose the command, of a label."""
        (uuid,) = {m["uuid"] for m in self.of("RegisterCommandMessage") if m["props"]["label"] == label}
        self.say(_messages.CommandTriggerMessage(uuid=uuid))

    def set(self, label, value):
        """Give an element of the page with a label another value."""
        found = [m for m in list(self.heard) if m["type"].startswith("Gui") and "props" in m]
        (uuid,) = {m["uuid"] for m in found if m["props"].get("label") == label}
        self.say(_messages.GuiUpdateMessage(uuid=uuid, updates={"value": value}))

    def of(self, kind):
        """All messages of a type so far."""
        return [message for message in list(self.heard) if message["type"] == kind]

    def leave(self):
        """Close the page."""
        self._socket.close()
        self._reader.join()

    def _read(self):
        with contextlib.suppress(ConnectionClosed):
            for data in self._socket:
                size = int.from_bytes(data[8:16], "little")
                inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + size])
                self.heard += msgspec.msgpack.decode(inner)["messages"]


@contextlib.contextmanager
def visiting(port, **how):
    """A visitor who leaves in the end."""
    visitor = Visitor(port, **how)
    try:
        yield visitor
    finally:
        visitor.leave()


def until(page, happened):
    """Bring a page up to date until something has happened."""
    end = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < end, "it has not happened"
        page.update()
        time.sleep(0.01)
