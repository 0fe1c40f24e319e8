"""What robots are drawn as: solids of their own, which neither physics nor range sensors ever meet."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import mujoco
import numpy as np
import pytest

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import SpecError
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import forward_kinematics, kinematic_tree_of
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.visuals import Solids, solid_extents
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.kit import Belt, block, hull
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import Part, RobotSpec
from usarmjx.models.types.shapes import GLASS

NOWHERE = ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0)))
ALL = [pytest.param(ROBOTS.get(name), id=name) for name in ROBOTS.names()]
STEPS = 20


def naked(robot: RobotSpec) -> RobotSpec:
    """The robot, drawn as its solids."""
    packages = tuple(
        replace(package, links=tuple(replace(link, looks=()) for link in package.links))
        for package in robot.packages
    )
    parts = tuple(replace(part, looks=()) for part in robot.parts)
    return replace(robot, looks=(), parts=parts, packages=packages)


def built(robot: RobotSpec) -> mujoco.MjModel:
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    return spec.compile()


def driven(model: mujoco.MjModel) -> np.ndarray:
    """Where it is after some steps with all motors on."""
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.3
    mujoco.mj_step(model, data, STEPS)
    return np.concatenate([data.qpos, data.qvel])


@pytest.mark.parametrize("robot", ALL)
def test_physics_is_the_same_to_the_bit_without_looks(robot):
    drawn, bare = built(robot), built(naked(robot))
    for name in ("nv", "ngeom", "nbody", "nu", "nmesh"):
        assert getattr(drawn, name) == getattr(bare, name)
    for name in ("body_mass", "body_inertia", "geom_size", "geom_pos", "geom_quat", "geom_contype"):
        assert np.array_equal(getattr(drawn, name), getattr(bare, name)), name
    assert np.array_equal(driven(drawn), driven(bare))


@pytest.mark.parametrize("robot", ALL)
def test_every_class_has_looks_of_its_own_in_valid_colours(robot):
    assert robot.looks, "the chassis is drawn"
    plan = kinematic_tree_of(robot)
    drawn = plan.visuals.solids
    assert len(drawn.kind) > len(plan.geom_type)
    assert set(drawn.frame) <= set(range(len(plan.parts)))
    assert np.isfinite(drawn.pos).all()
    assert (drawn.rgb >= 0).all()
    assert (drawn.rgb <= 1).all()
    looks = [*robot.looks, *(solid for part in parts_of(robot) for solid in part.looks)]
    assert all(len(solid.rgba) == 4 and 0 <= min(solid.rgba) <= max(solid.rgba) <= 1 for solid in looks)


def extent(robot: RobotSpec, solids: Solids) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest corner of the box about solids of a robot with its joints at zero."""
    plan = kinematic_tree_of(robot)
    pos, mat = solids.poses(plan.rest_pos, plan.rest_frames)
    low, high = solid_extents(solids, np.asarray(mat))
    return (pos + low).min(0), (pos + high).max(0)


@pytest.mark.parametrize("robot", ALL)
def test_a_robot_is_drawn_where_sensors_meet_it_and_about_as_large(robot):
    plan = kinematic_tree_of(robot)
    (low, high), (met_low, met_high) = (extent(robot, one) for one in (plan.visuals.solids, plan.solids))
    room = 0.12 * max(robot.dimensions)
    assert (low[:2] > met_low[:2] - room).all(), "but for masts and antennas, which stand above it"
    assert (high[:2] < met_high[:2] + room).all()
    assert (high - low > 0.75 * (met_high - met_low)).all()
    assert abs(low[2] - met_low[2]) < 0.03 * max(robot.dimensions), "it stands on the same ground"


def poses_at(robot: RobotSpec, angle: float, moved: Callable[[Part], bool]):
    """Where a robot's drawn solids are with some of its joints at an angle; numpy arrays."""
    plan, zero = kinematic_tree_of(robot), np.zeros(3)
    turned = np.array([angle * moved(part) for part in parts_of(robot)])
    with numpy_backend():
        state = RobotState(
            pos=zero,
            quat=np.array([1.0, 0.0, 0.0, 0.0]),
            linear=zero,
            angular=zero,
            joint_pos=turned,
            joint_vel=np.zeros(len(turned)),
        )
        bodies = forward_kinematics(plan, state)
        return plan, *plan.visuals.solids.poses(bodies.pos, bodies.mat)


