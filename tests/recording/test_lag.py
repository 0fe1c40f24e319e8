"""A recording of a served world is never far behind: shapes and frames wait, states do not."""

import json
import threading
import time
from types import SimpleNamespace

import numpy as np

from tests.recording.missions import mission_world
from usarmjx.recording.file import ChannelName, RecordingFile
from usarmjx.recording.inputs import StepState
from usarmjx.recording.reader import Recording
from usarmjx.server.runtime.metrics import frames_left_out, recording_lag

STATES, EVENTS = ChannelName(0, "states"), ChannelName(0, "events")


def test_what_does_not_change_is_written_once(mission):
    """The room and its victim, while two robots join and one leaves; a join wrote 4 MB."""
    recording = Recording(mission[0])
    found = [(message.channel.about, message.value) for message in recording.messages(["scene"])]
    rooms = [scene for about, scene in found if about == ""]
    robots = [scene for about, scene in found if about == "robots"]
    assert len(rooms) == 1
    assert {one["id"].partition("/")[0] for one in rooms[0]["entities"]} >= {"arena", "loose"}
    assert 1 <= len(robots) <= 3
    assert {one["id"].partition("/")[0] for scene in robots for one in scene["entities"]} == {"robot"}
    assert all(len(scene["deletions"]) == 1 for _, scene in found)


def state(step):
    return StepState(step=step, time=0.02 * step, qpos=np.ones(2), qvel=np.ones(2), act=np.ones(0))


def test_frames_that_come_too_late_are_left_out_and_counted_and_states_are_not(tmp_path):
    file = RecordingFile(tmp_path / "late.mcap", max_lag=0.0)
    held, shown = threading.Event(), []
    file.put(lambda _: held.wait(10))
    for step in range(20):
        file.put(lambda file, step=step: file.write(STATES, 0.02 * step, state(step)))
        file.put(lambda _, step=step: shown.append(step), is_frame=True)
    meter = SimpleNamespace(
        server=SimpleNamespace(world=SimpleNamespace(recorder=SimpleNamespace(file=file)))
    )
    assert recording_lag(meter) >= 0.0
    held.set()
    while file.lag:
        time.sleep(0.01)
    file.close()
    assert shown == []
    assert frames_left_out(meter) == 20
    assert [one.value.step for one in Recording(file.path).messages(["states"])] == [*range(20)]
    without = SimpleNamespace(server=SimpleNamespace(world=SimpleNamespace(recorder=None)))
    assert recording_lag(without) == frames_left_out(without) == 0.0


def test_pieces_wait_for_all_that_is_more_urgent_and_the_last_operation_counts(tmp_path):
    file = RecordingFile(tmp_path / "pieces.mcap")
    order, ready = [], threading.Event()

    def pieces(name):
        for number in range(3):
            order.append((name, number))
            if number == 0:
                file.put(lambda _: order.append("urgent"))
            yield

    def begin(file):
        file.write_in_pieces(STATES, pieces("dropped"))
        file.write_in_pieces(STATES, pieces("written"))
        ready.set()

    file.put(begin)
    assert ready.wait(10)
    file.close()
    assert order == [("written", 0), "urgent", ("written", 1), ("written", 2)]


def test_a_flipped_bit_in_the_middle_costs_one_part_and_is_told(tmp_path, caplog):
    """Of a recording that was broken off, as by a kill; all after the bit was lost."""
    path = tmp_path / "broken.mcap"
    file = RecordingFile(path)
    for step in range(60):
        file.put(lambda file, step=step: file.write(STATES, 0.02 * step, state(step)))
        if step % 10 == 9:
            file.put(lambda file: file._flush())
    while file.lag:
        time.sleep(0.01)
    file.put(lambda file: file._flush())
    while file.lag:
        time.sleep(0.01)
    time.sleep(0.2)
    whole = path.read_bytes()
    file.close()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole)
    before = Recording(cut)
    assert not before.is_complete
    parts = before._parts
    assert len(parts) >= 6
    assert before.damaged == 0
    damaged = bytearray(whole)
    damaged[parts[2].offset + 9 + 60] ^= 4  # in the chunk's content
    cut.write_bytes(damaged)
    after = Recording(cut)
    assert after.damaged == 1
    steps = [one.value.step for one in after.messages(["states"])]
    assert steps == [*range(20), *range(30, 60)]
    assert caplog.messages == [f"{cut}: 1 parts are damaged and left out, 0.2 s of what was recorded"]


def test_the_scene_is_json_of_its_own_text(tmp_path):
    world, file = mission_world(tmp_path / "scene.mcap")
    for _ in range(12):
        world.step()
    file.close()
    scene = next(Recording(file.path).messages(["scene"])).value
    assert json.loads(json.dumps(scene)) == scene
