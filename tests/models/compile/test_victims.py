"""Victims against a kinematic chain worked out by hand with SciPy's rotations, and closed forms of motion."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from usarmjx.base.errors import SpecError
from usarmjx.models.compile.victims import (
    BODY_HEIGHT,
    BONES,
    PADDING_OWNER,
    PART_NAMES,
    PART_OF_BONE,
    POSTURES,
    box_names,
    loudness,
    lowest_points,
    mouth_positions,
    pad_table,
    rest_height,
    segment_angles,
    segment_poses,
    segment_speeds,
    victim_table,
)
from usarmjx.models.types.arena import FalseAlarm, HelpSound, SegmentMotion, Victim

FLOAT32_ATOL = 2e-6  # m: some ten roundings of lengths of 3 m
SIGNS = 2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1
quick = settings(deadline=None)
WAVING = Victim(
    name="waving",
    at=(1.0, -2.0, 0.6),
    rotation=(0.2, -0.1, 2.0),
    posture="sitting",
    segments=(
        SegmentMotion(name="Chest", initial=(0.0, 0.0, 0.0), final=(0.4, -0.3, 0.2), rates=(0.5, 0.3, 0.1)),
        SegmentMotion(
            name="LeftArm", initial=(-2.8, 0.1, 0.4), final=(-1.2, 0.5, 1.6), rates=(2.0, 0.0, 3.0)
        ),
        SegmentMotion(
            name="LeftHand", initial=(0.0, 0.0, -1.0), final=(0.0, 0.0, 1.0), rates=(0.0, 0.0, 4.0)
        ),
        SegmentMotion(name="RightLeg", initial=(-1.0, 0.0, -0.5), scale=0.5),
    ),
    anim_timer=0.7,
)
PLAIN = Victim(name="plain", at=(4.0, 0.0, 0.12), posture="lying")
ALARM = FalseAlarm(part="LeftHand", at=(0.0, 3.0, 0.1), rotation=(0.3, 0.2, 0.1), scale=2.0)


def rows(victim):
    return [name.split("/")[1] for name in box_names([victim])]


# --- kinematics ---------------------------------------------------------------------------------


def wave(first, last, rate, time):
    """A triangle wave, one leg after the other."""
    span = abs(last - first)
    if span == 0 or rate == 0:
        return first
    legs, rest = divmod(rate * time, span)
    gone = rest if legs % 2 == 0 else span - rest
    return first + math.copysign(gone, last - first)


def by_hand(victim, bone, time):
    """Centre and rotation of a bone: along its chain, one at a time, in double precision."""
    chain = [bone]
    while BONES[chain[0]].parent is not None:
        chain.insert(0, BONES[chain[0]].parent)
    own = {segment.name: segment for segment in victim.segments}
    pos, turn = np.array(victim.at), Rotation.from_euler("ZYX", victim.rotation[::-1])
    scale = BODY_HEIGHT
    for name in chain:
        pos = pos + turn.apply(scale * np.array(BONES[name].joint))
        pose = POSTURES[victim.posture].get(name, (0.0, 0.0, 0.0))
        segment = own.get(name, SegmentMotion(name=name, initial=pose, final=pose))
        scale *= segment.scale
        moves = zip(segment.initial, segment.final, segment.rates, strict=True)
        pitch, yaw, roll = (wave(a, b, victim.anim_timer * rate, time) for a, b, rate in moves)
        turn = turn * Rotation.from_euler("ZYX", (yaw, pitch, roll))
    return pos + turn.apply(scale * np.array(BONES[name].offset)), turn, scale * np.array(BONES[name].half)


@pytest.mark.oracle
@pytest.mark.parametrize("victim", [WAVING, PLAIN], ids=lambda victim: victim.name)
@pytest.mark.parametrize("time", [0.0, 0.37, 1.9, 7.3])
def test_every_box_is_where_the_chain_of_its_joints_puts_it(victim, time):
    table = victim_table([victim])
    pos, quat = segment_poses(table, time)
    for row, bone in enumerate(rows(victim)):
        centre, turn, half = by_hand(victim, bone, time)
        np.testing.assert_allclose(pos[row], centre, atol=FLOAT32_ATOL)
        np.testing.assert_allclose(table.size[row], half, atol=FLOAT32_ATOL)
        w, x, y, z = quat[row]
        np.testing.assert_allclose(Rotation((x, y, z, w)).as_matrix(), turn.as_matrix(), atol=FLOAT32_ATOL)


def test_positive_pitch_bends_forward_and_positive_yaw_turns_left():
    bent = Victim(
        name="bent",
        at=(0.0, 0.0, 0.0),
        posture="standing",
        segments=(SegmentMotion(name="Chest", initial=(math.pi / 2, 0.0, 0.0)),),
    )
    pos, _ = segment_poses(victim_table([bent]), 0.0)
    head = pos[rows(bent).index("Head")]
    np.testing.assert_allclose(
        head, [BODY_HEIGHT * (0.198 + 0.091), 0.0, BODY_HEIGHT * 0.07], atol=FLOAT32_ATOL
    )
    left = pos[rows(bent).index("LeftLeg")]
    assert left[1] > 0 > pos[rows(bent).index("RightLeg")][1]
    turned = Victim(name="turned", at=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, math.pi / 2), posture="standing")
    pos, _ = segment_poses(victim_table([turned]), 0.0)
    np.testing.assert_allclose(
        pos[rows(turned).index("LeftFoot")][:2],
        [-0.048 * BODY_HEIGHT, 0.046 * BODY_HEIGHT],
        atol=FLOAT32_ATOL,
    )


@quick
@given(
    first=st.floats(-3.0, 3.0),
    last=st.floats(-3.0, 3.0),
    rate=st.floats(0.0, 5.0),
    timer=st.floats(0.0, 2.0),
    time=st.floats(0.0, 30.0),
    axis=st.integers(0, 2),
)
def test_angles_go_to_and_fro_between_their_ends_at_their_rate(first, last, rate, timer, time, axis):
    def only(value):
        return tuple(value if i == axis else 0.0 for i in range(3))

    segment = SegmentMotion(name="Head", initial=only(first), final=only(last), rates=only(rate))
    table = victim_table([Victim(name="v", at=(0, 0, 0), segments=(segment,), anim_timer=timer)])
    angles, rates = segment_angles(table, time)
    head = 2
    assert min(first, last) - 1e-6 <= angles[head, axis] <= max(first, last) + 1e-6
    speed = timer * rate
    if abs(last - first) > 0.05:
        # float32: a phase of up to 300 rad; near a turn the wave is continuous, so no more than that is lost
        assert angles[head, axis] == pytest.approx(wave(first, last, speed, time), abs=2e-4)
        assert abs(rates[head, axis]) == pytest.approx(speed, rel=1e-6)
    others = [i for i in range(3) if i != axis]
    assert np.all(angles[head, others] == 0)
    assert np.all(rates[head, others] == 0)


@pytest.mark.parametrize("time", [0.21, 1.03, 3.3])
def test_speeds_are_those_of_the_fastest_corners(time):
    """Between the turning points; central differences of the scalar chain in double precision."""
    table, step = victim_table([WAVING]), 1e-4
    speed = segment_speeds(table, time)

    def corners(bone, moment):
        pos, turn, half = by_hand(WAVING, bone, moment)
        return np.array([pos + turn.apply(half * signs) for signs in SIGNS])

    for row, bone in enumerate(rows(WAVING)):
        moved = corners(bone, time + step) - corners(bone, time - step)
        expected = np.linalg.norm(moved, axis=-1).max() / (2 * step)
        # a step of 0.01 s at 3 rad/s: 2e-4 of the speed; float32's 2e-7 m over 0.02 s
        assert speed[row] == pytest.approx(expected, abs=1e-3)
    assert speed.max() > 0.5


def test_who_does_not_move_has_neither_speed_nor_swing():
    table = victim_table([PLAIN], [ALARM])
    assert np.all(segment_speeds(table, 3.0) == 0)
    assert np.all(table.swing == 0)
    frozen = victim_table([Victim(**{**vars(WAVING), "anim_timer": 0.0})])
    assert np.all(segment_speeds(frozen, 3.0) == 0)
    assert np.all(frozen.swing == 0)


def test_swing_is_how_far_a_box_gets():
    """An arm of 0.332 H raised by half a turn: its end goes from hanging to straight up."""
    up = SegmentMotion(name="LeftArm", initial=(0, 0, 0), final=(-math.pi, 0, 0), rates=(1, 0, 0))
    victim = Victim(name="v", at=(0, 0, 0), posture="standing", segments=(up,))
    swing = dict(zip(rows(victim), victim_table([victim]).swing, strict=True))
    assert swing["LeftArm"] == pytest.approx(2 * math.hypot(0.332, 0.026) * BODY_HEIGHT, rel=1e-5)
    assert swing["LeftHand"] == pytest.approx(2 * math.hypot(0.332 + 0.108, 0.024) * BODY_HEIGHT, rel=1e-5)
    assert swing["RightArm"] == swing["Chest"] == 0


def test_a_shaken_head_moves_though_its_centre_stays():
    shake = SegmentMotion(name="Head", initial=(0, -0.5, 0), final=(0, 0.5, 0), rates=(0, 2, 0))
    victim = Victim(name="v", at=(0, 0, 0), posture="standing", segments=(shake,))
    table, corner = victim_table([victim]), math.hypot(0.055, 0.044) * BODY_HEIGHT
    head = rows(victim).index("Head")
    assert table.swing[head] == pytest.approx(2 * corner * math.sin(0.5), rel=1e-5)
    assert segment_speeds(table, 0.1)[head] == pytest.approx(2 * corner, rel=1e-3)


# --- the body -----------------------------------------------------------------------------------


def test_an_adult_stands_1_75_m_tall_on_the_ground():
    """At the anthropometric heights of Drillis and Contini."""
    victim = Victim(name="v", at=(0.0, 0.0, rest_height("standing")), posture="standing")
    table = victim_table([victim])
    pos, _ = segment_poses(table, 0.0)
    at = dict(zip(rows(victim), zip(pos, table.size, strict=True), strict=True))
    assert lowest_points(table, 0.0).min() == pytest.approx(0.0, abs=1e-6)
    centre, half = at["Head"]
    assert centre[2] + half[2] == pytest.approx(1.75, abs=1e-6)
    for bone, top in {"LeftLeg": 0.530, "LeftFoot": 0.039, "LeftArm": 0.818, "Chest": 0.818}.items():
        centre, half = at[bone]
        assert centre[2] + half[2] == pytest.approx(top * 1.75, abs=1e-6), bone
    centre, half = at["LeftHand"]
    assert centre[2] - half[2] == pytest.approx((0.818 - 0.332 - 0.108) * 1.75, abs=1e-6)


@pytest.mark.parametrize("posture", ["lying", "sitting", "crouched"])
def test_whoever_does_not_stand_rests_with_the_pelvis_on_the_ground(posture):
    victim = Victim(name="v", at=(0.0, 0.0, rest_height(posture)), posture=posture)
    low = lowest_points(victim_table([victim]), 0.0)
    assert low.min() == pytest.approx(0.0, abs=1e-6)
    assert low[rows(victim).index("Pelvis")] < 0.02
    pos, _ = segment_poses(victim_table([victim]), 0.0)
    assert pos[:, 2].max() < (0.3 if posture == "lying" else 1.0)


def test_lying_is_on_the_back_with_the_head_behind():
    victim = Victim(name="v", at=(0.0, 0.0, 0.0), posture="lying")
    pos, quat = segment_poses(victim_table([victim]), 0.0)
    assert pos[rows(victim).index("Head")][0] < -0.5
    assert pos[rows(victim).index("LeftFoot")][0] > 0.7
    w, x, y, z = quat[rows(victim).index("Chest")]
    np.testing.assert_allclose(Rotation((x, y, z, w)).apply((1, 0, 0)), [0, 0, 1], atol=1e-6)  # looks up


def test_left_and_right_are_mirror_images():
    for posture in POSTURES:
        victim = Victim(name="v", at=(0.0, 0.0, 0.0), posture=posture)
        pos, _ = segment_poses(victim_table([victim]), 0.0)
        at = dict(zip(rows(victim), pos, strict=True))
        for name in at:
            if name.startswith("Left"):
                np.testing.assert_allclose(at[name], at["Right" + name[4:]] * (1, -1, 1), atol=1e-6)


def test_the_seven_parts_of_the_manual_are_there():
    assert set(PART_OF_BONE.values()) == set(PART_NAMES)
    assert len(PART_NAMES) == 7
    assert len(BONES) == 11
    assert next(iter(BONES)) == "Pelvis"


# --- scale ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bone", "hidden"),
    [
        ("LeftArm", {"LeftArm", "LeftHand"}),
        ("RightFoot", {"RightFoot"}),
        ("Chest", {"Chest", "Head", "LeftArm", "LeftHand", "RightArm", "RightHand"}),
        ("Pelvis", set(BONES)),
    ],
)
def test_scale_0_hides_a_bone_and_all_that_hangs_on_it(bone, hidden):
    whole = Victim(name="v", at=(0.3, 0.2, 0.1), posture="crouched")
    victim = Victim(**{**vars(whole), "name": "w", "segments": (SegmentMotion(name=bone, scale=0.0),)})
    assert set(rows(whole)) - set(rows(victim)) == hidden
    table = victim_table([whole, victim])
    pos, _ = segment_poses(table, 0.0)
    assert len(pos) == 22 - len(hidden)
    shown = [rows(whole).index(name) for name in rows(victim)]
    np.testing.assert_allclose(pos[11:], pos[:11][shown], atol=1e-6)  # the others stay where they are


def test_scale_goes_down_the_chain_and_multiplies():
    """And leaves the posture alone: a segment whose poses are zero has none of its own."""
    segments = (SegmentMotion(name="Chest", scale=0.5), SegmentMotion(name="LeftArm", scale=0.5))
    victim = Victim(name="v", at=(0.0, 0.0, 0.0), posture="crouched", segments=segments)
    angles, _ = segment_angles(victim_table([victim]), 0.0)
    np.testing.assert_allclose(angles[rows(victim).index("Chest")], POSTURES["crouched"]["Chest"], rtol=1e-6)
    sizes = dict(zip(rows(victim), victim_table([victim]).size, strict=True))
    for bone, scale in {"Pelvis": 1, "Chest": 0.5, "Head": 0.5, "LeftArm": 0.25, "LeftHand": 0.25}.items():
        np.testing.assert_allclose(sizes[bone], scale * BODY_HEIGHT * np.array(BONES[bone].half), rtol=1e-6)


# --- tables ---------------------------------------------------------------------------------------


def test_false_alarms_are_single_boxes_of_their_own():
    table = victim_table([PLAIN], [ALARM, FalseAlarm(part="Head", at=(1, 1, 1), scale=0.0)])
    assert table.num_boxes == 12
    assert table.num_victims == 1
    assert table.owner.tolist() == [0] * 11 + [-1]
    assert PART_NAMES[table.part[11]] == "Hand"
    pos, quat = segment_poses(table, 5.0)
    np.testing.assert_allclose(pos[11], ALARM.at, atol=1e-6)
    np.testing.assert_allclose(table.size[11], 2 * BODY_HEIGHT * np.array(BONES["LeftHand"].half), rtol=1e-6)
    w, x, y, z = quat[11]
    expected = Rotation.from_euler("ZYX", ALARM.rotation[::-1]).as_matrix()
    np.testing.assert_allclose(Rotation((x, y, z, w)).as_matrix(), expected, atol=1e-6)
    names = box_names([PLAIN, WAVING], [ALARM])
    assert len(set(names)) == len(names) == 23
    assert names[-1] == "alarm0/LeftHand"


@pytest.mark.oracle
def test_jax_and_numpy_agree_also_over_several_times():
    table = victim_table([WAVING, PLAIN], [ALARM])
    times = np.array([[0.0, 0.4], [5.5, 60.0]], np.float32)
    for function in (segment_poses, segment_angles, segment_speeds, loudness):
        mine = function(table, times)
        theirs = jax.jit(partial(function, xp=jnp))(jax.tree.map(jnp.asarray, table), times)
        for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
            # 60 s at 3 rad/s: float32 rounds the phase to 1e-5 rad; velocities divide it by 0.02 s
            np.testing.assert_allclose(a, b, atol=1e-3 if function is segment_speeds else 1e-4)
        assert jax.tree.leaves(mine)[0].shape[:2] == (2, 2)


def test_worlds_with_other_victims_are_one_batch():
    """Tables padded to one size and stacked: each world has what it would have alone."""
    worlds = [victim_table([WAVING, PLAIN], [ALARM]), victim_table([PLAIN]), victim_table([], [ALARM])]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(pad_table(w, 25, 3) for w in worlds))
    time = jnp.array([1.5, 2.5, 3.5])
    pos, quat = jax.jit(jax.vmap(partial(segment_poses, xp=jnp)))(stacked, time)
    sound = jax.vmap(partial(loudness, xp=jnp))(stacked, time)
    assert pos.shape == (3, 25, 3)
    assert sound.shape == (3, 3)
    np.testing.assert_allclose(np.linalg.norm(quat, axis=-1), 1, atol=1e-5)
    for i, world in enumerate(worlds):
        alone, _ = segment_poses(world, np.float32(time[i]))
        np.testing.assert_allclose(pos[i, : world.num_boxes], alone, atol=1e-5)
        rest = pad_table(world, 25, 3).owner[world.num_boxes :]
        assert np.all(rest == PADDING_OWNER)
        assert np.all(np.abs(pos[i, world.num_boxes :]) > 1e5)
    with pytest.raises(SpecError, match="23 boxes of 2 victims do not fit into room for 22 of 3"):
        pad_table(worlds[0], 22, 3)


def test_an_arena_without_victims_has_an_empty_table():
    table = victim_table([])
    pos, quat = segment_poses(table, np.zeros(4, np.float32))
    assert pos.shape == (4, 0, 3)
    assert quat.shape == (4, 0, 4)
    assert loudness(table, 0.0).shape == (0,)
    assert mouth_positions(table, pos).shape == (4, 0, 3)
    assert segment_poses(pad_table(table, 3, 1), 1.0)[0].shape == (3, 3)


# --- sound ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("time", "loud"), [(0.0, 3.0), (1.99, 3.0), (2.01, 0.0), (4.99, 0.0), (5.01, 3.0), (52.5, 0.0)]
)
def test_cries_come_and_go(time, loud):
    crying = Victim(name="c", at=(0, 0, 0), help_sound=HelpSound(loudness=3.0, duration=2.0, pause=3.0))
    always = Victim(name="a", at=(0, 0, 0), help_sound=HelpSound(loudness=1.0, duration=1.0, pause=0.0))
    assert loudness(victim_table([crying, always, PLAIN]), time).tolist() == [loud, 1.0, 0.0]


def test_the_voice_comes_from_the_head_or_what_is_left():
    headless = Victim(name="h", at=(1, 2, 3), segments=(SegmentMotion(name="Chest", scale=0.0),))
    gone = Victim(name="g", at=(4, 5, 6), segments=(SegmentMotion(name="Pelvis", scale=0.0),))
    table = victim_table([PLAIN, headless, gone])
    pos, _ = segment_poses(table, 0.0)
    np.testing.assert_allclose(mouth_positions(table, pos), [pos[2], (1, 2, 3), (4, 5, 6)], atol=1e-6)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"posture": "flying"}, "unknown posture 'flying'; known: standing, lying, sitting, crouched"),
        (
            {"segments": (SegmentMotion(name="Tail"),)},
            "unknown bone 'Tail'; known: Pelvis, Chest, Head, LeftArm",
        ),
        (
            {"segments": tuple(SegmentMotion(name=name) for name in list(BONES)[:9])},
            "9 segments, at most 8 are allowed",
        ),
        ({"segments": (SegmentMotion(name="Head"), SegmentMotion(name="Head"))}, "segments of one name"),
        ({"segments": (SegmentMotion(name="Head", rates=(0, -1, 0)),)}, "YawRate is -1, expected at least 0"),
        ({"segments": (SegmentMotion(name="Head", scale=-1.0),)}, "Scale is -1.0"),
        ({"segments": (SegmentMotion(name="Head", rates=(math.nan, 0, 0)),)}, "PitchRate is nan"),
        ({"anim_timer": -1.0}, "AnimTimer is -1.0, expected at least 0"),
        ({"help_sound": HelpSound(pause=-1.0)}, "pause is -1.0"),
    ],
)
def test_what_no_victim_can_be_is_refused(change, message):
    victim = Victim(**{**vars(PLAIN), **change})
    with pytest.raises(SpecError, match=message):
        victim_table([victim])


def test_names_and_parts_are_checked():
    with pytest.raises(SpecError, match="victims of one name among plain, plain"):
        victim_table([PLAIN, PLAIN])
    with pytest.raises(SpecError, match="unknown bone 'Arm'; known: Pelvis"):
        victim_table([], [FalseAlarm(part="Arm", at=(0, 0, 0))])
    with pytest.raises(SpecError, match="unknown posture"):
        rest_height("flying")