@pytest.mark.parametrize("name", [name for name in ROBOTS.names() if ROBOTS.get(name).wheels])
def test_the_turning_of_wheels_shows(name):
    """What is round about an axle looks the same when it turns: wheels have spokes or cleats as well."""
    robot = ROBOTS.get(name)
    plan, _, before = poses_at(robot, 0.0, lambda part: part.is_wheel)
    _, _, after = poses_at(robot, 0.35, lambda part: part.is_wheel)
    wheels = {part.name for part in robot.wheels}
    solids, box = plan.visuals.solids, int(mujoco.mjtGeom.mjGEOM_BOX)
    bars = np.array([plan.parts[frame] in wheels for frame in solids.frame]) & (solids.kind == box)
    shown = {plan.parts[frame] for frame in solids.frame[bars]}
    assert len(shown) >= len(wheels) / 2, "of tracks, at least every other wheel"
    turned = np.einsum("gij,gij->g", before[bars], after[bars])  # the trace of a turn by 0.35 rad
    assert turned == pytest.approx(1 + 2 * math.cos(0.35), abs=1e-5)


def test_cleats_reach_as_far_as_the_wheel_that_drives_and_the_belt_stays_below():
    belt = Belt(radius=0.1, max_spin=1.0, width=0.1, max_pull=1.0, inertia=1.0, wheel_mass=1.0, cleat=0.01)
    part = belt.driven(belt.wheel("W", (0.0, 0.0, 0.0), 0.1))
    bars = [solid for solid in part.looks if solid.kind == "box"]
    assert len(bars) >= 3
    assert {solid.size[0] for solid in bars} == {0.1}
    ends = [solid for solid in belt.looks((0.3, 0.0, 0.0), (-0.3, 0.0, 0.0)) if solid.kind == "cylinder"]
    assert [solid.size[0] for solid in ends] == pytest.approx([0.09, 0.09])


def test_kurt3ds_scanner_is_drawn_on_the_part_that_tilts_it():
    plan, before, _ = poses_at(ROBOTS.get("Kurt3D"), 0.0, lambda part: part.name == "ScannerSides")
    _, after, _ = poses_at(ROBOTS.get("Kurt3D"), 0.3, lambda part: part.name == "ScannerSides")
    sides = plan.parts.index("ScannerSides")
    own = plan.visuals.solids.frame == sides
    assert own.sum() >= 6
    assert np.linalg.norm(np.asarray(after - before), axis=-1)[own].max() > 0.01
    assert not np.asarray(after - before)[~own].any()


def test_a_mesh_of_a_look_lies_where_its_corners_say_in_the_axes_of_the_description():
    corners = [(0.1, 0.2, 0.3), (0.3, 0.2, 0.3), (0.1, 0.4, 0.3), (0.1, 0.2, 0.7)]
    robot = replace(ROBOTS.get("ComStation"), name="Meshed", looks=(hull(corners),))
    solids = kinematic_tree_of(robot).visuals.solids
    first = solids.pos[solids.frame == 0]  # corners of triangles; y and z are ours
    want = {(x, -y, -z) for x, y, z in corners}
    assert {tuple(np.round(row.astype(float), 5)) for row in first} <= want


def test_looks_that_light_would_pass_are_refused():
    pane = replace(block((0.1, 0.1, 0.1)), material=GLASS)
    robot = replace(ROBOTS.get("ComStation"), name="Pane", looks=(pane,))
    with pytest.raises(SpecError, match="opaque, not 'glass'"):
        _ = kinematic_tree_of(robot).visuals


def test_classes_of_a_kind_differ_in_colour():
    """From above one tells a P2AT from a StereoP2AT, and a Hummer from a Sedan."""
    colours = {name: {solid.rgba for solid in ROBOTS.get(name).looks} for name in ROBOTS.names()}
    known = set().union(*colours.values())
    usual = {colour for colour in known if sum(colour in own for own in colours.values()) > 4}
    small, cars = (
        ("P2AT", "StereoP2AT", "OmniP2AT", "ATRVJr", "Zerg"),
        ("Hummer", "SnowStorm", "Sedan", "Cooper"),
    )
    for kind in (small, cars):
        own = [{c for c in colours[name] - usual if np.ptp(c[:3]) > 0.04} for name in kind]
        assert all(own)
        for one, other in combinations(own, 2):
            assert one - other
            assert other - one
