"""Effecters: what they bring along and understand (manual 8, 11), and that they grip and move things.

The physics runs on plain C MuJoCo with the product's own settings, control and operations.
"""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.handy import GRABBER, GRIPPER, block, known, operate
from tests.rig import Rig
from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.parts import joint_names, parts_of
from usarmjx.models.effecters import EFFECTERS, effecters_of
from usarmjx.models.effecters.standard import LEVER, RADIUS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import CHASSIS, UP, Motor, Mount, Part, options
from usarmjx.models.types.shapes import Shape

MM = 1e-3


@pytest.fixture(scope="module", autouse=True)
def grabber():
    with known(GRABBER):
        yield


def with_effecters(*mounts, robot=P2AT, name="Rigged", **fields):
    return replace(robot, name=name, effecters=mounts, **fields)


def only(kind, **settings):
    (effecter,) = effecters_of(with_effecters(Mount(kind=kind, name="It", options=options(**settings))))
    return effecter


# Operations


@pytest.mark.parametrize(
    ("kind", "settings", "operations"),
    [
        ("Gripper", {}, {"Open": (1.57, 0.0), "Animate": (1.57, 0.0), "Reset": (0, 0), "NOP": (0, 0)}),
        ("Gripper", {"MaxAngle": 1.0, "MinAngle": 0.1}, {"Open": (1.0, 0.1)}),
        ("RFIDReleaser", {}, {"Release": (0, 0), "TagsRemaining": (0, 0), "Reset": (0, 0), "NOP": (0, 0)}),
        ("RollerTable", {}, {"Animate": (6.0, -6.0), "Reset": (0, 0), "NOP": (0, 0)}),
        ("RollerTable", {"MaxSpeed": 3.0}, {"Animate": (3.0, -3.0)}),
        ("Headlight", {}, {"Activate": (1.0, 0.0), "Reset": (0, 0), "NOP": (0, 0)}),
    ],
)
def test_effecters_understand_what_manual_11_lists_within_the_limits_of_their_settings(
    kind, settings, operations
):
    effecter = only(kind, **settings)
    limits = {opcode.name: (opcode.max_val, opcode.min_val) for opcode in effecter.opcodes}
    assert limits | operations == limits
    if not settings:
        assert limits == operations


def test_types_and_operations_match_without_case():
    gripper = only("gRIPPER")
    assert gripper.kind == "Gripper"
    assert gripper.opcode("oPEN").name == "Open"
    assert gripper.opcode("Fire") is None
    assert gripper.is_type("gripper")
    assert gripper.is_type("EFFECTER")
    assert not gripper.is_type("RollerTable")


def test_a_releaser_carries_ten_tags_unless_set_otherwise():
    assert only("RFIDReleaser").initial_stock == 10  # manual 11.2.2
    assert only("RFIDReleaser", NumTags=3).initial_stock == 3
    assert only("Gripper").initial_stock == 0


def test_the_manuals_four_types_and_the_later_vacuum_are_registered():
    assert EFFECTERS.names() == ["Gripper", "Headlight", "RFIDReleaser", "RollerTable", "Vacuum"]


# Parts


def test_a_gripper_brings_its_fingers_behind_the_links_of_packages():
    assert joint_names(GRABBER)[-4:] == ("CameraPanTilt_Link2", "Lift_Link1", "LeftFinger", "RightFinger")
    assert {part.parent for part in parts_of(GRABBER)[-2:]} == {"Lift_Link1"}
    assert joint_names(GRABBER)[:-3] == joint_names(P2AT)


def test_two_grippers_need_fingers_of_two_names():
    second = Mount(kind="Gripper", name="Other", at=(-0.3, 0.0, 0.0))
    with pytest.raises(SpecError, match="LeftFinger, RightFinger"):
        parts_of(with_effecters(GRIPPER, second, robot=GRABBER))
    second = replace(second, options=options(LeftFinger="Thumb", RightFinger="Pinkie"))
    names = joint_names(with_effecters(GRIPPER, second, robot=GRABBER))
    assert names[-4:] == ("LeftFinger", "RightFinger", "Thumb", "Pinkie")


