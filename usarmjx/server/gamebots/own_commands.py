"""Commands beyond the manual's (14.4.3): a head, and its effect on the robot of the client that sends it."""

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

from usarmjx.server.protocol.command_parsers import COMMANDS
from usarmjx.server.protocol.commands import OwnCommand
from usarmjx.server.protocol.grammar import Message, check_word
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld

CommandAction: TypeAlias = Callable[[ServedWorld, Robot, Message], Message | None]
"""Action of a command: the world, the robot of the client, and its line; returns the answer, or None."""


def add_command(head: str, action: CommandAction) -> None:
    """Register a command with another head, for clients with a robot of all servers of this process.

    Args:
        head: The first word of the line, whose case is ignored.
        action: Function of the world, the client's robot and the message; returns the answer or None. It
            runs between two control steps, and everybody waits for it.

    Raises:
        UsageError: There is such a command already, or the head is not one word.
    """
    COMMANDS.add(check_word(head), partial(OwnCommand, action))
