"""Cost of recording for the loop of a world of sixteen robots: calls of functions, and bytes."""

import sys

from benchmarks.recording import ROBOTS_THERE, ROUND, drive_crowd
from tests.recording.missions import HEIGHT, SCOUT
from usarmjx.models.arenas import ARENAS
from usarmjx.recording.reader import Recording
from usarmjx.recording.recorder import WorldRecorder
from usarmjx.server.worlds import dynamic_world
from usarmjx.server.worlds.recorded import record_worlds

MOST_CALLS = 250
"""Calls of functions, Python's and C's, that recording may make in the loop's thread in a control step.

The rest is done by a thread that writes. Seconds are measured by `python -m benchmarks.recording`.
"""
MOST_BYTES = 6_000
"""Size of the file per control step [bytes]."""


class Calls:
    """Calls that are made inside of some functions, in the thread that calls these."""

    def __init__(self):
        self.count = 0

    def note(self, frame, event, arg):
        self.count += event in ("call", "c_call")

    def counted(self, function):
        def run(*args, **kwargs):
            sys.setprofile(self.note)
            try:
                return function(*args, **kwargs)
            finally:
                sys.setprofile(None)

        return run


def test_the_loop_does_little_for_a_recording(tmp_path, monkeypatch):
    calls = Calls()
    monkeypatch.setattr(dynamic_world, "record_step", calls.counted(dynamic_world.record_step))
    for name in ("record_orders", "read", "lines"):
        monkeypatch.setattr(WorldRecorder, name, calls.counted(getattr(WorldRecorder, name)))
    world = dynamic_world.DynamicWorld(ARENAS.get("soccer"), max_robots=ROBOTS_THERE)
    file = record_worlds([world], tmp_path / "crowd.mcap")
    costs = []
    for _ in drive_crowd(world, SCOUT, HEIGHT, 6):
        costs.append(calls.count / ROUND)
        calls.count = 0
    file.close()
    assert 0 < max(costs[1:]) <= MOST_CALLS  # the first round sets up
    assert file.path.stat().st_size <= 6 * ROUND * MOST_BYTES
    recording = Recording(file.path)
    assert [message.value.step for message in recording.messages(["states"])] == [*range(1, 6 * ROUND + 1)]
    assert len([*recording.messages(["lines"])]) == 6 * ROBOTS_THERE
