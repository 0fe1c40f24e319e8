"""A robot in a world, and what a console knows of it: the server's dialogue without sockets."""

from tests.arenas import FLAT
from usarmjx.cli.console.driving import KeyDriver
from usarmjx.cli.console.knowledge import Knowledge
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.grammar import parse_message
from usarmjx.server.worlds.dynamic_world import DynamicWorld


class Driven:
    """A robot whose client is a console's pilot."""

    def __init__(self, kind, height=0.5, arena=FLAT, at=(0.0, 0.0)):
        self.world = DynamicWorld(arena, seed=1)
        self.client = Client(self.world, "console")
        self.knowledge = Knowledge()
        self.pilot = KeyDriver(self.knowledge)
        line = f"INIT {{ClassName USARBot.{kind}}} {{Name R1}} {{Location {at[0]},{at[1]},{-height}}}"
        self.knowledge.said(parse_message(line))
        (init,) = self.client.session.receive_data(f"{line}\r\n".encode())
        assert self.client.spawn(init, ROBOTS.get(kind))
        self.client.session.answer_init(True)
        self.run(0.5)
        while questions := self.knowledge.questions():
            self.tell(*questions)
        self.client.session.take_faults()

    @property
    def robot(self):
        return self.client.robot

    def tell(self, *lines):
        """Send lines and hear the answers."""
        for command in self.client.session.receive_data("".join(f"{line}\r\n" for line in lines).encode()):
            self.client.handle(command)
        self.hear()

    def hear(self):
        for line in self.client.session.data_to_send().decode("latin-1").splitlines():
            self.knowledge.hear(parse_message(line))

    def run(self, seconds):
        for _ in range(round(seconds / self.world.period)):
            self.world.step()
            self.client.add_trace_point()
            if self.client.due():
                if not self.knowledge.has_robot:  # names of sensors are learned once
                    self.world.observe([self.robot])
                self.client.report()
        self.hear()

    def press(self, *actions, seconds=0.0):
        """Do what keys say, one after the other."""
        for action in actions:
            self.tell(*self.pilot.press(action))
            self.run(seconds)

    @property
    def faults(self):
        return self.client.session.take_faults()
