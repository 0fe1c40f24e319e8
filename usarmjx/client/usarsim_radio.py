"""The radio (manual 3.2.4), by the standard library and the file `usarsim_client.py` beside this one.

A robot's messages to other robots go through the wireless server, which passes only those that a radio would
carry. It has two dialects; in both, a robot waits at a listening port, its door, for others to call.
"""

from __future__ import annotations  # for older Pythons than usarmjx needs

import select
import socket

try:
    from usarmjx.client.usarsim_client import (
        AUTH,
        ClientSocket,
        ServerMessage,
        connect,
        format_line,
        parse_line,
    )
except ImportError:  # without usarmjx: copies of both files lie in one folder
    from usarsim_client import AUTH, ClientSocket, ServerMessage, connect, format_line, parse_line


class RadioError(ConnectionError):
    """A request failed at the wireless server; the text is its reason."""


class RadioLink(ClientSocket):
    """A connection to another robot: bytes either way, until the signal or the other robot is lost.

    Args:
        connection: The socket.
        framed: Whether sent bytes are wrapped into SEND (dialect A); received ones are bare in both dialects.
    """

    def __init__(self, connection: socket.socket, framed: bool) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket, self._framed = connection, framed

    def send(self, data: bytes) -> None:
        """Send bytes. Without a signal they are lost silently; then the link closes."""
        # The semicolon ends a message of dialect A but is not counted in its length.
        self._socket.sendall(b"SEND %d %b;" % (len(data), data) if self._framed else data)

    def receive(self, timeout: float) -> bytes | None:
        """Return the received bytes, b"" if the link is closed, or None if nothing comes in time [s]."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return None
        try:
            return self._socket.recv(65536)
        # A lost signal may reset the connection: to the caller an end like any other.
        except ConnectionError:
            return b""

    def peer_port(self) -> int:
        """Return the wireless server's port of this link, by which dialect B identifies callers."""
        return self._socket.getpeername()[1]


class RadioDoor(ClientSocket):
    """A port at which a robot waits for links."""

    def __init__(self, framed: bool, port: int = 0, host: str = "127.0.0.1") -> None:
        self._socket, self._framed = socket.create_server((host, port)), framed
        self.port = self._socket.getsockname()[1]

    def accept(self, timeout: float) -> RadioLink:
        """Return the next link; raises TimeoutError when none comes in time [s]."""
        self._socket.settimeout(timeout)
        connection, _ = self._socket.accept()
        connection.settimeout(None)
        return RadioLink(connection, self._framed)


class _Control(ClientSocket):
    """A control connection: requests, and answers that end in `end`; `auth` is the line with the token."""

    end, auth = b"", AUTH

    def __init__(self, host: str, port: int, timeout: float, token: str | None) -> None:
        self.host, self.timeout = host, timeout
        self._socket = connect(host, port, timeout, token, self.auth)
        # This end of the connection to the server: the address at which the server can reach the door.
        self.address = self._socket.getsockname()[0]
        self._bytes = b""

    def ask(self, text: str) -> str:
        """Send a request and return the answer, both without their ends."""
        self._socket.sendall(text.encode("latin-1") + self.end)
        # An answer may come in pieces, or together with the next one.
        while self.end not in self._bytes:
            data = self._socket.recv(4096)
            if not data:
                raise ConnectionError("the wireless server has closed the connection")
            self._bytes += data
        answer, _, self._bytes = self._bytes.partition(self.end)
        return answer.decode("latin-1")


class WirelessA(_Control):
    """The manual's wireless server (manual 3.2.4.3).

        with WirelessA() as radio:          with WirelessA() as radio:
            radio.register("R1")                radio.register("R2")
            door = radio.listen("R1", 4001)     link = radio.connect("R2", "R1", 4001)
            link = door.accept(10.0)            link.send(b"hello")
            link.receive(10.0)

    Every method raises RadioError when the server refuses, without a signal for instance.
    """

    end, auth = b";", "AUTH %s;"

    def __init__(
        self, host: str = "127.0.0.1", port: int = 5874, timeout: float = 10.0, token: str | None = None
    ) -> None:
        super().__init__(host, port, timeout, token)

    def order(self, text: str) -> str:
        """Send a message; return the text after the OK."""
        answer = self.ask(text)
        if not answer.startswith("OK"):
            raise RadioError(answer.removeprefix("Fail: "))
        return answer[2:].lstrip(":")

    def register(self, robot: str) -> None:
        """Register the controller of a robot at this machine's address."""
        self.order(f"REGISTER {robot} {self.address}")

    def listen(self, robot: str, port: int = 0) -> RadioDoor:
        """Open a door for one link to a robot."""
        door = RadioDoor(True, port, self.address)
        self.listen_again(robot, door)
        return door

    def listen_again(self, robot: str, door: RadioDoor) -> None:
        """Accept another link at a door: the last one has used up its LISTEN."""
        self.order(f"LISTEN {robot} {door.port}")

    def connect(self, robot: str, other: str, port: int) -> RadioLink:
        """Link a robot to another one that listens on a port."""
        # The server calls back: its link comes to a door of this robot's own, needed for one call only.
        with RadioDoor(True, host=self.address) as door:
            self.order(f"OPEN {robot} {door.port} {other} {port}")
            return door.accept(self.timeout)

    def strength(self, one: str, other: str) -> float:
        """Return the power received between two robots [dBm]."""
        return float(self.order(f"GETSS {one} {other}"))


class WirelessB(_Control):
    """The later stand-alone wireless server: one control connection per robot, which keeps it registered.

        with WirelessB("R1") as radio:      with WirelessB("R2") as radio:
            link = radio.door.accept(10.0)      link = radio.connect("R1")
            radio.caller(link)  # R2            link.send(b"hello")

    Attributes:
        door: Listening port that others call.
    """

    end = b"\r\n"

    def __init__(
        self,
        robot: str,
        host: str = "127.0.0.1",
        port: int = 50000,
        timeout: float = 10.0,
        token: str | None = None,
    ) -> None:
        super().__init__(host, port, timeout, token)
        self.door = RadioDoor(False, host=self.address)
        try:
            self.order("INIT", Robot=robot, Port=self.door.port)
        except OSError:
            self.close()
            raise

    def order(self, kind: str, **segments: object) -> ServerMessage:
        """Send a message; return the answer."""
        answer = parse_line(self.ask(format_line(kind, segments)))
        error = answer.value("Reason") if answer.kind == "ERROR" else answer.value("Error")
        if error:
            raise RadioError(error)
        return answer

    def connect(self, other: str, port: int = 0) -> RadioLink:
        """Call another robot; raises ConnectionRefusedError when there is no signal."""
        answer = self.order("DNS", Robot=other, **({"Port": port} if port else {}))
        number = int(answer.value("Port"))
        return RadioLink(socket.create_connection((self.host, number), self.timeout), False)

    def caller(self, link: RadioLink) -> str:
        """Return the robot that made a link at the door."""
        return self.order("REVERSEDNS", Port=link.peer_port()).value("Robot")

    def strength(self, other: str) -> float:
        """Return the power received from another robot [dBm]."""
        return float(self.order("GETSS", Robot=other).value("Strength"))

    def close(self) -> None:
        """Leave the wireless server: no robot can call any more."""
        super().close()
        self.door.close()