def test_a_gripper_uses_fingers_that_the_robot_has_and_gives_each_half_of_the_angle():
    finger = Part(
        name="LeftFinger",
        at=(0.3, -0.05, 0.0),
        axis=UP,
        motor=Motor(max_speed=1.0, torque=1.0),
        shapes=(Shape(kind="box", size=(0.05, 0.01, 0.01), at=(0.05, 0.0, 0.0), mass=0.1),),
    )
    twin = replace(finger, name="RightFinger", at=(0.3, 0.05, 0.0), axis=(0.0, 0.0, 1.0))
    robot = with_effecters(
        Mount(kind="Gripper", name="Gripper"), name="Own", parts=(*P2AT.parts, finger, twin)
    )
    assert sum("Finger" in name for name in joint_names(robot)) == 2
    assert next(p for p in parts_of(robot) if p.name == "LeftFinger") == replace(finger, looks=finger.shapes)
    with known(robot):
        rig = Rig("Own")
        assert operate(rig, "Gripper", "Open", 1.2)
        rig.run(1.5)
        angles = [rig.joint(name) for name in ("LeftFinger", "RightFinger")]
        assert angles == pytest.approx([0.6, 0.6], abs=0.01)


def test_a_gripper_that_names_no_fingers_finds_the_last_parts_on_either_side_of_its_base():
    """Manual 11.1.2; what is on the chassis or in the middle is none, and a name wins."""
    motor = Motor(max_speed=1.0, torque=1.0)
    box = (Shape(kind="box", size=(0.05, 0.01, 0.01), at=(0.05, 0.0, 0.0), mass=0.1),)

    def part(name, y, parent="Palm", x=0.05):
        return Part(name=name, parent=parent, at=(x, y, 0.0), axis=UP, motor=motor, shapes=box)

    palm = part("Palm", 0.0, CHASSIS, 0.35)
    thumbs = [
        part(name, y) for name, y in (("Old", -0.05), ("Thumb", -0.06), ("Probe", 0.02), ("Pinkie", 0.05))
    ]
    parts = (*P2AT.parts, palm, *thumbs)

    def joints(parent="Palm", **settings):
        gripper = Mount(
            kind="Gripper", name="G", parent=parent, at=(0.0, 0.02, 0.0), options=options(**settings)
        )
        (effecter,) = effecters_of(with_effecters(gripper, parts=parts))
        return effecter.joints

    assert joints() == ("Thumb", "Pinkie")
    assert joints(LeftFinger="Old") == ("Old", "Pinkie")
    assert joints(parent=CHASSIS) == ("LeftFinger", "RightFinger")
    assert joints(parent="Pinkie") == ("LeftFinger", "RightFinger"), "which it brings along"


@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.7), (0.3, -0.5, 2.0)])
def test_fingers_palm_and_rollers_turn_with_their_mount(direction):
    """Centres of the solids against the closed form: mount's place + its rotation (ZYX) x place in it."""
    roll, pitch, yaw = direction
    c, s = np.cos, np.sin
    about_z = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    about_y = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    about_x = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    mat, at = about_z @ about_y @ about_x, np.array((0.4, 0.1, -0.2))
    robot = with_effecters(
        Mount(kind="Gripper", name="Gripper", at=tuple(at), direction=direction),
        Mount(kind="RollerTable", name="Roller", at=tuple(at), direction=direction),
    )
    plan = kinematic_tree_of(robot)
    expected = {
        "LeftFinger": (0.07, -0.006, 0.0),  # behind a palm of 2 cm, half of 10 cm along, half of 12 mm out
        "RightFinger": (0.07, 0.006, 0.0),
        "Roller_1": (-0.2, 0.0, RADIUS),  # six of them, 8 cm apart, below the plane that things lie on
        "Roller_6": (0.2, 0.0, RADIUS),
    }
    for name, place in expected.items():
        body = plan.parts.index(name)
        centre = plan.geom_pos[plan.geom_body == body].mean(0)
        seen = plan.rest_pos[body] + plan.rest_mat[body] @ centre
        assert seen * (1, -1, -1) == pytest.approx(at + mat @ place, abs=1e-6), name
    added = plan.geom_pos[plan.geom_body == 0][len(P2AT.chassis) :] * (1, -1, -1)
    assert added[0] == pytest.approx(at + mat @ (0.01, 0.0, 0.0), abs=1e-6), "the palm"


