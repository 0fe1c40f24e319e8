"""A client of USARSim's ports. It needs only the standard library: this file, copied, is all of it.

    with UsarsimClient("127.0.0.1", 3000) as robot:
        robot.init("USARBot.P2AT", "R1", (4.5, 1.9, 1.8))
        robot.drive(2.0, 2.0)
        for message in robot:
            print(message.kind, message.value("Type"))

Metres, radians and seconds; x forward, y right, z down, yaw clockwise seen from above.
"""

from __future__ import annotations  # for older Pythons than usarmjx needs

import os
import re
import select
import socket
import struct
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import TracebackType
    from typing import Self

SEGMENT = re.compile(r"\{([^{}]*)\}")
AUTH = "AUTH {Token %s}\r\n"


@dataclass(frozen=True)
class ServerMessage:
    """One line from the server: SEN, STA ... and (key, value) per pair of braces; keys may repeat."""

    kind: str
    segments: tuple[tuple[str, str], ...]

    def values(self, key: str) -> list[str]:
        """Return all values of a key, in order; the key in any case."""
        return [value for name, value in self.segments if name.lower() == key.lower()]

    def value(self, key: str) -> str:
        """Return the first value of a key, "" when there is none."""
        return next(iter(self.values(key)), "")

    def time(self) -> float | None:
        """Return the simulated time [s], or None: some sensors send none."""
        text = self.value("Time")
        return float(text) if text else None

    def vector(self, key: str) -> tuple[float, ...]:
        """Return the numbers of `{Location 4.5,1.9,1.8}`, none when the key is absent."""
        return _numbers(self.value(key))

    def items(self) -> dict[str, dict[str, str]]:
        """Return name -> field -> text of a message with `{Name F1 Range 2.5} {Name F2 ...}`."""
        lists = [value.split() for value in self.values("Name")]
        # zip without `strict`, here and below: Pythons before 3.10 do not know it.
        return {words[0]: dict(zip(words[1::2], words[2::2])) for words in lists if words}  # noqa: B905

    def ranges(self) -> dict[str, float]:
        """Return name -> distance [m] of a Sonar or IR message."""
        items = self.items().items()
        return {name: float(fields["Range"]) for name, fields in items if "Range" in fields}

    def scan(self) -> tuple[float, ...]:
        """Return the distances [m] of a range scanner, from right to left."""
        return self.vector("Range")

    def pose(self) -> tuple[float, float, float]:
        """Return x, y [m] and yaw [rad] of an Odometry, INS or GroundTruth message."""
        # Odometry has `Pose x,y,yaw`; the others Location and Orientation of three numbers each.
        pose = self.vector("Pose") or (*self.vector("Location")[:2], self.vector("Orientation")[2])
        return pose[0], pose[1], pose[2]


class ClientSocket:
    """A socket that is closed by `close`, or at the end of `with`: the base of all clients."""

    _socket: socket.socket

    def __enter__(self) -> Self:
        """Return the client."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Close the connection: a robot disappears, a link ends on both sides."""
        self._socket.close()


def connect(host: str, port: int, timeout: float, token: str | None, auth: str = AUTH) -> socket.socket:
    """Return a connection; a server that requires its token hangs up on anything else before it."""
    connection = socket.create_connection((host, port), timeout)
    # Commands are small: Nagle's algorithm would hold them back until the server acknowledges the last one.
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    token = os.environ.get("USARMJX_TOKEN", "") if token is None else token
    if token:
        connection.sendall((auth % token).encode("latin-1"))
    return connection


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(number) for number in text.split(",") if number)


def parse_line(line: str) -> ServerMessage:
    """Return the message of one line, such as `SEN {Type Odometry} {Name O} {Pose 0.1,0.0,0.0}`."""
    # The value may hold spaces itself, so only the first one separates.
    pairs = (inside.strip().partition(" ") for inside in SEGMENT.findall(line))
    segments = tuple((key, value.strip()) for key, _, value in pairs)
    return ServerMessage(line.partition("{")[0].strip(), segments)


