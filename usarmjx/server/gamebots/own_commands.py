"""Commands of one's own beside the manual's (14.4.3): a head, and what it does for the robot that says it."""

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

from usarmjx.server.protocol.command_parsers import COMMANDS
from usarmjx.server.protocol.commands import OwnCommand
from usarmjx.server.protocol.grammar import Message, check_word
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld

CommandAction: TypeAlias = Callable[[ServedWorld, Robot, Message], Message | None]


def add_command(head: str, action: CommandAction) -> None:
    """Let clients that have a robot say lines with another head, to all servers of this process.

    Args:
        head: The first word of the line, whose case is ignored.
        action: Is called with the world, the client's robot and what was said; returns what the client hears
            at once, or None. It runs between two control steps, and everybody waits for it.

    Raises:
        UsageError: There is such a command already, or the head is not one word.
    """
    COMMANDS.add(check_word(head), partial(OwnCommand, action))
