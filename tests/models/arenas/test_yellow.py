"""DM-USAR_yellow: robots can start everywhere, get everywhere, and where the manual says."""

import itertools
import math
from collections import deque

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from tests.starts import deepest
from tests.tours import ArenaRoute
from usarmjx.base.transforms import flip_vector
from usarmjx.engines.c.batch import c_model
from usarmjx.models.arenas.yellow import CELL, ORIGIN, START_CELLS, YELLOW
from usarmjx.models.compile.kinematic_tree import servos_of
from usarmjx.models.compile.reachability import footprint_of, reach_map, victims_reached
from usarmjx.models.compile.standing import START_GAP
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.shapes import FENDER, GLASS, MIRROR
from usarmjx.sim.scene import build_scene, start_height

TABLE_2 = (4.5, 1.9, 1.8)  # manual, Table 2: start position in the yellow arena, wire axes
HEADINGS = 24
GRID = 0.05  # m, a seventh of the robot's radius
RADIUS = math.hypot(P2AT.dimensions[0] / 2, P2AT.dimensions[1] / 2)  # turns on the spot within it
LOW = 0.06  # m: boards and platform; test_a_p2at_drives_over_the_boards shows the P2AT's reach
LOOP = (
    (3, 1), (4, 1), (5, 1), (6, 1), (6, 2), (6, 3), (7, 3), (7, 4), (6, 4), (6, 5), (6, 6), (7, 6),
    (7, 7), (6, 7), (5, 7), (4, 7), (4, 6), (5, 6), (5, 5), (5, 4), (4, 4), (4, 3), (3, 3), (3, 2),
)  # fmt: skip
"""Cells around a block of walls, each beside the next."""
OVER_BOARDS = {(7, 0), (8, 0), (8, 1), (7, 2), (8, 2), (9, 3)}
"""Cells that can only be reached over a board or the platform."""


@pytest.fixture(scope="module")
def scene():
    return build_scene("yellow", ["P2AT"])


def place(scene, data, x, y, yaw):
    mujoco.mj_resetData(scene.model, data)
    root = data.joint("r0/root").qpos
    # Clear of the floor, in which robots stand by 0.1 mm: only walls may be touched.
    root[:3] = x, y, start_height(scene.arena, scene.arena.starts[0], P2AT) + START_GAP
    root[3:] = math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)
    mujoco.mj_kinematics(scene.model, data)
    mujoco.mj_comPos(scene.model, data)


def test_the_manuals_start_position_is_just_above_the_floor():
    x, y, z = flip_vector(TABLE_2)
    assert (x, y) == YELLOW.starts[0].at[:2]
    gap = z - P2AT.origin_height - YELLOW.floor
    assert 0.0 <= gap <= 0.05


def test_starts_are_at_the_editors_height_and_have_their_own_tags():
    assert {start.at[2] for start in YELLOW.starts} == {0.188}  # manual 5.3.5
    assert len({start.tag for start in YELLOW.starts}) == len(YELLOW.starts) == 1 + len(START_CELLS)


def test_starts_are_at_least_0_6_m_apart():
    spots = [start.at[:2] for start in YELLOW.starts]
    assert min(math.dist(a, b) for a, b in itertools.combinations(spots, 2)) >= 0.6


def test_a_p2at_fits_every_start_in_any_heading(scene):
    data = mujoco.MjData(scene.model)
    for start in YELLOW.starts:
        for yaw in start.yaw + np.linspace(0, 2 * math.pi, HEADINGS, endpoint=False):
            place(scene, data, *start.at[:2], yaw)
            mujoco.mj_collision(scene.model, data)
            assert data.ncon == 0, (start, yaw, [list(pair) for pair in data.contact.geom])


def test_the_collision_check_above_can_fail(scene):
    data = mujoco.MjData(scene.model)
    place(scene, data, ORIGIN[0] + CELL, ORIGIN[1] + 3.5 * CELL, 0.0)  # on a grid line with a gap
    mujoco.mj_collision(scene.model, data)
    free = data.ncon
    place(scene, data, ORIGIN[0], ORIGIN[1] + 3.5 * CELL, 0.0)  # in the outer wall
    mujoco.mj_collision(scene.model, data)
    assert (free, data.ncon > 0) == (0, True)