def format_line(kind: str, segments: dict[str, object]) -> str:
    """Return the line of a command; vectors become `x,y,z`."""

    def text(value: object) -> str:
        if isinstance(value, (tuple, list)):
            return ",".join(text(part) for part in cast("Sequence[object]", value))
        return f"{value:.4f}" if isinstance(value, float) else str(value)

    return " ".join([kind, *(f"{{{key} {text(value)}}}" for key, value in segments.items())])


class UsarsimClient(ClientSocket):
    """One connection, which is one robot: it leaves the world when the connection closes.

    Args:
        host: Address of the server.
        port: Its Gamebots port.
        timeout: Longest wait for a connection or an answer [s of real time]; then TimeoutError.
        token: The server's token, if it requires one; None: that of the variable USARMJX_TOKEN, if it is set.

    Attributes:
        greeting: The server's first line; its "Level" is the arena.
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = 3000, timeout: float = 10.0, token: str | None = None
    ) -> None:
        self.timeout = timeout
        self._socket = connect(host, port, timeout, token)
        self._bytes = b""
        self._messages: deque[ServerMessage] = deque()  # received, not yet handed out
        try:
            self.greeting = self._wait_for("NFO", "the server's greeting")
        # TimeoutError and ConnectionError are OSErrors: nobody could close a client that was never returned.
        except OSError:
            self.close()
            raise

    def receive(self, timeout: float) -> ServerMessage | None:
        """Return the next message, or None after `timeout` seconds of real time without one.

        Raises:
            ConnectionError: The server has closed the connection.
        """
        deadline = time.monotonic() + timeout
        while not self._messages:
            # Not a timeout of the socket, which would hold for sendall, too.
            if not select.select([self._socket], [], [], max(0.0, deadline - time.monotonic()))[0]:
                return None
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionError("the server has closed the connection")
            # The piece after the last line end is kept: a line may arrive in two parts.
            *lines, self._bytes = (self._bytes + data).split(b"\n")
            # Latin-1 reads any byte: a name in other letters must not end the connection.
            self._messages += [parse_line(line.decode("latin-1")) for line in lines if line.strip()]
        return self._messages.popleft()

    def __iter__(self) -> Iterator[ServerMessage]:
        """Yield messages until the server closes or is silent for `timeout` seconds."""
        try:
            while (message := self.receive(self.timeout)) is not None:
                yield message
        except ConnectionError:
            return

    def send(self, kind: str, **segments: object) -> None:
        """Send any command: `send("DRIVE", Name="CameraPan", Order=0, Value=0.5)`."""
        self._socket.sendall((format_line(kind, segments) + "\r\n").encode("latin-1"))

    def start_poses(self) -> list[tuple[str, tuple[float, ...], tuple[float, ...]]]:
        """Return tag, location and rotation of the arena's start poses."""
        self.send("GETSTARTPOSES")
        answer = self._wait_for("NFO", "start poses")
        # All poses stand in one pair of braces, `{tag x,y,z r,p,y tag ...}`, so its key is the first tag.
        words = " ".join(f"{key} {value}" for key, value in answer.segments[1:]).split()
        locations, rotations = ([_numbers(word) for word in words[i::3]] for i in (1, 2))
        return list(zip(words[::3], locations, rotations))  # noqa: B905

    def init(
        self,
        class_name: str,
        name: str,
        location: Sequence[float],
        rotation: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> ServerMessage:
        """Spawn the robot and return its first status.

        Args:
            class_name: Its class, such as USARBot.P2AT.
            name: Its name.
            location: Position, x y z [m] in the server's axes.
            rotation: Roll, pitch and yaw [rad] in the server's axes.

        Raises:
            TimeoutError: It does not report: servers answer nothing to a class they do not know.
        """
        self.send("INIT", ClassName=class_name, Name=name, Location=location, Rotation=rotation)
        status = self._wait_for("STA", f"a report of the new {class_name}")
        # An iterator yields the first status, too.
        self._messages.appendleft(status)
        return status

    def drive(self, left: float, right: float, normalized: bool = False) -> None:
        """Turn the left and right wheels forward [rad/s, or percent when normalized]."""
        self.send("DRIVE", Left=left, Right=right, **({"Normalized": True} if normalized else {}))

    def view(self, client: str, robot: str = "", camera: str = "") -> None:
        """Show a robot's camera to an image client (address or `CameraClient.name`); no robot unbinds it."""
        named = {"Robot": robot, "Name": camera, "Client": client}
        self.send("SET", Type="Camera", **{key: value for key, value in named.items() if value})

    def zoom(self, camera: str, fov: float) -> float:
        """Set a camera's field of view [rad], 0 for its default, and return the new one."""
        self.send("SET", Type="Camera", Name=camera, FOV=fov)
        answer = self._wait_for("RES", "an answer to SET")
        # The answer names all cameras, in pairs of Name and FOV.
        fovs = dict(zip(answer.values("Name"), answer.values("FOV")))  # noqa: B905
        return float(fovs[camera])

    def multidrive(self, joints: dict[str, float]) -> None:
        """Move joints, by name, to absolute positions [rad], all at the same time."""
        self.send("MULTIDRIVE", **joints)

    def geo(self, type_name: str, name: str = "") -> ServerMessage:
        """Return the mounts of sensors, or the size of the robot (type Robot)."""
        return self._ask("GETGEO", type_name, name)

    def conf(self, type_name: str, name: str = "") -> ServerMessage:
        """Return the settings of sensors or of the robot."""
        return self._ask("GETCONF", type_name, name)

    def set(self, type_name: str, name: str, opcode: str, params: object = "") -> ServerMessage | None:
        """Send an order to a sensor or effecter; return its RES, None for types without one."""
        last = {"Params": params} if params != "" else {}
        self.send("SET", Type=type_name, Name=name, Opcode=opcode, **last)
        # A server moves joints without a RES: waiting for one would time out.
        return None if type_name.lower() == "joint" else self._wait_for("RES", f"a RES to {opcode}")

    def _ask(self, kind: str, type_name: str, name: str) -> ServerMessage:
        self.send(kind, Type=type_name, **({"Name": name} if name else {}))
        # GETGEO is answered by GEO, GETCONF by CONF.
        return self._wait_for(kind[3:], f"{kind} {type_name}")

    def _wait_for(self, kind: str, what: str) -> ServerMessage:
        """Return the next message of a kind; messages before it are handed out later."""
        passed: list[ServerMessage] = []
        deadline = time.monotonic() + self.timeout
        try:
            while (left := deadline - time.monotonic()) > 0:
                message = self.receive(left)
                if message is not None and message.kind == kind:
                    return message
                if message is not None:
                    passed.append(message)
        finally:
            # extendleft reverses its argument: twice reversed is the order of arrival.
            self._messages.extendleft(reversed(passed))
        raise TimeoutError(f"the server did not send {what} within {self.timeout:g} s")


# Pictures (manual 14.5.3). The image server sends one, waits for OK, and sends the next.


@dataclass(frozen=True)
class Image:
    """A picture: red, green and blue bytes of its pixels, rows from the top; or a JPEG file's bytes."""

    width: int = 0
    height: int = 0
    rgb: bytes = b""
    jpeg: bytes = b""


class CameraClient(ClientSocket):
    """A connection to the image server.

        with CameraClient() as camera:
            image = camera.picture()
            pathlib.Path("picture.jpg").write_bytes(image.jpeg)

    `view` of the robot's client selects the camera.
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = 5003, timeout: float = 60.0, token: str | None = None
    ) -> None:
        self._socket = connect(host, port, timeout, token)
        # The server sees this end as address:port, by which SET chooses among several image clients.
        self.name = "{}:{}".format(*self._socket.getsockname()[:2])
        self._first = True

    def picture(self) -> Image:
        """Return the next picture; the first one of a camera may take some seconds."""
        # The server sends the first picture unasked (manual 14.5.3).
        if not self._first:
            self._socket.sendall(b"OK")
        self._first = False
        # In network byte order: one byte of the kind, 0 raw and else JPEG, and four of the size.
        kind, size = struct.unpack(">BI", self._exactly(5))
        data = self._exactly(size)
        if kind:
            return Image(jpeg=data)
        width, height = struct.unpack(">HH", data[:4])
        return Image(width, height, data[4:])

    def _exactly(self, count: int) -> bytes:
        data = bytearray()
        while len(data) < count:
            piece = self._socket.recv(count - len(data))
            if not piece:
                raise ConnectionError("the image server has closed the connection")
            data += piece
        return bytes(data)
