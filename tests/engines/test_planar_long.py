"""Engine `planar`: no robot of any class gets into a wall or another in a million random steps."""

import math
from dataclasses import replace

import numpy as np
import pytest

from usarmjx.engines.planar.bodies import footprint_box
from usarmjx.engines.planar.footprints import OVERLAP_TOLERANCE
from usarmjx.engines.planar.responses import rolls
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

ROBOTS_IN_A_PEN, PENS = 4, 500
STEPS, LOOK = 500, 10
"""Control steps, and how often all robots are looked at."""
SIGNS = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])
PILLARS = (((0.9, 0.6), (0.6, 0.05), 0.5), ((-0.9, -0.4), (0.05, 0.7), -0.3))
"""Walls inside: middles, half sides and headings, in robots."""


CASES = [(name, 0.05, 0.5) for name, robot in ROBOTS if rolls(robot.drive)]
CASES += [(name, period, 2.0) for name in ("AirRobot", "Passarola") for period in (0.02, 0.05)]
"""Classes, control steps and how long orders stand [s]: what flies takes long to get anywhere."""


def pen_of(robot):
    """A pen some robots wide, and its walls as rectangles: middles, headings, half sides."""
    low, high = footprint_box(robot)
    size = float(np.abs([low[:2], high[:2]]).max(0) @ [1, 1]) / 2 + 0.1
    wide = 5 * size
    walls = [
        ((x * wide, y * wide), (0.05 + wide * abs(y), 0.05 + wide * abs(x)), 0.0)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    walls += [
        ((x * size, y * size), (half[0] * size + 0.03, half[1] * size + 0.03), yaw)
        for (x, y), half, yaw in PILLARS
    ]
    corners = 3.2 * size * SIGNS
    starts = tuple(
        StartPose(tag=f"S{i}", at=(float(x), float(y), -float(low[2])), yaw=0.7 * i)
        for i, (x, y) in enumerate(corners)
    )
    shapes = tuple(
        Shape(kind="box", size=(*half, 50.0), at=(*at, 49.0), rotation=(0.0, 0.0, yaw), surface="wall")
        for at, half, yaw in walls
    )
    room = ((-wide - 1, wide + 1),) * 2
    middles, halves, yaws = (np.array(part) for part in zip(*walls, strict=True))
    return ArenaSpec(name="pen", starts=starts, extent=room, shapes=shapes), (middles, yaws, halves), wide


def corners_of(middle, yaw, half):
    """Corners of rectangles (..., 4, 2)."""
    c, s = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    own = SIGNS * half[..., None, :]
    turned = np.stack([c * own[..., 0] - s * own[..., 1], s * own[..., 0] + c * own[..., 1]], -1)
    return turned + middle[..., None, :]


def depth(a, b):
    """How deep rectangles (..., 4, 2) are in each other, by separating axes; negative: apart."""
    least = np.inf
    for corners in (a, b):
        for i in range(2):
            edge = corners[..., i + 1, :] - corners[..., i, :]
            axis = np.stack([-edge[..., 1], edge[..., 0]], -1) / np.linalg.norm(edge, axis=-1)[..., None]
            one, other = ((x * axis[..., None, :]).sum(-1) for x in np.broadcast_arrays(a, b))
            overlap = np.minimum(one.max(-1), other.max(-1)) - np.maximum(one.min(-1), other.min(-1))
            least = np.minimum(least, overlap)
    return least


def deepest(root, robot, walls):
    """How deep the worst of robots (worlds, robots, 7) is in a wall or another one."""
    low, high = footprint_box(robot)
    w, x, y, z = np.moveaxis(root[..., 3:], -1, 0)
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    offset, half = (low + high)[:2] / 2, (high - low)[:2] / 2
    c, s = np.cos(yaw), np.sin(yaw)
    middle = root[..., :2] + np.stack([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]], -1)
    robots = corners_of(middle, yaw, np.broadcast_to(half, middle.shape))
    worst = depth(robots[:, :, None], corners_of(*walls)).max()
    for i in range(ROBOTS_IN_A_PEN):
        for j in range(i):
            level = high[2] - low[2] - np.abs(root[:, i, 2] - root[:, j, 2])
            worst = max(worst, np.minimum(depth(robots[:, i], robots[:, j]), level).max())
    return worst


@pytest.mark.slow
@pytest.mark.parametrize(("name", "period", "stand"), CASES)
def test_nobody_gets_into_anything_in_a_million_random_steps(name, period, stand):
    robot = replace(ROBOTS.get(name), sensors=(), cameras=(), battery_life=1e6)
    arena, walls, wide = pen_of(robot)
    order = round(stand / period)
    scene = build_scene(arena, [robot] * ROBOTS_IN_A_PEN, Physics(timestep=period, substeps=1))
    batch = Batch(scene, PENS, engine="planar")
    group, rng = scene.groups[0], np.random.default_rng(0)
    state, limits, met = batch.reset(), robot.drive.limits, np.zeros((PENS, ROBOTS_IN_A_PEN), int)
    told = rng.uniform(
        -1.0, 1.0, (math.ceil(STEPS / order), len(limits), PENS, ROBOTS_IN_A_PEN)
    ) * np.reshape(limits, (-1, 1, 1))
    worst = -math.inf
    for step in range(STEPS):
        if step % order == 0:
            keys = zip(robot.drive.keys, told[step // order].astype(np.float32), strict=True)
            state = batch.drive(state, 0, dict(keys))
        state = batch.step(state)
        if step % LOOK == LOOK - 1:
            root = np.asarray(batch.physics(state).qpos)[:, group.root_qposadr]
            worst = max(worst, deepest(root.astype(float), robot, walls))
            met += np.asarray(state.physics.touched)
    assert worst <= OVERLAP_TOLERANCE + 2e-4
    assert (met > 0).mean() > 0.3, "many have met something"
    assert np.abs(root[..., :2]).max() < wide, "nobody has left"
    assert np.isfinite(root).all()
    print(f"{name}: {PENS * ROBOTS_IN_A_PEN * STEPS:,} robot steps, deepest {1e3 * worst:.2f} mm")