@pytest.mark.parametrize(
    ("mounts", "error", "message"),
    [
        ((Mount(kind="Welder", name="W"),), UnknownNameError, "known: Gripper, Headlight"),
        ((Mount(kind="Gripper", name="G", options=options(Grip=1.0)),), UnknownNameError, "max_angle"),
        ((Mount(kind="RollerTable", name="R", options=options(MaxSpeed="fast")),), UsageError, "MaxSpeed"),
        ((Mount(kind="Headlight", name="L", parent="Mast"),), SpecError, "no part 'Mast' for Headlight L"),
        (
            (Mount(kind="Headlight", name="a"), Mount(kind="RollerTable", name="A")),
            SpecError,
            "effecters of one name",
        ),
        (
            (Mount(kind="Gripper", name="G", options=options(LeftFinger="P2ATMast")),),
            SpecError,
            r"no motor at P2ATMast \(Gripper G\)",
        ),
    ],
)
def test_mounts_that_cannot_be_are_refused_with_what_is_wrong(mounts, error, message):
    mast = Part(name="P2ATMast", shapes=(Shape(kind="sphere", size=(0.01,), mass=0.1),))
    with pytest.raises(error, match=message):
        parts_of(with_effecters(*mounts, parts=(*P2AT.parts, mast)))


# Gripping


def middle(rig, thing="loose/block", palm="r0/Lift_Link1"):
    """Where a thing is, in the axes of the part that carries the gripper [m] (3,)."""
    mujoco.mj_kinematics(rig.model, rig.data)
    hand = rig.data.body(palm)
    return hand.xmat.reshape(3, 3).T @ (rig.data.body(thing).xpos - hand.xpos)


def approach(rig):
    """Drive up to the block with open fingers until it lies between them."""
    assert operate(rig, "Gripper", "Open", 1.4)
    rig.run(1.0)
    rig.tell(Left=2.0, Right=2.0)
    while middle(rig)[0] > 0.1 and rig.data.time < 10.0:
        rig.step()
    rig.tell(Left=0.0, Right=0.0)
    rig.run(0.5)


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.57])
def test_open_moves_each_finger_as_far_out_as_half_the_angle_swings_the_lever(angle):
    rig = Rig("Grabber")
    assert operate(rig, "Gripper", "Open", angle)
    rig.run(1.5)
    fingers = [rig.joint(name) for name in ("LeftFinger", "RightFinger")]
    assert fingers == pytest.approx([LEVER * math.sin(angle / 2)] * 2, abs=0.5 * MM)
    assert operate(rig, "Gripper", "Reset")
    rig.run(1.5)
    assert rig.joint("LeftFinger") == pytest.approx(0.0, abs=0.5 * MM)


@pytest.mark.parametrize("value", [-0.1, 1.6, math.nan, math.inf])
def test_an_angle_out_of_range_fails_and_changes_nothing(value):
    rig = Rig("Grabber")
    before = rig.commands[0].target.copy()
    assert not operate(rig, "Gripper", "Open", value)
    np.testing.assert_array_equal(rig.commands[0].target, before)


def test_nop_stops_the_fingers_on_their_way():
    rig = Rig("Grabber")
    operate(rig, "Gripper", "Open", 1.57)
    rig.run(0.4)
    operate(rig, "Gripper", "NOP")
    rig.run(0.2)
    stopped = rig.joint("LeftFinger")
    assert 0.01 < stopped < 0.06
    rig.run(1.0)
    assert rig.joint("LeftFinger") == pytest.approx(stopped, abs=0.5 * MM)


