"""A served world on a real socket, and a client to talk to it."""

import asyncio
import contextlib
import re
import socket
import struct
import threading
import time

from tests.server.lockstep import LOCKSTEP, lockstep
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.loop_meter import run_metered
from usarmjx.server.protocol import commands as wire
from usarmjx.server.runtime.loop import ServerLoop

PATIENCE = 60.0  # s: how long to wait for what takes well under a second on an idle machine
STA_TIME = re.compile(rb"STA \{Type GroundVehicle\} \{Time ([\d.]+)\}")


class Peer:
    """A client: a socket and the lines that came out of it."""

    def __init__(self, port, text="", room=None):
        self.socket = socket.socket()
        self.socket.settimeout(PATIENCE)
        if room:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, room)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._rest = b""
        self.times = []
        """Simulated times of all status lines so far."""
        if text:
            self.say(text)

    def say(self, text):
        self.socket.sendall(text.encode() + b"\r\n")

    def line(self):
        """The next line; b"" when the server has closed the connection."""
        while b"\r\n" not in self._rest:
            try:
                data = self.socket.recv(65536)
            except ConnectionError:
                data = b""
            if not data:
                return b""
            self._rest += data
        line, self._rest = self._rest.split(b"\r\n", 1)
        if status := STA_TIME.match(line):
            self.times.append(float(status[1]))
        return line

    def until(self, *starts):
        """The next line that starts so."""
        while line := self.line():
            if line.startswith(starts):
                return line
        raise AssertionError("the server hung up")

    def ahead(self):
        """What the sonar F4, which looks ahead, hears next [m]."""
        while not (heard := re.match(rb"SEN .*{Type Sonar}.*{Name F4 Range ([\d.]+)}", self.until(b"SEN"))):
            pass
        return float(heard[1])

    def sta_times(self, count):
        """Simulated times of the next status lines."""
        for _ in range(count):
            self.until(b"STA")
        return self.times[-count:]

    def close(self):
        self.socket.close()

    def reset(self):
        """Break the connection off instead of closing it."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.socket.close()


def wait_until(happens, what="it"):
    """Wait until something is true; fail, saying what, if it does not come."""
    deadline = time.monotonic() + PATIENCE
    while not happens():
        assert time.monotonic() < deadline, f"waited {PATIENCE} s for {what}"
        time.sleep(0.005)


def say(client, line):
    """Let an adapter's client send a line, without a socket; return the lines that it receives at once."""
    for command in client.session.receive_data(line.encode() + b"\r\n"):
        if isinstance(command, wire.Init):
            spec = client.robot_class(command)
            client.session.answer_init(spec is not None and client.spawn(command, spec))
            client.session.data_to_send()
        else:
            client.handle(command)
    return client.session.data_to_send().decode().split("\r\n")[:-1]


@contextlib.contextmanager
def serving(world, services=(), realtime_factor=LOCKSTEP, **settings):
    """A running server's (port, BotServer)."""
    server = BotServer(world, BotServerSettings(port=0, **settings), services)
    with looping([server], realtime_factor):
        yield server.port, server


@contextlib.contextmanager
def looping(servers, realtime_factor=LOCKSTEP):
    """Run servers in a thread; they step while the test waits, or at a real-time factor."""
    started, box = threading.Event(), {}

    async def main(clock):
        box["loop"], box["all"] = asyncio.get_running_loop(), ServerLoop(servers, clock)
        task = asyncio.create_task(box["all"].run())
        while not box["all"].listening and not task.done():
            await asyncio.sleep(0.01)
        started.set()
        await task

    with lockstep() if realtime_factor == LOCKSTEP else contextlib.nullcontext(realtime_factor) as clock:
        thread = threading.Thread(target=lambda: run_metered(main(clock)), daemon=True)
        thread.start()
        assert started.wait(PATIENCE)
        try:
            yield
        finally:
            box["loop"].call_soon_threadsafe(box["all"].stop)
            thread.join(PATIENCE)
            assert not thread.is_alive()
