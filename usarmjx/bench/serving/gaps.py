"""How late a watcher's reports are while others join, leave and talk; and when pictures come."""

import time
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.bench.serving.clients import Crowd, RobotClient
from usarmjx.bench.serving.figures import Figure, Missing
from usarmjx.bench.serving.robots import (
    MIX,
    REPORT_PERIOD,
    TURNING,
    Bounds,
    RunningServer,
    Watcher,
    ask,
    join,
    start_tags,
    wait_for_reports,
)

SPAM_LINES = 100
"""Commands that a client hands over at once when it sends as fast as it can."""
SET_POSE = "SET {Type INS} {Name INS} {Opcode POSE} {Params 0,0,0,0,0,0}"


class Bustle:
    """A P2AT that watches, and others who do something.

    Args:
        crowd: Whose loop reads all.
        joining: How many others.
        bounds: How long.

    Attributes:
        watcher: The watching one.

    Raises:
        UsageError: It has no report within the limit, or there are not enough start poses.
    """

    def __init__(self, crowd: Crowd, joining: int, bounds: Bounds) -> None:
        self._crowd, self._bounds = crowd, bounds
        first, *self._tags = start_tags(crowd, joining + 1, bounds.limit)
        client = join(crowd, MIX[0], first)
        if isinstance(found := wait_for_reports(crowd, [client], bounds.limit), Missing):
            raise UsageError(found.reason)
        self.watcher = Watcher(crowd, client, bounds.limit)
        self._others: list[RobotClient] = []

    def quiet(self) -> dict[str, Figure]:
        """Do nothing for a while."""
        self._crowd.pump(self._bounds.seconds)
        return {}

    def join_at_once(self) -> dict[str, Figure]:
        """Let all others join at the same moment."""
        self._others = [join(self._crowd, kind, tag) for kind, tag in self._who()]
        return {"all_report_s": wait_for_reports(self._crowd, self._others, self._bounds.limit)}

    def join_in_turn(self) -> dict[str, Figure]:
        """Let the others join, each when the one before has had its first report."""
        took: list[float] = []
        for kind, tag in self._who():
            self._others.append(join(self._crowd, kind, tag))
            found = wait_for_reports(self._crowd, self._others[-1:], self._bounds.limit)
            if isinstance(found, Missing):
                return {"first_sta_s": found}
            took.append(found)
        return {"first_sta_s": took}

    def leave_at_once(self) -> dict[str, Figure]:
        """Let all others leave at the same moment."""
        return self._leave(0.0)

    def leave_in_turn(self) -> dict[str, Figure]:
        """Let the others leave one after another."""
        return self._leave(REPORT_PERIOD)

    def set_pose(self) -> dict[str, Figure]:
        """Let one of the others tell its INS where it is: the first SET of all."""
        limit = self._bounds.limit
        answer = ask(self._crowd, self._others[0], SET_POSE, lambda message: message.kind == "RES", limit)
        return {"answer_s": answer}

    def spam(self) -> dict[str, Figure]:
        """Let one of the others send commands as fast as it can."""
        other, sent = self._others[0], 0
        began = time.perf_counter()
        while time.perf_counter() < began + self._bounds.seconds:
            if not other.unsent:
                other.say(*[TURNING] * SPAM_LINES)
                sent += SPAM_LINES
            self._crowd.pump(1e-3)
        return {"commands_per_s": sent / (time.perf_counter() - began)}

    def _who(self) -> list[tuple[str, str]]:
        return [(MIX[(i + 1) % len(MIX)], tag) for i, tag in enumerate(self._tags)]

    def _leave(self, pause: float) -> dict[str, Figure]:
        for client in self._others:
            self._crowd.leave(client)
            self._crowd.pump(pause)
        self._others = []
        self._crowd.pump(self._bounds.settling)
        return {}


def measure_gaps(server: RunningServer, joining: int, bounds: Bounds) -> dict[str, Any]:
    """Measure how late a watcher's reports are while others join, leave and talk."""
    with Crowd(server.port) as crowd:
        bustle = Bustle(crowd, joining, bounds)
        acts = {
            "quiet": bustle.quiet,
            "joining at once": bustle.join_at_once,
            "first SET POSE": bustle.set_pose,
            "spam": bustle.spam,
            "leaving at once": bustle.leave_at_once,
            "joining in turn": bustle.join_in_turn,
            "leaving in turn": bustle.leave_in_turn,
        }
        return {name: bustle.watcher.during(act) for name, act in acts.items()}


def measure_pictures(server: RunningServer, bounds: Bounds) -> dict[str, Any]:
    """Measure when the first picture comes, and the first that is not black; pictures must be raw."""
    with Crowd(server.port) as crowd:

        def look() -> dict[str, Figure]:
            began = time.perf_counter()
            client = crowd.pictures(server.image_port)
            crowd.wait(lambda: any(shows for _, shows in client.frames), bounds.limit)
            none = Missing(f"none within {bounds.limit:g} s")
            return {
                "first_frame_s": next((came - began for came, _ in client.frames), none),
                "first_view_s": next((came - began for came, shows in client.frames if shows), none),
            }

        return Bustle(crowd, 0, bounds).watcher.during(look)
