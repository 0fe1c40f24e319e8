"""A browser at the live page, as a process of its own: takes in what is sent, and draws nothing.

Run with the page's port and the protocol's name; it answers each line on its input with how many bytes have
come so far, and ends with its input.
"""

import contextlib
import sys
import threading

import msgspec.msgpack
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol


def camera_message() -> bytes:
    """Return what a browser says first: then it counts as one that looks."""
    place = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 9.0), "look_at": (0.0, 0.0, 0.0)}
    lens = {"fov": 0.9, "near": 0.1, "far": 100.0, "image_height": 800, "image_width": 1280}
    up = {"up_direction": (0.0, 0.0, 1.0)}
    return msgspec.msgpack.encode({"type": "ViewerCameraMessage", **place, **lens, **up})


def main(port: str, protocol: str) -> None:
    """Look at the page of a port until there is no more input."""
    size = 0
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol(protocol)], max_size=None) as connection:

        def read() -> None:
            nonlocal size
            with contextlib.suppress(ConnectionClosed):
                for message in connection:
                    size += len(message)

        threading.Thread(target=read, daemon=True).start()
        for line in sys.stdin:
            if line.strip() == "hello":
                connection.send(camera_message())
            print(size, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
