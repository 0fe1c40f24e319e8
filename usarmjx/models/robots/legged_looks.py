"""What ERS and QRIO are drawn as, part by part. Lengths are those of the parts in `legged`."""

import math

from usarmjx.models.robots.looks_kit import (
    ACROSS,
    ALONG,
    BLACK,
    DARK,
    GLASS_BLACK,
    SILVER,
    STEEL,
    ball,
    block,
    drum,
    rod,
)
from usarmjx.models.spec.shapes import Rgba, Shape

PEARL: Rgba = (0.92, 0.92, 0.9, 1.0)
BLUE: Rgba = (0.25, 0.5, 0.95, 1.0)
PINK: Rgba = (0.85, 0.35, 0.5, 1.0)
NAVY: Rgba = (0.16, 0.22, 0.42, 1.0)

ERS_BODY = (
    ball((0.115, 0.052, 0.045), (-0.005, 0.0, -0.008), PEARL),
    ball((0.05, 0.055, 0.05), (0.06, 0.0, -0.012), PEARL),  # its chest
    ball((0.045, 0.052, 0.042), (-0.075, 0.0, -0.006), PEARL),
    block((0.05, 0.018, 0.004), (-0.005, 0.0, -0.052), BLUE),  # the switches on its back
    ball((0.03, 0.04, 0.025), (0.085, 0.0, 0.008), DARK),
    rod((-0.105, 0.0, -0.03), (-0.165, 0.0, -0.085), 0.006, PEARL),
    ball((0.009, 0.009, 0.009), (-0.167, 0.0, -0.087), BLACK),
)
ERS_NECK = (rod((0.0, 0.0, -0.01), (0.0, 0.0, -0.07), 0.017, DARK),)
ERS_COLLAR = (drum(0.024, 0.008, (0.0, 0.0, 0.012), DARK), ball((0.02, 0.02, 0.02), rgba=STEEL))
ERS_HEAD = (
    ball((0.055, 0.046, 0.042), (0.0, 0.0, -0.012), PEARL),
    ball((0.042, 0.036, 0.026), (0.045, 0.0, 0.004), PEARL),  # muzzle
    ball((0.03, 0.041, 0.018), (0.036, 0.0, -0.022), GLASS_BLACK),  # the visor of its face
    *(ball((0.004, 0.006, 0.006), (0.064, y, -0.022), BLUE) for y in (-0.016, 0.016)),
    ball((0.008, 0.012, 0.007), (0.085, 0.0, -0.006), BLACK),  # nose
    drum(0.007, 0.003, (0.083, 0.0, 0.0146), BLACK, ALONG),  # and camera
    ball((0.02, 0.022, 0.005), (0.05, 0.0, 0.026), PINK),
    *(
        ball((0.02, 0.009, 0.038), (-0.012, y, 0.006), DARK, (0.25 * y / 0.05, 0.15, 0.0))
        for y in (-0.05, 0.05)
    ),
    ball((0.02, 0.014, 0.006), (-0.01, 0.0, -0.053), BLUE),
)


def ers_thigh(length: float) -> tuple[Shape, ...]:
    """Return the upper half of a leg, down from the shoulder."""
    return (
        ball((0.025, 0.02, 0.58 * length), (0.0, 0.0, 0.42 * length), PEARL),
        drum(0.022, 0.022, rgba=DARK, rotation=ACROSS),
        drum(0.014, 0.024, rgba=SILVER, rotation=ACROSS),
    )


def ers_shin(length: float, paw: float) -> tuple[Shape, ...]:
    """Return the lower half of a leg, and the paw at its end."""
    return (
        drum(0.014, 0.019, rgba=DARK, rotation=ACROSS),
        ball((0.015, 0.016, 0.55 * length), (0.0, 0.0, 0.45 * length), PEARL),
        ball((0.017, 0.018, paw), (0.003, 0.0, length), DARK),
        *(ball((0.008, 0.006, 0.007), (0.016, y, length + 0.003), PEARL) for y in (-0.009, 0.0, 0.009)),
    )


QRIO_PELVIS = (
    ball((0.05, 0.068, 0.04), (0.0, 0.0, -0.005), SILVER),
    block((0.046, 0.05, 0.01), (0.0, 0.0, -0.03), DARK),
)
QRIO_WAIST = (drum(0.034, 0.02, rgba=DARK),)
QRIO_TORSO = (
    ball((0.075, 0.082, 0.085), (-0.018, 0.0, -0.075), SILVER),
    block((0.02, 0.045, 0.035), (0.035, 0.0, -0.085), NAVY),
    drum(0.012, 0.004, (0.057, 0.0, -0.085), BLUE, ALONG),
    block((0.03, 0.055, 0.05), (-0.075, 0.0, -0.08), DARK),  # what it carries on its back
    drum(0.024, 0.1, (0.0, 0.0, -0.12), DARK, ACROSS),  # shoulders
)
QRIO_NECK = (drum(0.02, 0.016, rgba=DARK),)
QRIO_HEAD = (
    ball((0.062, 0.07, 0.058), (0.0, 0.0, -0.06), SILVER),
    ball((0.03, 0.055, 0.032), (0.038, 0.0, -0.06), GLASS_BLACK),
    *(ball((0.006, 0.012, 0.012), (0.064, y, -0.064), BLUE) for y in (-0.024, 0.024)),
    *(drum(0.022, 0.008, (0.0, y, -0.06), NAVY, ACROSS) for y in (-0.068, 0.068)),
    ball((0.035, 0.03, 0.01), (-0.005, 0.0, -0.113), NAVY),
)


def qrio_limb(length: float, radius: float, rgba: Rgba = SILVER) -> tuple[Shape, ...]:
    """Return a limb that hangs down from its joint."""
    return (
        ball((radius, 0.95 * radius, 0.6 * length), (0.0, 0.0, 0.5 * length), rgba),
        drum(0.7 * radius, 0.98 * radius, rgba=DARK, rotation=ACROSS),
    )


def qrio_forearm(length: float) -> tuple[Shape, ...]:
    """Return a forearm with a hand of three fingers."""
    return (
        *qrio_limb(0.7 * length, 0.022),
        ball((0.014, 0.01, 0.018), (0.0, 0.0, 0.8 * length), DARK),
        *(
            rod((x, 0.0, 0.85 * length), (1.2 * x, 0.0, 1.02 * length), 0.005, STEEL)
            for x in (-0.01, 0.0, 0.01)
        ),
    )


def qrio_foot(sole: float) -> tuple[Shape, ...]:
    """Return a foot; `sole` is how far below the ankle it ends."""
    return (
        block((0.08, 0.035, 0.005), (0.02, 0.0, sole - 0.005), DARK),
        ball((0.076, 0.034, 0.026), (0.02, 0.0, sole - 0.01), SILVER),
        ball((0.026, 0.026, 0.026), rgba=DARK),
        ball((0.02, 0.03, 0.015), (0.07, 0.0, sole - 0.012), NAVY, (0.0, math.pi / 12, 0.0)),
    )