def footprint(shape):
    """Half lengths on the floor; the only turned shapes are ramps along x."""
    along, across, thick = shape.size
    pitch = shape.rotation[1]
    return along * abs(math.cos(pitch)) + thick * abs(math.sin(pitch)), across


def reached(shapes):
    """The grid cells that a P2AT's centre reaches from the first start without touching `shapes`."""
    (x0, x1), (y0, y1) = YELLOW.extent
    x, y = np.meshgrid(np.arange(x0 + GRID / 2, x1, GRID), np.arange(y0 + GRID / 2, y1, GRID), indexing="ij")
    free = np.ones_like(x, bool)
    for shape in shapes:
        half_x, half_y = footprint(shape)
        beside = np.maximum(np.abs(x - shape.at[0]) - half_x, 0)
        before = np.maximum(np.abs(y - shape.at[1]) - half_y, 0)
        free &= np.hypot(beside, before) > RADIUS

    def index(spot):
        return int((spot[0] - x0) / GRID), int((spot[1] - y0) / GRID)

    queue, seen = deque([index(YELLOW.starts[0].at)]), np.zeros_like(free)
    while queue:
        i, j = queue.popleft()
        inside = 0 <= i < x.shape[0] and 0 <= j < x.shape[1]
        if inside and free[i, j] and not seen[i, j]:
            seen[i, j] = True
            queue.extend([(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)])
    places = {cell: seen[index(s.at)] for cell, s in zip(START_CELLS, YELLOW.starts[1:], strict=True)}
    return {cell for cell, there in places.items() if there}


def low(shape):
    return shape.rotation == (0.0, 0.0, 0.0) and shape.at[2] + shape.size[2] <= LOW


def test_every_start_can_be_reached_from_every_other():
    assert reached([s for s in YELLOW.shapes if not low(s)]) == set(START_CELLS)


def test_only_the_cells_behind_the_boards_need_driving_over_them():
    assert set(START_CELLS) - reached(YELLOW.shapes) == OVER_BOARDS


def climb(model, start, yaw):
    """Where a P2AT at 3 rad/s, half its top speed, has got to after 6 s, in cells, and its up axis."""
    scene = build_scene("yellow", ["P2AT"])
    data = mujoco.MjData(model)
    place(scene, data, *(o + (c + 0.5) * CELL for o, c in zip(ORIGIN, start, strict=True)), yaw)
    wheels = slice(len(P2AT.wheels))
    team = scene.groups[0]
    targets, joints = team.actadr[0, wheels], team.qposadr[0, wheels]
    servos = servos_of(P2AT)
    lead, slack = servos.lead[wheels], servos.windup_limit[wheels]
    data.ctrl[team.hold_actuator_ids[0]] = 1.0
    data.ctrl[team.actuator_ids[0, wheels]] = 3.0
    for _ in range(1200):
        mujoco.mj_step(model, data)
        at = data.qpos[joints] + lead * data.qvel[team.dofadr[0, wheels]]
        data.act[targets] = np.clip(data.act[targets], at - slack, at + slack)
    chassis = data.body("r0/chassis")
    return (chassis.xpos[:2] - ORIGIN) / CELL, chassis.xmat[8]


@pytest.mark.parametrize(
    ("start", "yaw", "goal"),
    [
        ((5, 0), 0.0, 6.8),  # the board lies across the middle of column 6
        ((7, 3), 0.0, 8.7),  # likewise; behind it is a wall
        ((10, 3), math.pi / 2, 4.7),  # on the platform, as far as the wall behind it
    ],
    ids=["board in column 6", "board in column 8", "platform"],
)
def test_a_p2at_drives_over_the_boards(scene, start, yaw, goal):
    at, up = climb(c_model(scene.model), start, yaw)
    assert at[1 if yaw else 0] > goal
    assert up > 0.95  # behind two of them it pushes a wall for the rest of the time


