"""The skeleton of victims: eleven boxes on joints, and the postures that it can take.

The proportions are those of an adult of `BODY_HEIGHT` by Drillis and Contini (Body Segment Parameters, 1966).
Every bone is one box on one joint: elbows and knees do not bend. Unposed, the body stands upright, looks
along x and lets its arms hang. Angles are (pitch, yaw, roll), as the manual orders them (14.1.3), in
MuJoCo's axes: applied as ZYX, and a positive pitch bends forward.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from usarmjx.base.transforms import Vec3
from usarmjx.models.spec.shapes import ZERO, Rgba

BODY_HEIGHT = 1.75
"""Height of a standing victim [m]."""

SKIN, SHIRT, TROUSERS = (0.85, 0.65, 0.55, 1.0), (0.75, 0.2, 0.2, 1.0), (0.2, 0.25, 0.45, 1.0)
SHOES = (0.15, 0.12, 0.1, 1.0)


@dataclass(frozen=True, kw_only=True)
class Bone:
    """One bone; lengths in shares of the body's height, in the axes of an unposed body.

    Attributes:
        parent: The bone it hangs on; None: the root.
        part: What a victim sensor calls it (manual 9.3).
        joint: Where its joint is, seen from the parent's joint.
        half: Half lengths of its box.
        offset: Centre of the box, seen from its joint.
        rgba: Colour.
    """

    parent: str | None
    part: str
    joint: Vec3 = ZERO
    half: Vec3
    offset: Vec3 = ZERO
    rgba: Rgba = SKIN


# Heights: ankle 0.039, hip 0.530, shoulder 0.818; arm without hand 0.332, hand 0.108, foot 0.152 x 0.055,
# hips 0.191 wide. Seat 0.48, waist 0.62 and depths are chosen. The neck belongs to the head.
def _limbs(left: str, side: float) -> Iterator[tuple[str, Bone]]:
    """The arm and the leg of a side; `side` is 1 on the left."""
    arm, leg = f"{left}Arm", f"{left}Leg"
    yield (
        arm,
        Bone(
            parent="Chest",
            part="Arm",
            joint=(0.0, 0.122 * side, 0.198),
            half=(0.026, 0.026, 0.166),
            offset=(0.0, 0.0, -0.166),
            rgba=SHIRT,
        ),
    )
    yield (
        f"{left}Hand",
        Bone(
            parent=arm,
            part="Hand",
            joint=(0.0, 0.0, -0.332),
            half=(0.024, 0.01, 0.054),
            offset=(0.0, 0.0, -0.054),
        ),
    )
    yield (
        leg,
        Bone(
            parent="Pelvis",
            part="Leg",
            joint=(0.0, 0.048 * side, -0.02),
            half=(0.043, 0.043, 0.2455),
            offset=(0.0, 0.0, -0.2455),
            rgba=TROUSERS,
        ),
    )
    yield (
        f"{left}Foot",
        Bone(
            parent=leg,
            part="Foot",
            joint=(0.0, 0.0, -0.491),
            half=(0.076, 0.0275, 0.0195),
            offset=(0.046, 0.0, -0.0195),
            rgba=SHOES,
        ),
    )


BONES: dict[str, Bone] = {
    "Pelvis": Bone(parent=None, part="Pelvis", half=(0.063, 0.0955, 0.07), rgba=TROUSERS),
    "Chest": Bone(
        parent="Pelvis",
        part="Chest",
        joint=(0.0, 0.0, 0.07),
        half=(0.063, 0.0945, 0.099),
        offset=(0.0, 0.0, 0.099),
        rgba=SHIRT,
    ),
    "Head": Bone(
        parent="Chest",
        part="Head",
        joint=(0.0, 0.0, 0.198),
        half=(0.055, 0.044, 0.091),
        offset=(0.0, 0.0, 0.091),
    ),
    **dict(_limbs("Left", 1.0)),
    **dict(_limbs("Right", -1.0)),
}
"""The bones, parents first; no bone has more than three above it."""

PART_NAMES = ("Head", "Arm", "Hand", "Chest", "Pelvis", "Leg", "Foot")
"""What victim sensors call parts (manual 9.3); `VictimTable.part` counts in this order."""
PART_OF_BONE: dict[str, str] = {name: bone.part for name, bone in BONES.items()}


def _both(part: str, angles: Vec3) -> dict[str, Vec3]:
    """The same pose on both sides, the right one mirrored."""
    pitch, yaw, roll = angles
    return {f"Left{part}": angles, f"Right{part}": (pitch, -yaw, -roll)}


QUARTER = math.pi / 2
POSTURES: dict[str, dict[str, Vec3]] = {
    "standing": {},
    # On its back, the head towards -x.
    "lying": {
        "Pelvis": (-QUARTER, 0.0, 0.0),
        **_both("Arm", (0.08, 0.0, 0.12)),
        **_both("Leg", (0.03, 0.0, 0.08)),
    },
    "sitting": {
        **_both("Leg", (-QUARTER, 0.1, 0.0)),
        **_both("Arm", (-0.8, 0.0, 0.1)),
        "Head": (0.3, 0.0, 0.0),
    },
    # On its seat, bent forward over its legs with the arms ahead: knees do not bend.
    "crouched": {
        "Pelvis": (0.3, 0.0, 0.0),
        "Chest": (0.9, 0.0, 0.0),
        "Head": (0.3, 0.0, 0.0),
        **_both("Leg", (-QUARTER - 0.3, 0.1, 0.0)),
        **_both("Arm", (0.3 - QUARTER - 1.2, 0.0, 0.1)),
    },
}
"""Angles (pitch, yaw, roll) of the bones in each posture [rad]; bones that are not named are straight."""
