"""A recording of a served world is never far behind: shapes and frames wait, states do not."""

import copy
import json
import math
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from tests.recording.missions import mission_world
from usarmjx.recording import file as file_module
from usarmjx.recording.file import ChannelName, RecordingFile
from usarmjx.recording.foxglove import SceneTexts
from usarmjx.recording.inputs import StepState
from usarmjx.recording.reader import Recording
from usarmjx.server.runtime.metrics import frames_left_out, recording_lag

STATES = ChannelName(0, "states")
PATIENCE = 60.0
"""Time [s] for what takes milliseconds on an idle machine."""


def wait_until_written(file):
    """Wait for all jobs so far."""
    done = threading.Event()
    file.put(lambda _: done.set())
    assert done.wait(PATIENCE)


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


def test_equal_shapes_have_one_key(mission):
    """Texts of materials are objects: addresses distinguished two equal ones."""
    drawing = next(Recording(mission[0]).messages(["drawings"])).value
    bodies = range(len(drawing.bodies))

    def key(change):
        shapes = {name: change(shape) for name, shape in drawing.shapes.items()}
        return SceneTexts().key(replace(drawing, shapes=shapes), bodies)

    def with_materials(shape, end=""):
        texts = [f"{text[:1]}{text[1:]}{end}" for text in shape.material]
        return replace(shape, material=np.array(texts, object))

    assert key(copy.deepcopy) == key(with_materials) == key(lambda shape: shape)
    assert key(lambda shape: with_materials(shape, "x")) != key(copy.deepcopy)


def state(step):
    return StepState(step=step, time=0.02 * step, qpos=np.ones(2), qvel=np.ones(2), act=np.ones(0))


def test_frames_that_come_too_late_are_left_out_and_counted_and_states_are_not(tmp_path):
    file = RecordingFile(tmp_path / "late.mcap", max_lag=0.0)
    held, shown = threading.Event(), []
    file.put(lambda _: held.wait(PATIENCE))
    for step in range(20):
        file.put(lambda file, step=step: file.write(STATES, 0.02 * step, state(step)))
        file.put(lambda _, step=step: shown.append(step), is_frame=True)
    meter = SimpleNamespace(
        server=SimpleNamespace(world=SimpleNamespace(recorder=SimpleNamespace(file=file)))
    )
    assert recording_lag(meter) >= 0.0
    held.set()
    wait_until_written(file)
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
    assert ready.wait(PATIENCE)
    file.close()
    assert order == [("written", 0), "urgent", ("written", 1), ("written", 2)]


def test_a_flipped_bit_in_the_middle_costs_one_part_and_is_logged(tmp_path, caplog, monkeypatch):
    """Of a recording that was broken off, as by a kill; all after the bit was lost."""
    monkeypatch.setattr(file_module, "FLUSH", math.inf)  # parts end only where the test wants it
    path = tmp_path / "broken.mcap"
    file = RecordingFile(path)
    for step in range(60):
        file.put(lambda file, step=step: file.write(STATES, 0.02 * step, state(step)))
        if step % 10 == 9:
            file.put(lambda file: file._flush())
    wait_until_written(file)
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
    assert caplog.messages == [f"{cut}: 1 parts are damaged and left out, 0.2 s of the recording"]


def test_the_scene_is_json_of_its_own_text(tmp_path):
    world, file = mission_world(tmp_path / "scene.mcap")
    for _ in range(12):
        world.step()
    file.close()
    scene = next(Recording(file.path).messages(["scene"])).value
    assert json.loads(json.dumps(scene)) == scene
