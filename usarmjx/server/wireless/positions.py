r"""The position service: where the robots are and what lies between them, for a wireless server elsewhere.

A line, ended by "\r\n", and its answer:

    GETPOS                              POSITIONS {Robots 1} {Name R1 Location 4.5000,1.9000,1.8000 BatteryEmpty False}
    GETOBS {From R1} {To R2}            NUMOBS {From R1} {To R2} {ObstCount 1.00}
    GETOBS {Start 0,0,0} {End 1,0,0}    NUMOBS {Start 0,0,0} {End 1,0,0} {ObstCount 0.00}

A count of -1 means that a robot is not in the world. Positions are in the wire's axes [m]. Anything else is
not answered, as in the original.
"""  # noqa: E501 - an answer is one line

from usarmjx.base.errors import PeerError
from usarmjx.base.settings import Parameters
from usarmjx.server.protocol.arguments import read_parameters
from usarmjx.server.protocol.frames import flip_wire_vector
from usarmjx.server.protocol.grammar import (
    LineBuffer,
    Message,
    format_message,
    four_decimals_list,
    parse_message,
    two_decimals,
)
from usarmjx.server.wireless.channel import RadioAccess

MAX_LINE_SIZE = 1024
"""Longest line accepted [bytes]."""
_POSITION = Parameters(3, 3)


def positions(radio: RadioAccess) -> Message:
    """Return the answer to GETPOS."""
    robots = radio.present()
    segments = [("Robots", str(len(robots)))]
    for robot in robots:
        location = four_decimals_list(flip_wire_vector(robot.position))
        name = "_".join(robot.name.split()) or "_"  # a space would shift the pairs of its segment
        segments.append(("Name", f"{name} Location {location} BatteryEmpty {robot.battery_empty}"))
    return Message("POSITIONS", tuple(segments))


def obstacles(radio: RadioAccess, message: Message) -> Message:
    """Return the answer to GETOBS.

    Raises:
        PeerError: Neither two robots nor two positions are given, or a position is none.
    """
    robots, points = ("From", "To"), ("Start", "End")
    if all(message.get(key) for key in robots):
        count = radio.obstacles(*(message.get(key) for key in robots))
        keys = robots
    elif all(message.get(key) for key in points):
        ends = [read_parameters(message.get(key), _POSITION) for key in points]
        count = radio.obstacles_between(*(flip_wire_vector(end) for end in ends))
        keys = points
    else:
        raise PeerError("GETOBS needs From and To, or Start and End")
    # The wireless server at the other end compares with the text "-1", so no decimals here.
    number = "-1" if count is None else two_decimals(count)
    return Message("NUMOBS", (*((key, message.get(key)) for key in keys), ("ObstCount", number)))


class PositionSession:
    """One connection: lines in any chunking, answered in order."""

    def __init__(self, radio: RadioAccess) -> None:
        self._radio = radio
        self._lines = LineBuffer(MAX_LINE_SIZE)

    def receive_data(self, data: bytes) -> bytes:
        """Return the answers to the lines that `data` completes.

        Raises:
            HttpRequestError: The peer speaks HTTP; hang up.
        """
        answers = [self._answer(line) for line in self._lines.feed(data)]
        return b"".join(answer.encode("latin-1", "replace") + b"\r\n" for answer in answers if answer)

    def _answer(self, line: str) -> str:
        try:
            message = parse_message(line)
            if message.kind == "GETPOS":
                return format_message(positions(self._radio))
            return format_message(obstacles(self._radio, message)) if message.kind == "GETOBS" else ""
        except PeerError:
            return ""