@pytest.mark.every_run("0.02-0.1")
@pytest.mark.parametrize(("half", "mass"), [(0.03, 0.3), (0.02, 0.1), (0.045, 1.0)])
def test_a_gripped_block_is_lifted_carried_and_dropped(half, mass):
    """Carried by 1 m and held for 10 s. Soft contacts creep: at most 0.4 mm/s here, 8 mm in all."""
    rig = Rig("Grabber", loose=(block((0.8, 0.0), (half,) * 3, mass),))
    approach(rig)
    assert operate(rig, "Gripper", "Open", 0.0)
    rig.run(1.5)
    assert rig.joint("LeftFinger") == pytest.approx(half, abs=2 * MM), "closed on the block"
    held, low = middle(rig), rig.data.body("loose/block").xpos[2]
    rig.move({"Lift_Link1": -0.2})
    rig.run(2.0)
    assert rig.data.body("loose/block").xpos[2] > low + 0.15
    start = rig.data.qpos[rig.indices[0].root_qposadr]
    rig.tell(Left=2.0, Right=2.0)
    rig.run(1.0 / 0.26 + 0.3)
    rig.tell(Left=0.0, Right=0.0)
    rig.run(11.0)
    assert rig.data.qpos[rig.indices[0].root_qposadr] > start + 1.0
    assert np.linalg.norm(middle(rig) - held) < 8 * MM
    assert operate(rig, "Gripper", "Open", 1.4)
    rig.run(1.0)
    assert rig.data.body("loose/block").xpos[2] == pytest.approx(half, abs=2 * MM), "it lies on the floor"


def test_a_block_is_held_while_the_robot_turns_on_the_spot_and_brakes():
    """A skid-steered turn shakes the robot more than anything else that it does."""
    rig = Rig("Grabber", loose=(block((0.8, 0.02)),))
    approach(rig)
    operate(rig, "Gripper", "Open", 0.0)
    rig.run(1.0)
    held = middle(rig)
    rig.move({"Lift_Link1": -0.2})
    rig.run(1.5)
    uneven = 0.0
    for left, right in ((-3.0, 3.0), (99.0, 99.0), (0.0, 0.0)):
        rig.tell(Left=left, Right=right)
        for _ in range(75):
            rig.step()
            uneven = max(uneven, abs(rig.joint("LeftFinger") - rig.joint("RightFinger")))
    assert np.linalg.norm(middle(rig) - held) < 0.02
    assert uneven < 2 * MM, "geared fingers yield to neither side"


# Roller table


def on_the_rollers(x, half=(0.12, 0.1, 0.06), mass=2.0):
    rig = Rig("UnitLoader", loose=(block((x, 0.0, 0.341 + half[2]), half, mass),))
    rig.run(1.0)
    return rig, rig.data.body("loose/block")


@pytest.mark.parametrize("mass", [0.5, 10.0])
def test_rollers_move_what_lies_on_them_at_their_surface_speed(mass):
    rig, package = on_the_rollers(-0.05, mass=mass)
    for speed in (2.0, -3.0):
        assert operate(rig, "Roller", "Animate", speed)
        rig.run(0.5)
        before = package.xpos[0]
        rig.run(1.0)
        assert package.xpos[0] - before == pytest.approx(speed * RADIUS, rel=0.02)
    assert operate(rig, "Roller", "NOP")
    rig.run(0.5)
    before = package.xpos.copy()
    rig.run(5.0)
    np.testing.assert_allclose(package.xpos, before, atol=1 * MM)
    assert abs(rig.data.qpos[rig.indices[0].root_qposadr]) < 2 * MM, "the robot stays where it is"


def test_a_package_leaves_the_table_at_its_end():
    rig, package = on_the_rollers(0.0)
    operate(rig, "Roller", "Animate", 6.0)
    rig.run(4.0)
    assert package.xpos[0] > 0.3
    assert package.xpos[2] < 0.2, "on the floor in front of the robot"


def test_rollers_turn_no_faster_than_set_and_more_is_refused():
    rig, _ = on_the_rollers(0.0)
    assert not operate(rig, "Roller", "Animate", 6.1)
    assert not operate(rig, "Roller", "Animate", -6.1)
    assert operate(rig, "Roller", "Animate", -6.0)
    rig.run(0.5)
    before = rig.joint("Roller_3")
    rig.run(1.0)
    assert rig.joint("Roller_3") - before == pytest.approx(-6.0, rel=0.01)


def test_the_unit_loader_weighs_what_it_says_and_drives():
    robot = ROBOTS.get("UnitLoader")
    assert kinematic_tree_of(robot).mass == pytest.approx(robot.mass)
    assert kinematic_tree_of(robot).clearance == pytest.approx(robot.origin_height, abs=1 * MM)
    rig = Rig("UnitLoader").tell(Left=3.0, Right=3.0)
    rig.run(1.0)
    speed = np.linalg.norm(rig.run(1.0)[:, 3:5], axis=1).mean()
    assert speed == pytest.approx(3.0 * robot.wheel_radius, rel=0.05)
