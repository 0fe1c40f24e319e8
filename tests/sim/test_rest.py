"""The start of an episode is a state of rest: first readings are those of the same robot standing still."""

from dataclasses import replace

import numpy as np
import pytest

from tests.arenas import FLAT
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.standing import MAX_SINKING, START_GAP, standing_height
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import StartPose
from usarmjx.models.types.robot import Mount
from usarmjx.models.types.settings import manual_keys
from usarmjx.sensors.base import NOISE_SETTINGS, SENSORS
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene, start_height
from usarmjx.sim.single_world import SingleWorld

TREMBLING = {"kenaf": 0.5, "Soryu": 1.0, "Talon": 3.0, "TeleMax": 5.0}
"""Classes whose tracks tremble where they stand, and by how much they may accelerate within 0.1 s [m/s2]."""
STILL = 0.2
"""Acceleration of all others, for their springs settle to 1 um [m/s2]; a fall of 2 mm gives 9.81 and 10.4."""
FIRST = 5
"""Control steps that count as the first ones."""
SPACING = 6.0


def silent(kind):
    known = manual_keys(SENSORS.get(kind).settings_class)
    quiet = {key: 0.0 for name, key in known.items() if name in NOISE_SETTINGS}
    return Mount(kind=kind, name=kind, options=tuple({**quiet, "ScanInterval": 0.0}.items()))


KINDS = ("IMU", "INS", "GroundTruth")


def bare(name):
    return replace(ROBOTS.get(name), cameras=(), sensors=tuple(map(silent, KINDS)))


def classes():
    """All classes but those that dive, for which a dry floor is no place of rest."""
    return [name for name, spec in ROBOTS if spec.drive.vehicle != "NauticVehicle"]


def places(names):
    return [(SPACING * (i % 6), SPACING * (i // 6)) for i in range(len(names))]


def check(name, readings):
    """Readings of a robot's IMU, INS and ground truth in its first steps, (steps, n) each."""
    imu, ins, truth = (np.asarray(one, float) for one in readings)
    limit = TREMBLING.get(name, STILL)
    assert np.abs(imu[:, 3:] - (0.0, 0.0, 9.81)).max() < limit, f"{name} is no longer at rest"
    assert np.abs(imu[:, :3]).max() < 0.4 * limit, f"{name} turns"
    for what, pose in (("INS", ins), ("GroundTruth", truth)):
        moved = np.abs(pose - pose[0]).max(0)
        assert moved[:3].max() < 1e-3 * max(1.0, limit), f"{what} of {name} moves by {moved[:3]} m"


def test_served_robots_of_every_class_stand_still_from_their_first_reading_on():
    names = classes()
    world = SingleWorld(build_scene(FLAT, ()), seats=len(names))
    slots = {}
    for name, (x, y) in zip(names, places(names), strict=True):
        spec = bare(name)
        pose = (x, y, start_height(FLAT, StartPose(tag="S", at=(x, y, 0.188)), spec))
        slots[name] = world.add(spec, name, [(pose, np.array([1.0, 0, 0, 0]))])
    rows = [world.observe(slots.values())]
    for _ in range(FIRST):
        world.step()
        rows.append(world.observe(slots.values()))
    for name, slot in slots.items():
        check(name, [[row[slot][i].value for row in rows] for i in range(len(KINDS))])


@pytest.mark.parametrize("engine", ["c", "planar"])
def test_robots_of_batches_stand_still_after_a_reset(engine):
    names = ("P2AT", "Hummer")  # on rigid wheels and on springs
    starts = tuple(StartPose(tag=f"S{i}", at=(SPACING * i, 0.0, 0.188)) for i in range(len(names)))
    batch = Batch(build_scene(replace(FLAT, starts=starts), names), worlds=1, engine=engine)
    state = batch.reset(0)
    heights = [int(group.root_qposadr[0, 2]) for group in batch.scene.groups]
    for _ in range(2):  # the first episode, and one after a drive
        before = np.asarray(batch.physics(state).qpos)
        for _ in range(FIRST):
            state = batch.step(state)
            now = batch.physics(state)
            np.testing.assert_allclose(now.qpos, before, atol=1e-3)  # a camera's tilt gives way by 0.3 mrad
            np.testing.assert_allclose(np.asarray(now.qpos)[:, heights], before[:, heights], atol=1e-5)
        state = batch.drive(state, 0, {"Left": 2.0, "Right": 2.0})
        for _ in range(FIRST):
            state = batch.step(state)
        state = batch.reset_where(state, np.array([True]))


def test_standing_height_is_that_of_the_contacts():
    """A P2AT sinks by what its weight needs; what flies starts clear of the floor."""
    tree = kinematic_tree_of(ROBOTS.get("P2AT"))
    assert 0.0 < tree.clearance - standing_height(tree.robot) < 5e-4
    for name, spec in ROBOTS:
        gap = standing_height(spec) - kinematic_tree_of(spec).clearance
        if spec.drive.applies_wrench:
            assert gap == pytest.approx(START_GAP)
        else:
            assert -MAX_SINKING < gap <= 1e-5, name
