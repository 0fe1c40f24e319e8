"""Clients over TCP that do anything in any order: nobody else notices, and no seat is lost.

Run by `dev.py fuzz` it tries other sequences each time.
"""

import contextlib
import logging
import re
import socket
import threading
import time

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from tests.server.peers import PATIENCE, Peer, serving
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.effecters import EFFECTERS
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.base import SENSORS
from usarmjx.server.protocol.commands import DRIVE_KEYS
from usarmjx.server.protocol.grammar import format_message, parse_message
from usarmjx.server.worlds.dynamic_world import DynamicWorld

PACE = 8.0
"""Times real time."""
CLIENTS, STEPS = 5, 20
DUE, LATE = 0.2, 0.25
"""Reports come each 0.2 s of the world's time, and never later than this [s]."""
FAR = (100.0, 100.0)
"""Where the watcher stands: nobody gets there within a sequence [m]."""
MOVED = 0.02
"""How far the watcher may move while it stands [m]: it is put down 2 mm above the floor."""

NUMBERS = st.one_of(
    st.floats(-10, 10).map("{:.3f}".format),
    st.sampled_from(["1e38", "-3e38", "nan", "inf", "1e400", "", "x", "0,1", "-0"]),
)
VECTORS = st.one_of(
    st.tuples(*[st.integers(-6, 6)] * 2).map(lambda xy: f"{xy[0]},{xy[1]},0"),
    st.sampled_from(
        ["0,0,0", "0,0,-3", "0,0,50", "1e9,0,0", "nan,0,0", "999,-999,0", "0,0,-999", "3e38,1,1", "1", "x"]
    ),
)
ITEMS = sorted(
    {(m.kind, m.name) for _, robot in ROBOTS for m in (*robot.sensors, *robot.effecters, *robot.cameras)}
    | {(kind, kind) for kind, _ in (*SENSORS, *EFFECTERS)}
)
JOINTS = sorted({joint for _, robot in ROBOTS for joint in joint_names(robot)})
PACKAGES = sorted({package.name for _, robot in ROBOTS for package in robot.packages})
OPCODES = ("Scan", "Reset", "Pose", "Read", "Write", "Zoom", "Angle", "Torque", "Release", "Open", "Animate")
ORDERS = st.sampled_from([0, 1, 2, 3, 10, 11, 12, 7])
KEYS = st.sampled_from(
    [*DRIVE_KEYS, "Light", "Flip", "Normalized", "WheelNumber", "WheelSpeed", "WheelSteer"]
)
PAIRS = st.tuples(KEYS, st.one_of(NUMBERS, st.sampled_from(["True", "False"])))


@st.composite
def lines(draw):
    """Something to say to a robot."""
    kind = draw(st.sampled_from(["drive", "joint", "link", "set", "multi", "ask", "junk"]))
    number, order, joint = draw(NUMBERS), draw(ORDERS), draw(st.sampled_from(JOINTS))
    item = "{{Type {}}} {{Name {}}}".format(*draw(st.sampled_from(ITEMS)))
    if kind == "drive":
        return "DRIVE " + " ".join(
            f"{{{key} {value}}}" for key, value in draw(st.lists(PAIRS, min_size=1, max_size=4))
        )
    if kind == "joint":
        return f"DRIVE {{Name {joint}}} {{Order {order}}} {{Value {number}}} {{Steer {draw(NUMBERS)}}}"
    if kind == "link":
        name, links = draw(st.sampled_from(PACKAGES)), draw(st.lists(st.integers(-1, 7), max_size=4))
        return f"MISPKG {{Name {name}}} " + " ".join(
            f"{{Link {n}}} {{Value {number}}} {{Order {order}}}" for n in links
        )
    if kind == "set":
        opcode = draw(st.sampled_from(OPCODES))
        return f"SET {item} {{Opcode {opcode}}} {{Params {','.join(draw(st.lists(NUMBERS, max_size=6)))}}}"
    if kind == "multi":
        return f"MULTIDRIVE {{{joint} {number}}}"
    if kind == "ask":
        return draw(st.sampled_from(["GETGEO ", "GETCONF "])) + item
    return draw(st.text(st.characters(max_codepoint=255, exclude_characters="\r\n"), max_size=30))


class Guarded(DynamicWorld):
    """A world that notes when a join or a leave moves somebody else by a bit."""

    def __init__(self, arena):
        super().__init__(arena, seed=1, max_robots=CLIENTS + 1)
        self.moved, self.strayed = [], 0.0

    def step(self):
        super().step()
        if 0 in self.robots:  # the watcher's
            self.strayed = max(self.strayed, np.linalg.norm(self.state(self.robots[0]).pos[:2] - FAR))

    def _poses(self):
        """Coordinates and velocities of each robot, by slot, as bytes."""
        data, found = self._single.engine.data, {}
        for group in self.scene.groups:
            addresses = group.root_qposadr, group.qposadr, group.root_dofadr, group.dofadr
            for slot, *here in zip(group.slots, *addresses, strict=True):
                parts = data.qpos[here[0]], data.qpos[here[1]], data.qvel[here[2]], data.qvel[here[3]]
                found[int(slot)] = b"".join(part.tobytes() for part in parts)
        return found

    @contextlib.contextmanager
    def _watching(self):
        before = self._poses()
        try:
            yield
        finally:
            after = self._poses()
            self.moved += [slot for slot in before.keys() & after.keys() if before[slot] != after[slot]]

    def spawn_at(self, robot, name, poses):
        with self._watching():
            return super().spawn_at(robot, name, poses)

    def remove(self, robot):
        with self._watching():
            super().remove(robot)


