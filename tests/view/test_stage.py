"""What is sent of worlds: each look once, and of what happens only what moved."""

from dataclasses import replace

import numpy as np
import pytest
import viser

from tests.view.simple_worlds import drawing_of, frame_of
from usarmjx.view.stage import Stage, StagedWorld, grid_offsets


@pytest.fixture
def sent(scene, monkeypatch):
    """The messages that go to the browsers."""
    messages, queue = [], scene._queue_scene_message

    def keep(message):
        messages.append(message)
        queue(message)

    monkeypatch.setattr(scene, "_queue_scene_message", keep)
    return messages


def batches(scene):
    known = scene._handle_from_node_name
    return [one for one in known.values() if isinstance(one, viser.BatchedGlbHandle)]


def staged(scene, *drawings):
    stage = Stage(scene)
    stage.begin([StagedWorld(*pair) for pair in zip(drawings, grid_offsets(drawings), strict=True)])
    stage.update([frame_of(drawing) for drawing in drawings])
    return stage


def moved(frame, body):
    pos = frame.pos.copy()
    pos[body] += (0.1, 0.0, 0.0)
    return replace(frame, pos=pos)


def test_what_looks_the_same_is_one_batch_and_glass_another(scene):
    staged(scene, drawing_of(robots=3))
    # The arena's walls and its glass, chassis, and the wheels of both sides.
    assert sorted(len(batch.batched_positions) for batch in batches(scene)) == [1, 1, 3, 6]


def test_only_what_moved_is_sent(scene, sent):
    drawing = drawing_of(robots=3)
    stage, frame = staged(scene, drawing), frame_of(drawing)
    sent.clear()
    stage.update([frame])
    assert sent == []
    stage.update([moved(frame, drawing.robots[1].body)])
    assert [set(message.updates) for message in sent] == [{"batched_positions"}, {"batched_wxyzs"}]
    assert sent[0].updates["batched_positions"][:, 0] == pytest.approx([0.0, 1.1, 2.0])


def test_robots_that_come_and_go_leave_the_rest_as_it_is(scene, sent):
    stage = staged(scene, drawing_of(robots=1))
    before = {batch.name for batch in batches(scene)}
    sent.clear()
    for robots in (4, 2):
        drawing = drawing_of(robots=robots)
        stage.begin([StagedWorld(drawing, np.zeros(3))])
        stage.update([frame_of(drawing)])
        assert {batch.name for batch in batches(scene)} == before
        assert sorted(len(batch.batched_positions) for batch in batches(scene)) == [1, 1, robots, 2 * robots]
    assert not any(hasattr(getattr(message, "props", None), "batched_positions") for message in sent)
    stage.begin([StagedWorld(drawing_of(robots=0), np.zeros(3))])
    assert len(batches(scene)) == 2


def test_robots_that_are_not_there_are_not_drawn(scene):
    drawing = drawing_of(robots=2)
    stage, frame = staged(scene, drawing), frame_of(drawing)
    own = np.array([body.slot == 1 for body in drawing.bodies])
    stage.update([replace(frame, shown=~own)])
    assert sorted(len(batch.batched_positions) for batch in batches(scene)) == [1, 1, 1, 2]
    stage.update([replace(frame, shown=np.array([body.slot < 0 for body in drawing.bodies]))])
    assert sum(batch.visible for batch in batches(scene)) == 2
    stage.update([frame])
    assert all(batch.visible for batch in batches(scene))


def test_sixteen_worlds_stand_four_by_four_and_none_in_another(scene):
    drawings = [drawing_of(robots=1, floor=float(n % 2)) for n in range(16)]
    offsets = grid_offsets(drawings)
    middles = np.array([drawing.extent.mean(1) for drawing in drawings]) + np.array(offsets)[:, :2]
    assert len(np.unique(middles[:, 0].round(6))) == len(np.unique(middles[:, 1].round(6))) == 4
    apart = np.abs(middles[:, None] - middles[None])
    assert all((apart[i, j] >= [10.0, 8.0]).any() for i in range(16) for j in range(i))
    assert [drawing.floor + offset[2] for drawing, offset in zip(drawings, offsets, strict=True)] == [
        0.0
    ] * 16
    staged(scene, *drawings)
    assert sorted(len(batch.batched_positions) for batch in batches(scene)) == [16, 16, 16, 32]


def test_several_worlds_have_their_names_and_scores_at_their_near_sides_and_one_has_none(scene):
    drawings = [drawing_of(robots=1) for _ in range(4)]
    stage, offsets = Stage(scene), grid_offsets(drawings)
    names = [f"world {n}" for n in range(4)]
    stage.begin([StagedWorld(*one) for one in zip(drawings, offsets, names, strict=True)])
    stage.update([replace(frame_of(drawing), score=12.3) for drawing in drawings])
    labels = {one.text: one for one in stage._labels}
    assert sorted(labels) == [f"world {n}: 12" for n in range(4)]
    for number, offset in enumerate(offsets):
        x, y, z = labels[f"world {number}: 12"].position - offset
        assert (x, z) == (0.0, 0.0)
        assert -6.0 < y < -4.0, "between its own arena and the next one"
    stage.begin([StagedWorld(drawings[0], np.zeros(3), "world 0")])
    assert not [name for name in scene._handle_from_node_name if "/name/" in name]


def test_a_floor_without_bounds_ends_a_little_beyond_the_arena(scene):
    staged(scene, drawing_of())
    assert [name for name in scene._handle_from_node_name if "/floor/" in name] == ["/bodies/floor/0"]
