"""What Pioneers and robots like them are drawn as: body, deck, sonar rings, scanner, wheels."""

import math
from collections.abc import Sequence

from usarmjx.models.robots.looks_kit import (
    ACROSS,
    ALONG,
    AMBER,
    BLACK,
    DARK,
    LAMP,
    STEEL,
    ball,
    block,
    drum,
    mirrored,
    prism,
    rod,
    sick,
    sonar_discs,
    wheel_looks,
)
from usarmjx.models.spec.robot import Mount
from usarmjx.models.spec.shapes import Rgba, Shape

RED: Rgba = (0.78, 0.1, 0.1, 1.0)


def _discs(sonars: Sequence[Mount], push: float) -> tuple[Shape, ...]:
    return sonar_discs([(mount.at, mount.direction[2]) for mount in sonars], push)


def at_looks(sonars: Sequence[Mount], scanner: tuple[float, float, float], rgba: Rgba) -> tuple[Shape, ...]:
    """Return a P2AT without its wheels and its camera."""
    rings = (drum(0.148, 0.021, (x, 0.0, 0.0), BLACK) for x in (0.10, -0.10))
    return (
        block((0.262, 0.18, 0.04), (0.0, 0.0, 0.07), rgba),
        block((0.23, 0.165, 0.03), (0.0, 0.0, 0.125), rgba),
        block((0.275, 0.15, 0.02), (0.0, 0.0, 0.095), BLACK),  # bumpers
        *rings,
        *_discs(sonars, 0.012),
        block((0.258, 0.2, 0.003), (0.0, 0.0, -0.0223), rgba),
        block((0.245, 0.187, 0.003), (0.0, 0.0, -0.0283), BLACK),
        block((0.06, 0.06, 0.006), (scanner[0], 0.0, -0.0365), DARK),
        *sick(scanner),
        block((0.05, 0.07, 0.012), (-0.12, 0.0, -0.043), DARK),  # its radio, and the antenna
        rod((-0.16, 0.05, -0.04), (-0.16, 0.05, -0.24), 0.004, BLACK),
    )


def at_wheel(y: float, radius: float, width: float) -> tuple[Shape, ...]:
    """Return a tyre that reaches as far inward as the real one, on the side of `y`."""
    wide = 0.055
    return wheel_looks(radius, wide, rim=0.5, shift=-math.copysign((wide - width) / 2, y), bars=2)


def dx_looks(sonars: Sequence[Mount], scanner: tuple[float, float, float], rgba: Rgba) -> tuple[Shape, ...]:
    """Return a P2DX without its wheels and its camera."""
    return (
        block((0.06, 0.145, 0.06), (-0.02, 0.0, 0.08), rgba),
        drum(0.145, 0.06, (0.045, 0.0, 0.08), rgba),
        drum(0.145, 0.06, (-0.075, 0.0, 0.08), rgba),
        drum(0.15, 0.02, (0.066, 0.0, 0.0), BLACK),
        *_discs(sonars, 0.012),
        *(drum(0.165, 0.005, (x, 0.0, -0.015), rgba) for x in (0.055, -0.055)),
        block((0.055, 0.165, 0.005), (0.0, 0.0, -0.015), rgba),
        block((0.1, 0.12, 0.003), (-0.03, 0.0, -0.021), BLACK),
        ball((0.0375, 0.0375, 0.0375), (-0.16, 0.0, 0.1625), BLACK),
        drum(0.02, 0.03, (-0.16, 0.0, 0.135), STEEL),
        block((0.06, 0.06, 0.018), (scanner[0], 0.0, scanner[2] + 0.068), DARK),
        *sick(scanner),
    )


def atrv_looks(
    sonars: Sequence[Mount], scanner: tuple[float, float, float], top: float, rgba: Rgba
) -> tuple[Shape, ...]:
    """Return an ATRVJr without its wheels and its camera; `top` is z of its deck."""
    lower = [(0.30, 0.27), (0.385, 0.17), (0.385, 0.0), (-0.385, 0.0), (-0.385, 0.17), (-0.30, 0.27)]
    return (
        prism(lower, 0.19, DARK),
        prism([(0.385, 0.005), (0.30, top), (-0.30, top), (-0.385, 0.005)], 0.312, rgba, top=0.23),
        block((0.27, 0.2, 0.004), (0.0, 0.0, top - 0.002), BLACK),
        *(block((0.012, 0.17, 0.03), (x, 0.0, 0.12), rgba) for x in (0.39, -0.39)),
        *sonar_discs([((m.at[0], m.at[1], 0.06), m.direction[2]) for m in sonars], 0.042, 0.02),
        drum(0.03, 0.19, (0.0, 0.0, 0.1978), STEEL, ACROSS),
        block((0.06, 0.06, 0.006), (scanner[0], 0.0, top - 0.006), DARK),
        *sick(scanner),
        *(drum(0.012, 0.012, (-0.28, y, top - 0.015), (0.85, 0.1, 0.1, 1.0)) for y in (0.16, -0.16)),
        rod((-0.26, 0.0, top), (-0.26, 0.0, top - 0.25), 0.006, BLACK),
    )


def zerg_looks(length: float, rgba: Rgba) -> tuple[Shape, ...]:
    """Return a Zerg without its wheels and its camera: a flat body with sloping ends and a roll bar."""
    x = length / 2
    profile = mirrored([(x - 0.03, 0.035), (x, 0.02), (x - 0.04, -0.032)])
    return (
        prism(profile, 0.15, rgba),
        block((0.085, 0.11, 0.003), (0.0, 0.0, -0.034), BLACK),
        block((0.006, 0.1, 0.012), (x - 0.004, 0.0, 0.018), BLACK),
        rod((-0.06, -0.13, -0.03), (-0.06, -0.13, -0.055), 0.006, BLACK),
        rod((-0.06, 0.13, -0.03), (-0.06, 0.13, -0.055), 0.006, BLACK),
        rod((-0.06, -0.13, -0.055), (-0.06, 0.13, -0.055), 0.006, BLACK),
    )


def loader_looks(
    length: float, width: float, scanner: tuple[float, float, float], rgba: Rgba
) -> tuple[Shape, ...]:
    """Return a UnitLoader without wheels and rollers: a platform with warning stripes on its sides."""
    stripes = tuple(
        block((0.022, width / 2 + 0.002, 0.0199), (x, 0.0, -0.05), BLACK)
        for x in (-0.24, -0.12, 0.0, 0.12, 0.24)
    )
    return (
        block((0.28, 0.2, 0.05), (0.0, 0.0, 0.075), DARK),
        block((0.2, 0.16, 0.03), (-0.04, 0.0, 0.0), DARK),
        block((length / 2, width / 2, 0.02), (0.0, 0.0, -0.05), rgba),
        *stripes,
        *sick(scanner),
        *(drum(0.02, 0.01, (0.295, y, 0.0), LAMP, ALONG) for y in (0.14, -0.14)),
        rod((-0.27, 0.2, -0.07), (-0.27, 0.2, -0.09), 0.025, AMBER),
    )
