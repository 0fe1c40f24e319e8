"""A radio whose answers a test sets."""

from usarmjx.server.wireless.channel import RadioRobot


class FakeRadio:
    """Robots by name, and the power received between them [dBm]; -50 where nothing is said."""

    def __init__(self, robots, powers=None):
        self.cutoff = -93.0
        self.robots = list(robots)
        self.powers = dict(powers or {})
        self.walls = {}
        self.positions = {}
        self.empty = set()

    def _find(self, name):
        return next((robot for robot in self.robots if robot.lower() == name.lower()), None)

    def present(self):
        return [
            RadioRobot(name, self.positions.get(name, (0.0, 0.0, 0.0)), name in self.empty)
            for name in self.robots
        ]

    def has_robot(self, name):
        return self._find(name) is not None

    def _between(self, table, one, other, default):
        pair = (self._find(one), self._find(other))
        if None in pair:
            return None
        return table.get(pair, table.get(pair[::-1], default))

    def signal_strength(self, one, other):
        return self._between(self.powers, one, other, -50.0)

    def obstacles(self, one, other):
        return self._between(self.walls, one, other, 0)

    def obstacles_between(self, start, end):
        return self.walls.get((start, end), 0)
