"""Recordings as files: whole, killed, cut off anywhere, and on a disk that is full."""

import json
import logging
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.recording.missions import mission_world
from usarmjx.base.errors import UsageError
from usarmjx.recording.file import CHANNELS, FLUSH, WAKE, ChannelName, RecordingFile
from usarmjx.recording.inputs import StepState
from usarmjx.recording.reader import Recording

STATES = ChannelName(0, "states")
STEP = 0.02
PERIOD_STEPS = 10
"""Control steps between two frames."""


def steps_of(recording):
    return [message.value.step for message in recording.messages(["states"])]


def test_every_step_is_there_with_what_there_was_to_see(mission):
    path, places = mission
    recording = Recording(path)
    assert recording.is_complete
    assert steps_of(recording) == [*range(1, len(places) + 1)]
    frames = [message.value for message in recording.messages(["frames"])]
    assert len(frames) == len(places) // PERIOD_STEPS
    names = {slot: robot.name for slot, robot in recording.last("drawings", 0, 0.5).value.robots.items()}
    for frame in frames:
        here = places[round(frame.time / STEP) - 1]
        assert {*here} >= {names.get(slot, "Second") for slot in frame.robots}
        for slot, robot in frame.robots.items():
            np.testing.assert_allclose(robot.pos, here[names.get(slot, "Second")], atol=1e-5)


def test_what_happened_is_told_in_words_lines_and_readings(mission):
    recording = Recording(mission[0])
    events = [(m.value["kind"], m.value["robot"]) for m in recording.messages(["events"])]
    assert events == [("join", "First"), ("join", "Second"), ("leave", "First")]
    (line,) = recording.messages(["lines"])
    assert line.value["text"] == "DRIVE {Left 1}\r\n"
    assert not line.value["sent"]
    readings = next(recording.messages(["readings"])).value
    assert {*readings["sensors"]} == {0, 1}
    assert len(readings["values"][0]) == 32


def test_others_read_it_by_its_schemas(mission):
    with mission[0].open("rb") as file:
        found = {}
        for schema, channel, message in make_reader(file).iter_messages():
            if schema.name.startswith("foxglove."):
                assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                said = json.loads(message.data)
                known = json.loads(schema.data)["properties"]
                assert {*said} <= {*known}
                found.setdefault(schema.name, []).append((channel.topic, said))
    assert {*found} == {name for name in CHANNELS.values() if name.startswith("foxglove.")}
    transforms = [one for _, said in found["foxglove.FrameTransforms"] for one in said["transforms"]]
    assert {"First/HARD", "Second/HARD", "loose/ball"} <= {one["child_frame_id"] for one in transforms}
    boxes = found["foxglove.SceneUpdate"][0][1]["entities"][0]["cubes"]
    assert sorted(box["size"]["x"] for box in boxes)[-1] == pytest.approx(6.0)
    topic, scan = found["foxglove.LaserScan"][0]
    assert topic == "/scan/First_Scanner1"
    assert len(scan["ranges"]) == 32
    assert scan["ranges"][16] == pytest.approx(2.5, abs=1.0)  # the wall or the victim ahead


def steps_in_part(path):
    try:
        recording = Recording(path)
    except UsageError:  # not even one part of it is left
        return 0
    assert not recording.is_complete
    steps = steps_of(recording)
    assert steps == [*range(1, len(steps) + 1)]
    return len(steps)


def test_a_part_of_a_file_is_read_as_far_as_it_goes(mission, tmp_path):
    whole = mission[0].read_bytes()
    counts = []
    for twentieth in range(1, 21):
        part = tmp_path / f"{twentieth}.mcap"
        part.write_bytes(whole[: len(whole) * twentieth // 20 - (twentieth == 20)])
        counts.append(steps_in_part(part))
    assert counts == sorted(counts)
    assert counts[-1] == len(mission[1])


RECORD = """
import sys, time
import numpy as np
from pathlib import Path
from functools import partial
from usarmjx.recording.file import ChannelName, RecordingFile
from usarmjx.recording.inputs import StepState
file = RecordingFile(Path(sys.argv[1]))
step = 0
while True:
    step += 1
    state = StepState(step=step, time=0.02 * step, qpos=np.ones(9), qvel=np.ones(9), act=np.ones(3))
    file.put(partial(RecordingFile.write, channel=ChannelName(0, "states"), at=state.time, value=state))
    print(step, time.monotonic(), flush=True)
    time.sleep(0.02)
"""


def test_all_but_the_last_second_survives_a_kill(tmp_path):
    path = tmp_path / "killed.mcap"
    process = subprocess.Popen([sys.executable, "-c", RECORD, path], stdout=subprocess.PIPE, text=True)
    told = [process.stdout.readline().split() for _ in range(100)]
    process.send_signal(signal.SIGKILL)
    died = time.monotonic()
    told += [line.split() for line in process.stdout.read().splitlines()]
    process.wait()
    recording = Recording(path)
    assert not recording.is_complete
    steps = steps_of(recording)
    assert steps == [*range(1, len(steps) + 1)]
    # The thread may have waited for a processor as long as the one that told the steps.
    gaps = np.diff([float(when) for _, when in told])
    old = [int(step) for step, when in told if float(when) < died - 1.0 - gaps.max()]
    assert FLUSH + WAKE < 1.0
    assert steps[-1] >= max(old)


@contextmanager
def room_for(size):
    """Let this process write no file that is larger."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_the_recording_in_one_line_and_nothing_else(tmp_path, caplog):
    world, file = mission_world(tmp_path / "full.mcap")
    with room_for(file.path.stat().st_size + 3000), caplog.at_level(logging.ERROR):
        while not file.ended:
            world.step()
            time.sleep(0.01)
        for _ in range(5):
            world.step()
        file.close()
    lines = [record.getMessage() for record in caplog.records]
    assert lines == [f"the recording ends here: cannot write {file.path}: File too large"]


def test_whoever_puts_faster_than_the_disk_writes_waits_and_loses_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("usarmjx.recording.file.MOST_WAITING", 20)
    file = RecordingFile(tmp_path / "fast.mcap")
    for step in range(200):
        state = StepState(step=step, time=0.02 * step, qpos=np.ones(2), qvel=np.ones(2), act=np.ones(0))
        file.put(lambda file, state=state: file.write(STATES, state.time, state))
        assert len(file._jobs) <= 21
    file.close()
    assert steps_of(Recording(file.path)) == [*range(200)]


def test_a_file_that_is_there_is_kept(mission):
    before = mission[0].read_bytes()
    with pytest.raises(UsageError, match="is there already"):
        RecordingFile(mission[0])
    assert mission[0].read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"no recording", bytes(4000)])
def test_what_is_no_recording_is_named(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=r"other\.mcap: is no recording"):
        Recording(path)


def test_a_file_that_is_missing_is_named(tmp_path):
    with pytest.raises(UsageError, match="No such file"):
        Recording(tmp_path / "none.mcap")
