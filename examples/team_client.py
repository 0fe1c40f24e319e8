"""Drive a team that chooses goals over TCP, as a controller of USARSim's robots, with a policy or a planner.

    usarmjx play --baseline explore-v3 --split validation --serve --port 3000 &
    python examples/team_client.py explore-v3 --policy packaged --port 3000

Each robot has a connection of its own. Its map comes from its INS and its scanner, and from messages of the
others, which go through the wireless server: `GETSS` says which robots hear each other, and a link is opened
to each of these. The base is a robot too, which merges maps and stays where it is. `--policy` is packaged, a
file of `usarmjx export`, or a planner: baseline, frontier, courier, assignment, rendezvous.
"""

import argparse
import itertools
import struct
import sys
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx import UsageError
from usarmjx.client import RadioError, RadioLink, ServerMessage, UsarsimClient, WirelessA
from usarmjx.train import BASELINES, POLICIES, NumpyPolicy, make_task
from usarmjx.train.tasks import GoalTeam, Report, TeamMind

FREE = 1  # a square of a map that is known to be free

BASE, MEMBER = "ComStation", "P2AT"
PATIENCE = 300.0  # s: an answer takes no longer; the first ones of a server wait for compilations
STEP = 0.2  # s between two actions

HEAD = struct.Struct("<If")
"""Size of a message in bytes, and the time of its sending [s]; the contents follow."""

Chooser = Callable[[np.ndarray], np.ndarray]
"""From observations (robots, n) to choices (robots, goals)."""


class Post:
    """Messages between the robots, over links of the wireless server: size, time of sending, contents.

    Args:
        radio: The server.
        names: The robots, the base first; their controllers are registered here.
        mind: The team, which knows the bytes of its messages.
        cutoff: Power below which there is no link [dBm].
    """

    def __init__(self, radio: WirelessA, names: Sequence[str], mind: TeamMind, cutoff: float) -> None:
        self.radio, self.names, self.mind, self.cutoff = radio, list(names), mind, cutoff
        self.links: dict[tuple[int, int], RadioLink] = {}  # of the first to the second: the first one's end
        self.rest: dict[tuple[int, int], bytes] = {}
        for name in names:
            radio.register(name)

    def powers(self) -> np.ndarray:
        """Return the power that robots receive from each other [dBm], and open and close links."""
        robots = len(self.names)
        power = np.full((robots, robots), -np.inf, np.float32)
        for i, j in itertools.combinations(range(robots), 2):
            power[i, j] = power[j, i] = self.radio.strength(self.names[i], self.names[j])
            if power[i, j] < self.cutoff:
                self.close(i, j)
            elif (i, j) not in self.links:
                self.open(i, j)
        return power

    def open(self, i: int, j: int) -> None:
        """Try to link two robots."""
        one, other = self.names[i], self.names[j]
        try:
            with self.radio.listen(other) as door:
                self.links[i, j] = self.radio.connect(one, other, door.port)
                self.links[j, i] = door.accept(PATIENCE)
        except RadioError:
            self.close(i, j)

    def close(self, i: int, j: int) -> None:
        """Close both ends; half a message is lost."""
        for pair in ((i, j), (j, i)):
            self.rest.pop(pair, None)
            if (link := self.links.pop(pair, None)) is not None:
                link.close()

    def send(self, seconds: float, letters: np.ndarray, receivers: np.ndarray) -> None:
        """Send each robot's message (robots, numbers) over its links to receivers (robots, robots)."""
        for (i, j), link in list(self.links.items()):
            if not receivers[i, j]:
                continue
            data = self.mind.encoded(letters[i])
            try:
                link.send(HEAD.pack(len(data), seconds) + data)
            except ConnectionError:
                self.close(i, j)

    def received(self) -> list[tuple[int, int, float, np.ndarray]]:
        """Return receiver, sender, time of sending and contents of the messages that have come."""
        letters = list[tuple[int, int, float, np.ndarray]]()
        for (i, j), link in list(self.links.items()):
            if (i, j) not in self.links:
                continue  # closed with its other end
            data = self.rest.get((i, j), b"")
            while piece := link.receive(0.0):
                data += piece
            try:
                whole, self.rest[i, j] = self.unpacked(data)
            except ValueError as error:
                print(f"team_client: {self.names[j]} sends {error}: its link is closed", file=sys.stderr)
                whole, piece = [], b""
            letters += [(i, j, seconds, letter) for seconds, letter in whole]
            if piece == b"":
                self.close(i, j)
        return letters

    def unpacked(self, data: bytes) -> tuple[list[tuple[float, np.ndarray]], bytes]:
        """Return times and contents of the whole messages in some bytes, and the rest of the bytes.

        Raises:
            ValueError: They are no messages of this team.
        """
        letters, most = list[tuple[float, np.ndarray]](), 8 * self.mind.letter_size
        while len(data) >= HEAD.size:
            size, seconds = HEAD.unpack_from(data)
            if size > most:
                raise ValueError(f"a message of {size} bytes, expected at most {most}")
            if len(data) < HEAD.size + size:
                break
            letters.append((seconds, self.mind.decoded(data[HEAD.size : HEAD.size + size])))
            data = data[HEAD.size + size :]
        return letters, data