def test_ramps_rise_out_of_the_floor_at_15_degrees(scene):
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    column, row = 2, 7  # uphill along +x, 1.1 m long in plan
    x, y = ORIGIN[0] + (column + 0.5) * CELL, ORIGIN[1] + (row + 0.5) * CELL
    heights = []
    for along in (-0.5, 0.0, 0.5):
        top, down = np.array([x + along, y, YELLOW.floor + 2.0]), np.array([0.0, 0.0, -1.0])
        robot = scene.model.body("r0/chassis").id
        distance = mujoco.mj_ray(scene.model, data, top, down, None, 1, robot, np.zeros(1, np.int32))
        heights.append(2.0 - distance)
    # Its low edge lies 0.55 m before the centre, and behind that by the tilt of half the thickness.
    edge = 0.55 + 0.1 * math.sin(math.radians(15))
    expected = [(edge + along) * math.tan(math.radians(15)) for along in (-0.5, 0.0, 0.5)]
    np.testing.assert_allclose(heights, expected, atol=1e-6)


def centre(cell):
    return tuple(o + (c + 0.5) * CELL for o, c in zip(ORIGIN, cell, strict=True))


def test_a_p2at_drives_around_a_loop_of_24_cells_and_touches_nothing():
    """28.8 m by way points, past the pane and the mirror; walls leave it 0.3 m on each side."""
    rig = Rig("P2AT", arena=YELLOW, places=((*centre(LOOP[0]), 0.0),))
    tour = ArenaRoute(rig)
    assert tour.to([centre(cell) for cell in (*LOOP[1:], LOOP[0])], speed=0.5, limit=15.0)
    driven = np.hypot(*np.diff(tour.path[:, :2], axis=0).T).sum()
    assert driven > 0.9 * CELL * len(LOOP), "it cuts corners by the 0.12 m that is near enough"
    assert tour.touched == 0.0
    assert tour.path[:, 3].min() > 0.99


def test_the_tour_above_would_notice_a_wall():
    rig = Rig("P2AT", arena=YELLOW, places=((*centre((6, 6)), math.pi),))
    tour = ArenaRoute(rig)
    assert not tour.to([centre((5, 6))], limit=5.0), "there is a wall between"
    assert tour.touched > 1.0


@pytest.mark.parametrize("name", YELLOW.robots)
def test_starts_are_clear_of_contents_too(name):
    assert max(deepest(YELLOW, name).values()) == 0.0


def test_there_is_what_the_manual_names():
    """Manual 3.2.1.1 and 14.1: glass, mirrors, grid fenders; victims that wave, or lie still; obstacles."""
    assert {GLASS, MIRROR, FENDER} <= {shape.material for shape in YELLOW.shapes}
    assert len(YELLOW.victims) == 3
    assert any(segment.rates[2] > 0 for segment in YELLOW.victims[0].segments)
    assert 1 <= len(YELLOW.loose) <= 6
    assert YELLOW.false_alarms
    assert YELLOW.tags


def test_p2ats_get_near_every_victim_and_tag_with_all_loose_things_in_place():
    size = footprint_of(P2AT)
    reach = reach_map(YELLOW, size.radius, size.step)
    assert victims_reached(YELLOW, reach) == [True] * len(YELLOW.victims), "within a metre of a part"
    for tag in YELLOW.tags:
        assert reach.reaches_within(*tag.at[:2], 0.5), tag
    assert all(reach.reachable(*start.at[:2]) for start in YELLOW.starts)


def test_the_board_hides_the_victim_from_the_side_but_not_from_below():
    model = build_scene(YELLOW, ["P2AT"]).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    bone = {model.geom(g).name for g in range(model.ngeom) if model.geom(g).name.startswith("victim/")}

    def seen(x, y):
        victim = next(victim for victim in YELLOW.victims if victim.name == "Hidden")
        start = np.array([x, y, YELLOW.floor + 0.3])
        way = np.array([*victim.at[:2], YELLOW.floor + 0.25]) - start
        geom = np.zeros(1, np.int32)
        robot = model.body("r0/chassis").id
        mujoco.mj_ray(model, data, start, way, None, 1, robot, geom)
        return model.geom(geom[0]).name in bone

    assert not seen(7.3, 1.9)
    assert seen(8.0, 0.8)


def test_loose_things_lie_still():
    rig = Rig("P2AT", arena=YELLOW, places=((*centre((0, 0)), 0.0),))
    before = {loose.name: rig.data.joint(f"loose/{loose.name}").qpos.copy() for loose in YELLOW.loose}
    rig.run(3.0)
    for name, pose in before.items():
        now = rig.data.joint(f"loose/{name}").qpos
        assert np.linalg.norm(now[:3] - pose[:3]) < 0.005, name
