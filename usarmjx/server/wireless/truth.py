r"""True poses for anybody who asks, as the later versions' USARTruth has them at port 3989.

A line, ended by "\r\n", and its answer, a line for each robot or loose object and one for the end:

    {class P3AT} {name R1}    {Name R1} {Class P3AT} {Time 29.9739} {Location 0.67,2.30,1.86} {Rotation 0.00,0.00,1.57}
                              {End}

Without a class all robots are meant, the class WCObject means the loose objects; without a name all of them.
Positions are in the wire's axes [m], angles are roll, pitch and yaw [rad] (USARTruthConnection.uc).
"""  # noqa: E501 - an answer is one line

from collections.abc import Iterator
from typing import NamedTuple

from usarmjx.base.backend import Array
from usarmjx.base.errors import PeerError
from usarmjx.server.protocol.dialects import LATER_CLASSES
from usarmjx.server.protocol.grammar import (
    LineBuffer,
    Message,
    format_message,
    four_decimals,
    parse_message,
    two_decimals_list,
)
from usarmjx.server.worlds.robot import wire_pose
from usarmjx.server.worlds.served_world import ServedWorld

MAX_LINE_SIZE = 1024
"""Longest line accepted [bytes]."""
LOOSE_CLASS = "WCObject"
"""Class of loose objects: what the later versions' world controller makes."""
_LATER_NAMES = {ours: name.upper() for name, ours in LATER_CLASSES.items()}
_END = "{End}\r\n"


class TruePose(NamedTuple):
    """A robot or a loose object.

    Attributes:
        name: Its name.
        kind: Its class.
        pos: Position in our axes [m] (3,).
        quat: Orientation, w first (4,).
    """

    name: str
    kind: str
    pos: Array
    quat: Array


def true_poses(world: ServedWorld) -> Iterator[TruePose]:
    """Yield the poses of all robots, in the order of their slots, then of the loose objects."""
    for _, robot in sorted(world.present.items()):
        state = world.state(robot)
        kind = _LATER_NAMES.get(robot.spec.name, robot.spec.name)
        yield TruePose(robot.name, kind, state.pos, state.quat)
    loose = world.scene.arena.loose
    if loose:
        for thing, row in zip(loose, world.loose_poses(), strict=True):
            yield TruePose(thing.name, LOOSE_CLASS, row[:3], row[3:])


def pose_segments(pos: Array, quat: Array) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return Location and Rotation of a pose in our axes."""
    location, rotation = wire_pose(pos, quat)
    return ("Location", two_decimals_list(location)), ("Rotation", two_decimals_list(rotation))


class TruthSession:
    """One connection: lines in any chunking, answered in order.

    Args:
        world: The world.
    """

    def __init__(self, world: ServedWorld) -> None:
        self._world = world
        self._lines = LineBuffer(MAX_LINE_SIZE)

    def receive_data(self, data: bytes) -> bytes:
        """Return the answers to the lines that `data` completes.

        Raises:
            HttpRequestError: The peer speaks HTTP; hang up.
        """
        return "".join(map(self._answer, self._lines.feed(data))).encode("latin-1", "replace")

    def _answer(self, line: str) -> str:
        try:
            # The original ignores whatever stands before the first brace.
            message = parse_message("TRUTH " + line[max(line.find("{"), 0) :])
        except PeerError:
            return _END
        return "".join(f"{text}\r\n" for text in self._found(message)) + _END

    def _found(self, asked: Message) -> Iterator[str]:
        # Without its package, which clients may send in front: USARBot.P3AT.
        kind = asked.get("class").rpartition(".")[2].lower()
        kinds = {kind, LATER_CLASSES.get(kind, kind).lower()}
        name, time = asked.get("name").lower(), four_decimals(self._world.time)
        for one in true_poses(self._world):
            known = {one.kind.lower(), LATER_CLASSES.get(one.kind.lower(), one.kind).lower()}
            is_meant = bool(known & kinds) if kind else one.kind != LOOSE_CLASS
            if is_meant and name in ("", one.name.lower()):
                words = "_".join(one.name.split()) or "_"  # a space would shift the pairs behind it
                head = (("Name", words), ("Class", one.kind), ("Time", time))
                line = format_message(Message("TRUTH", (*head, *pose_segments(one.pos, one.quat))))
                yield line.removeprefix("TRUTH ")