class Body:
    """One robot: its connection and last readings.

    Args:
        robot: The connection.
        kind: Its class.
        name: Its name, which is one of the served task's robots.
    """

    def __init__(self, robot: UsarsimClient, kind: str, name: str) -> None:
        self.robot, self.name = robot, name
        self.now = -1.0
        self.pose: tuple[float, float, float] | None = None
        self.ranges: tuple[float, ...] = ()
        robot.send("INIT", ClassName=f"USARBot.{kind}", Name=name)
        robot.geo("Robot")  # once that is answered it is there

    def look(self) -> None:
        """Read what has come."""
        while (message := self.robot.receive(0.0)) is not None:
            self._take(message, -1.0, {"INS"})

    def wait(self, since: float) -> float:
        """Read until all readings are later than a time [s]; return the time of the report [s]."""
        missing = {"INS", "RangeScanner"}
        for message in self.robot:
            self._take(message, since, missing)
            if not missing:
                return self.now
        raise ConnectionError(f"{self.name} does not report")

    def _take(self, message: ServerMessage, since: float, missing: set[str]) -> None:
        if message.kind == "STA":
            self.now = message.time() or self.now
        kind = message.value("Type") if message.kind == "SEN" else ""
        if kind in missing and self.now > since:
            missing.discard(kind)
            if kind == "INS":
                x, y, yaw = message.pose()
                self.pose = x, -y, -yaw  # the task's axes: y left, yaw counter-clockwise
            else:
                self.ranges = message.scan()


class TeamClient:
    """A team over TCP.

    Args:
        mind: Its beliefs.
        choose: The policy.
        ports: Of robots, and of the wireless server.
        host: Address of the server.

    Attributes:
        seconds: Time since the first report [s].
    """

    def __init__(
        self, mind: TeamMind, choose: Chooser, ports: tuple[int, int], host: str = "127.0.0.1"
    ) -> None:
        self.mind, self.choose, task = mind, choose, mind.task
        names = [f"{BASE}0", *(f"{MEMBER}{i + 1}" for i in range(task.count))]
        kinds = [BASE, *[MEMBER] * task.count]
        # The server spreads reports of classes over control steps; the first class reports right after its
        # sensors are read. For the base that does not matter.
        bodies = [
            Body(UsarsimClient(host, ports[0], PATIENCE), kind, name)
            for kind, name in zip(reversed(kinds), reversed(names), strict=True)
        ]
        self.bodies = bodies[::-1]
        assert task.radio is not None  # as tasks of this kind have one
        radio = WirelessA(host, ports[1], PATIENCE)
        self.post = Post(radio, names, self.mind, task.radio.cutoff)
        self.began, self.now, self.seconds = np.nan, -1.0, np.nan

    def act(self) -> bool:
        """Wait for the next reports, and answer them; return whether that was possible.

        Nothing is done before the base has said where it stands.
        """
        self.now = max([body.wait(self.now + STEP / 2) for body in self.bodies[1:]])
        self.bodies[0].look()
        poses = [body.pose for body in self.bodies if body.pose is not None]
        if len(poses) < len(self.bodies):
            return False
        self.began = self.now if np.isnan(self.began) else self.began
        self.seconds = self.now - self.began
        seen = self.mind.see(
            Report(
                self.seconds,
                np.array(poses),
                np.array([body.ranges for body in self.bodies[1:]]),
                self.post.powers(),
                self.post.received(),
            )
        )
        orders = self.mind.obey(seen, self.choose(seen))
        self.post.send(self.seconds, orders.letters, orders.receivers)
        for body, (left, right) in zip(self.bodies[1:], orders.wheels, strict=True):
            body.robot.drive(float(left), float(right))
        return True

    def close(self) -> None:
        """Leave the world."""
        for pair in list(self.post.links):
            self.post.close(*pair)
        for body in self.bodies:
            body.robot.close()
        self.post.radio.close()


