"""What is drawn of robots and victims is for pictures: rays of sensors meet the solids of physics."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.lone import LoneWorld
from tests.models.robots.test_visuals import naked
from usarmjx.base.backend import numpy_backend
from usarmjx.models.compile.kinematic_tree import forward_kinematics
from usarmjx.models.compile.victims import BONES, POSTURES, rest_height, victim_table
from usarmjx.models.compile.visuals import BONE_VISUALS, VISUAL_SLOTS, drawn_bones, used_slots
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, FalseAlarm, SegmentMotion, StartPose, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.cameras.paint import FALSE_ALARM_LABEL, ROBOT_LABEL, VICTIM_LABEL
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.served_world import CameraRequest
from usarmjx.sim.ray_geometry import visible_arena, visible_robots
from usarmjx.sim.scene import build_scene
from usarmjx.sim.views import geom_colors_of
from usarmjx.sim.world import robot_states

WAVE = SegmentMotion(name="LeftArm", final=(0.0, 1.2, 0.0), rates=(0.0, 2.0, 0.0))
HOUSE = ArenaSpec(
    name="house",
    shapes=(Shape(kind="box", size=(0.1, 2.0, 0.5), at=(4.0, 0.0, 0.5), surface="wall"),),
    starts=(
        StartPose(tag="A", at=(0.0, 0.0, 0.2)),
        StartPose(tag="B", at=(1.6, 0.2, 0.2), yaw=2.5),
        StartPose(tag="C", at=(-1.5, 1.5, 0.2)),
    ),
    extent=((-3, 5), (-3, 3)),
    victims=(
        Victim(name="lies", at=(1.0, -1.0, rest_height("lying")), posture="lying"),
        Victim(name="waves", at=(2.5, 1.0, rest_height("standing")), posture="standing", segments=(WAVE,)),
    ),
    false_alarms=(FalseAlarm(part="LeftHand", at=(2.0, -0.5, 0.1)),),
)
PAIR = [ROBOTS.get("P2AT"), ROBOTS.get("Kurt3D")]


def readings(robots):
    world = LoneWorld(build_scene(HOUSE, robots))
    for _ in range(3):
        world.step()
    return [
        np.asarray(value)
        for group in world.observe()
        for reading in group
        for value in [reading.value]
        if isinstance(value, np.ndarray)
    ]


def test_sensors_read_the_same_to_the_bit_without_looks():
    drawn, bare = readings(PAIR), readings([naked(robot) for robot in PAIR])
    assert len(drawn) == len(bare) > 10
    assert sum(value.size for value in drawn) > 2 * 181, "among them two laser scanners"
    assert all(np.array_equal(one, other) for one, other in zip(drawn, bare, strict=True))


def snapshot(robots):
    world = DynamicWorld(HOUSE, seed=1)
    made = [
        world.spawn(robot, start.tag, (*start.at[:2], 0.2), (0.0, 0.0, start.yaw))
        for robot, start in zip(robots, HOUSE.starts, strict=False)
    ]
    (picture,) = world.snapshot([CameraRequest(made[0], 0, 64, 48)])()
    return world, picture


def test_pictures_show_looks_and_physics_does_not_know_them():
    (world, drawn), (other, bare) = snapshot(PAIR), snapshot([naked(robot) for robot in PAIR])
    assert ROBOT_LABEL + 1 in drawn.segmentation
    assert (np.asarray(drawn.rgb) != np.asarray(bare.rgb)).any(-1).mean() > 0.05
    assert world._single.engine.model.ngeom == other._single.engine.model.ngeom
    for _ in range(5):
        world.step()
        other.step()
    assert np.array_equal(world._single.engine.data.qpos, other._single.engine.data.qpos)


def test_rows_tell_what_is_drawn_from_what_sensors_meet():
    scene = build_scene(HOUSE, PAIR)
    world = LoneWorld(scene)
    with numpy_backend():
        bodies = tuple(
            forward_kinematics(group.plan, robot_states(group, world.physics)) for group in scene.groups
        )
        active = [state.active for state in world.world.groups]
        met, drawn = (visible_robots(scene, bodies, active, drawn=which) for which in (False, True))
    for group, one, other in zip(scene.groups, met, drawn, strict=True):
        assert len(one.kind) == len(group.plan.geom_type) * len(group.slots)
        assert len(other.kind) == len(group.plan.visuals.solids.kind) * len(group.slots)


def rows_of(scene, state, time):
    with numpy_backend():
        return visible_arena(scene, state, np.float32(time), drawn=True)[-1]


def test_victims_are_drawn_with_all_they_have_and_move_as_their_bones_do():
    scene = build_scene(HOUSE, ["P2AT"])
    before, after = rows_of(scene, None, 0.0), rows_of(scene, None, 0.5)
    each = sum(len(BONE_VISUALS[bone.part]) for bone in BONES.values())
    assert (np.asarray(before.label) == VICTIM_LABEL).sum() == 2 * each
    assert (np.asarray(before.label) == FALSE_ALARM_LABEL).sum() == len(BONE_VISUALS["Hand"])
    moved = np.linalg.norm(np.asarray(after.pos - before.pos), axis=-1) > 1e-6
    assert 0 < moved.sum() <= len(BONE_VISUALS["Arm"]) + len(BONE_VISUALS["Hand"]), "one arm waves"
    with numpy_backend():
        met = visible_arena(scene, None, np.float32(0.0))
    boxes = sum(np.isin(row.label, (VICTIM_LABEL, FALSE_ALARM_LABEL)).sum() for row in met)
    assert boxes == 2 * len(BONES) + 1, "sensors meet a box for each bone"


@pytest.mark.parametrize("posture", POSTURES)
def test_what_is_drawn_of_a_bone_is_about_as_large_as_its_box(posture):
    table = victim_table([Victim(name="one", at=(0.0, 0.0, 1.0), posture=posture)])
    drawn, used = drawn_bones(table), used_slots(table.part)
    reach = np.linalg.norm(drawn.offset, axis=-1)[used]
    assert (reach < 1.2 * np.linalg.norm(table.size, axis=-1).repeat(used.sum(1))).all()
    assert (drawn.size[used] > 0).all()
    assert ((drawn.rgb >= 0) & (drawn.rgb <= 1)).all()
    faces = drawn.rgb[np.flatnonzero(table.part == 0)[0]]
    assert len(np.unique(faces[: len(BONE_VISUALS["Head"])], axis=0)) >= 4, "skin, hair, eyes, lips"


def test_victims_that_are_data_are_drawn_as_those_of_the_arena_alone():
    other = replace(HOUSE, name="other", victims=HOUSE.victims[1:], false_alarms=())
    scene = build_scene([HOUSE, other], ["P2AT"])
    for world, arena in enumerate((HOUSE, other)):
        alone = rows_of(build_scene(arena, ["P2AT"]), None, 0.4)
        state = jax.tree.map(lambda x, world=world: x[world], scene.arenas.states)
        rows = rows_of(scene, state, 0.4)
        assert rows.kind.tolist() == list(VISUAL_SLOTS) * (len(rows.kind) // len(VISUAL_SLOTS))
        there = np.flatnonzero(np.abs(np.asarray(rows.pos)).max(-1) < 1e3)
        assert rows.kind[there].tolist() == alone.kind.tolist()
        for name in ("pos", "size", "rgb", "label"):
            assert np.asarray(getattr(rows, name))[there] == pytest.approx(
                np.asarray(getattr(alone, name)), abs=1e-5
            )


def test_a_figure_is_built_once_for_all_robots_of_a_class_and_all_victims_of_a_size():
    """Joining robots would wait for it otherwise."""
    scene = build_scene(HOUSE, ["P2AT", "P2AT", "Kurt3D"])
    figures = geom_colors_of(scene).figures
    assert len(figures) == 3 + 3
    robots = [one.figure for one in figures if one.slot >= 0]
    assert robots[0] is robots[1] is not robots[2]
    lies, waves = (one.figure for one in figures if one.label == VICTIM_LABEL)
    assert lies is waves
    again = geom_colors_of(build_scene(HOUSE, ["P2AT"])).figures
    assert again[0].figure is robots[0]
    assert math.prod(robots[0].model.geom_rbound > 0) == 1
