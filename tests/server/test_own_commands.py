"""Commands of one's own (manual 14.4.3): understood as others are, once there is a robot."""

import pytest

from tests.server.peers import Peer, serving
from tests.server.still_world import StillWorld, init
from usarmjx.base.errors import UsageError
from usarmjx.server.gamebots.adapter import add_command
from usarmjx.server.protocol.command_parsers import COMMANDS
from usarmjx.server.protocol.grammar import Message


@pytest.fixture
def told():
    """What a command WAVE was told, by whom."""
    said = []

    def wave(world, robot, message):
        said.append((robot.name, message.segments))
        if times := message.get("Times"):
            return Message("WAVED", (("Time", f"{world.time:.2f}"), ("Times", times)))
        return None

    add_command("WAVE", wave)
    yield said
    COMMANDS.discard("WAVE")


def test_a_command_of_ones_own_reaches_the_robot_and_is_answered(told):
    with serving(StillWorld()) as (port, server):
        peer = Peer(port, "WAVE {Times 1}")  # before there is a robot
        peer.say(init("R1"))
        peer.say("wave {Hand Left}\r\nWave {Times 3} {Hand right one}")
        assert peer.until(b"WAVED").split(b"} ")[1] == b"{Times 3}"
        assert told == [("R1", (("Hand", "Left"),)), ("R1", (("Times", "3"), ("Hand", "right one")))]
        assert server.counts.commands
        peer.close()


def test_the_manuals_commands_stay_what_they_are(told):
    for head, says in (("drive", "'drive' is registered already"), ("WAVE", "registered already")):
        with pytest.raises(UsageError, match=says):
            add_command(head, lambda world, robot, message: None)
    with pytest.raises(UsageError, match="must be one word"):
        add_command("WAVE AGAIN", lambda world, robot, message: None)