def chooser(name: str, task_name: str, task: GoalTeam) -> Chooser:
    """Return the policy of that name for a task; see the module."""
    if name in BASELINES and name != task_name:
        planner = BASELINES.get(name)
    elif name == "baseline":
        planner = BASELINES.get(task_name)
    else:
        policy = NumpyPolicy(POLICIES.get(task_name) if name == "packaged" else name)
        group = policy.group(MEMBER)
        has = policy.groups[group]["action_size"]
        if (has, policy.vectors[group]) != (task.action_size, task.vector):
            has, wanted = (
                f"{size - vector.size} choices" + (f" and {vector.size} floats" if vector.size else "")
                for size, vector in ((has, policy.vectors[group]), (task.action_size, task.vector))
            )
            raise UsageError(f"{name} has {has}, but --actions {task.actions} has {wanted}")
        return lambda seen: policy.act(group, seen, policy.initial_carry(group, len(seen)))[0]
    env: Any = SimpleNamespace(name=task_name, task=task)
    act, key = jax.jit(planner(env).act), jax.random.key(0)
    return lambda seen: np.asarray(act((), (jnp.asarray(seen),), key)[1][0])


def corners(text: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the site of `x0,y0,x1,y1`."""
    x0, y0, x1, y1 = (float(number) for number in text.split(","))
    return (x0, x1), (y0, y1)


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Drive a team that chooses goals over TCP.")
    parser.add_argument("task", help="explore-v3 or relay-chain-v3")
    parser.add_argument("--policy", default="packaged", help="packaged, a file, or a planner")
    parser.add_argument("--count", type=int, default=4, help="robots")
    parser.add_argument("--actions", default="goals", help="goals, or goals+message: as the policy chooses")
    parser.add_argument("--byte-rate", type=float, help="bytes a second that a robot may send")
    parser.add_argument("--message-floats", type=int, default=0, help="numbers of a vector in a message")
    parser.add_argument(
        "--site", type=corners, default="0,0,38.4,28.8", help="x0,y0,x1,y1, y to the left [m]"
    )
    parser.add_argument("--seconds", type=float, default=160.0, help="simulated time")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=3000)
    parser.add_argument("--wss-port", type=int, default=5874)
    options = parser.parse_args()
    try:
        own = {name: getattr(options, name) for name in ("count", "actions", "byte_rate", "message_floats")}
        task = make_task(options.task, **own)
        if not isinstance(task, GoalTeam):
            raise UsageError(f"robots of {options.task} choose no goals")
        choose, ports = chooser(options.policy, options.task, task), (options.port, options.wss_port)
        team = TeamClient(TeamMind(task, options.site), choose, ports, options.host)
    except (OSError, UsageError) as error:
        print(f"team_client: {error}", file=sys.stderr)
        return 1
    try:
        while not team.seconds >= options.seconds:
            team.act()
    finally:
        team.close()
    free = int((team.mind.squares[0] == FREE).sum())
    print(f"the base knows {free} free squares after {team.seconds:.1f} simulated s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