class Talker(Peer):
    """A client that reads all the time, in a thread, and checks what it reads."""

    def __init__(self, port):
        super().__init__(port)
        self.problems, self.kinds = [], []
        self.news = threading.Condition()
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        with contextlib.suppress(OSError):
            while data := self.line():
                line = data.decode("latin-1")
                try:
                    if format_message(parse_message(line)) != line or re.search(r"[ ,](nan|inf)\b", line):
                        self.problems.append(line)
                except Exception as error:
                    self.problems.append(f"{error}: {line}")
                with self.news:
                    self.kinds.append("POSES" if line.startswith("NFO {StartPoses") else line.split(" ")[0])
                    self.news.notify_all()

    def wait(self, done):
        with self.news:
            assert self.news.wait_for(done, PATIENCE)

    def has_robot(self):
        """Whether it is told about its robot; by then all that it has said is done."""
        with self.news:
            first = len(self.kinds)
        self.say("GETCONF {Type Robot}\r\nGETSTARTPOSES")
        self.wait(lambda: "POSES" in self.kinds[first:])
        return "CONF" in self.kinds[first : self.kinds.index("POSES", first)]

    def leave(self, rudely=False):
        """Stop reading, and close the connection or break it off."""
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RD)  # the reader's number must not become another socket's
        self.reader.join(PATIENCE)
        assert not self.reader.is_alive()
        (self.reset if rudely else self.close)()


class Tracebacks(logging.Handler):
    """Keeps what was logged with an exception, or by asyncio."""

    def __init__(self):
        super().__init__()
        self.found = []

    def emit(self, record):
        if record.exc_info or (record.name == "asyncio" and record.levelno >= logging.WARNING):
            self.found.append(self.format(record))


class Wire(RuleBasedStateMachine):
    """Up to five clients beside one that stands and watches."""

    def __init__(self):
        super().__init__()
        self.clients = []
        self.closing = contextlib.ExitStack()
        self.log = Tracebacks()
        logging.getLogger().addHandler(self.log)
        self.closing.callback(logging.getLogger().removeHandler, self.log)
        self.world = Guarded(ARENAS.get("field"))
        port, _ = self.closing.enter_context(serving(self.world, realtime_factor=PACE))
        self.port = port

    @initialize()
    def watch(self):
        self.watcher = Talker(self.port)
        self.watcher.say(f"INIT {{ClassName P2AT}} {{Name Watcher}} {{Location {FAR[0]},{-FAR[1]},0}}")
        assert self.watcher.has_robot()

    def one(self, number):
        return self.clients[number % len(self.clients)]

    @precondition(lambda self: len(self.clients) < CLIENTS)
    @rule()
    def joins(self):
        self.clients.append(Talker(self.port))

    @precondition(lambda self: self.clients)
    @rule(who=st.integers(0, CLIENTS), name=st.sampled_from(ROBOTS.names()), where=VECTORS, turn=VECTORS)
    def is_placed(self, who, name, where, turn):
        self.one(who).say(f"INIT {{ClassName USARBot.{name}}} {{Location {where}}} {{Rotation {turn}}}")

    @precondition(lambda self: self.clients)
    @rule(who=st.integers(0, CLIENTS), name=st.sampled_from([*ROBOTS.names(), "Nobody", ""]))
    def takes_a_start(self, who, name):
        self.one(who).say(f"INIT {{ClassName {name}}}")

    @precondition(lambda self: self.clients)
    @rule(who=st.integers(0, CLIENTS), said=st.lists(lines(), min_size=1, max_size=5))
    def says(self, who, said):
        self.one(who).say("\r\n".join(said))

    @precondition(lambda self: self.clients)
    @rule(
        who=st.integers(0, CLIENTS), rudely=st.booleans(), last=st.sampled_from(["", "INIT {ClassName P2DX}"])
    )
    def leaves(self, who, rudely, last):
        client = self.clients.pop(who % len(self.clients))
        if last:
            client.say(last)
        client.leave(rudely)

    @rule()
    def time_passes(self):
        first = len(self.watcher.times)
        self.watcher.wait(lambda: len(self.watcher.times) >= first + 3)

    @invariant()
    def seats_are_conserved(self):
        wanted = 1 + sum(client.has_robot() for client in self.clients)
        until = time.monotonic() + PATIENCE
        while len(self.world.robots) != wanted and time.monotonic() < until:
            time.sleep(0.005)
        assert len(self.world.robots) == wanted

    @invariant()
    def nobody_else_notices(self):
        assert self.world.moved == []
        assert self.log.found == []
        for client in (self.watcher, *self.clients):
            assert client.problems == []
        gaps = np.diff(self.watcher.times)
        assert gaps.max(initial=0.0) <= DUE + LATE
        assert self.world.strayed <= MOVED

    def teardown(self):
        for client in (self.watcher, *self.clients):
            client.leave()
        self.closing.close()
        assert self.log.found == []


few = max(1, settings().max_examples // 10)
Wire.TestCase.settings = settings(max_examples=few, stateful_step_count=STEPS, deadline=None)
TestWire = Wire.TestCase
