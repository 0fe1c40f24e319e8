"""What cars are drawn as: a body with arches over its wheels, a cabin with windows, lamps, bumpers.

Heights are above the ground, as in `car_kit.Car`; what is drawn stays within the car's length, width and
height but for mirrors.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from usarmjx.base.transforms import Vec3
from usarmjx.models.robots.looks_kit import (
    ALONG,
    AMBER,
    BLACK,
    DARK,
    GLASS_BLACK,
    LAMP,
    SILVER,
    TAIL_LAMP,
    block,
    drum,
    hull,
    prism,
    rod,
)
from usarmjx.models.spec.shapes import Rgba, Shape


@dataclass(frozen=True, kw_only=True)
class CarLook:
    """How a car differs from others; x as shares of half the length, from its middle, forward.

    Attributes:
        cowl: x of the windscreen's foot.
        roof: x of the roof's front and rear edge.
        deck: x of the rear window's foot.
        nose: How much lower the bonnet is at its front than at the cowl [m].
        tuck: How much narrower the roof is than the beltline, on each side [m].
        pillars: x of the pillars between the doors, at the beltline.
        lamps: Whether headlights are round.
        grille: Slots of the grille, from one side to the other.
        trim: Colour of bumpers.
    """

    cowl: float
    roof: tuple[float, float]
    deck: float
    nose: float = 0.1
    tuck: float = 0.12
    pillars: tuple[float, ...] = (0.0,)
    lamps: bool = False
    grille: int = 1
    trim: Rgba = DARK


@dataclass(frozen=True, kw_only=True)
class CarFrame:
    """Figures of a car that its look needs, see `car_kit.Car`; the origin is `origin` above the ground."""

    size: Vec3
    wheel_base: float
    track: float
    tyre: tuple[float, float]
    floor: float
    beltline: float
    origin: float
    rgba: Rgba


def car_looks(car: CarFrame, look: CarLook) -> tuple[Shape, ...]:
    """Return the body of a car without its wheels."""
    return (*_lower_body(car, look), *_cabin(car, look), *_ends(car, look))


def _lower_body(car: CarFrame, look: CarLook) -> tuple[Shape, ...]:
    """A tub between the wheels, sills between the arches, and all that is above the arches."""
    (length, width, _), (radius, tyre) = car.size, car.tyre
    half, up = length / 2, car.origin
    arch, room = 2 * radius + 0.06, radius + 0.07  # its height above the ground, half its length
    front, rear = car.wheel_base / 2, -car.wheel_base / 2
    inner = car.track / 2 - tyre / 2 - 0.03
    nose, door = car.beltline - look.nose, (car.beltline - arch) / 2
    upper = [
        (half, up - arch),
        (half - 0.02, up - nose + 0.08),
        (half - 0.12, up - nose),
        (look.cowl * half, up - car.beltline),
        (look.deck * half, up - car.beltline),
        (-half + 0.03, up - car.beltline + 0.04),
        (-half, up - arch),
    ]

    def across(x0: float, x1: float, low: float, wide: float, rgba: Rgba) -> Shape:
        size = ((x0 - x1) / 2, wide, (arch - low) / 2)
        return block(size, ((x0 + x1) / 2, 0.0, up - (arch + low) / 2), rgba)

    return (
        prism(upper, width / 2, car.rgba),
        across(half - 0.05, -half + 0.05, car.floor, inner, BLACK),
        across(front - room, rear + room, car.floor + 0.02, width / 2 - 0.01, car.rgba),
        across(half - 0.02, front + room, car.floor + 0.05, width / 2 - 0.01, car.rgba),
        across(rear - room, -half + 0.02, car.floor + 0.05, width / 2 - 0.01, car.rgba),
        *(
            block((0.07, width / 2 + 0.004, 0.012), (x * half, 0.0, up - car.beltline + 0.1), DARK)
            for x in look.pillars
        ),  # door handles
        *(
            block((0.006, width / 2 + 0.002, door), (x * half - 0.1, 0.0, up - arch - door), DARK)
            for x in look.pillars
        ),  # and the gaps between doors
    )


def _cabin(car: CarFrame, look: CarLook) -> tuple[Shape, ...]:
    """Windows all around, and over them the roof on its pillars."""
    (length, width, height), up = car.size, car.origin
    half, foot, top = length / 2, width / 2 - 0.04, width / 2 - 0.04 - look.tuck
    low, high = up - car.beltline, up - height + 0.05
    front, rear = (look.cowl, look.roof[0]), (look.deck, look.roof[1])
    glass = [
        (x * half, side * y, z)
        for edge in (front, rear)
        for x, y, z in zip(edge, (foot, top), (low, high), strict=True)
        for side in (-1.0, 1.0)
    ]
    lid = [
        (x + 0.02 * way, side * (top + 0.01 * (1 - rise)), high - 0.05 * rise)
        for x, way in zip((look.roof[0] * half, look.roof[1] * half), (1.0, -1.0), strict=True)
        for side in (-1.0, 1.0)
        for rise in (0.0, 1.0)
    ]
    pillars = (
        rod((foot_x * half, side * foot, low), (top_x * half, side * top, high), 0.028, car.rgba)
        for side in (-1.0, 1.0)
        for foot_x, top_x in (front, rear, *((x, x) for x in look.pillars))
    )
    mirrors = (
        block((0.04, 0.07, 0.05), (look.cowl * half - 0.12, side * (width / 2 + 0.02), low - 0.05), car.rgba)
        for side in (-1.0, 1.0)
    )
    return (hull(glass, GLASS_BLACK), hull(lid, car.rgba), *pillars, *mirrors)


def _ends(car: CarFrame, look: CarLook) -> tuple[Shape, ...]:
    """Bumpers, lamps, grille and number plates."""
    (length, width, _), up = car.size, car.origin
    half, side = length / 2, width / 2
    lamp = up - (car.beltline - look.nose - 0.16)
    bumper = up - (car.floor + 0.16)
    slots = _spread(look.grille, 0.5 * side)
    slot, tall = 0.4 * side / look.grille, 0.08 if look.grille > 1 else 0.05
    return (
        *(block((0.05, side - 0.03, 0.08), (x, 0.0, bumper), look.trim) for x in (half - 0.04, -half + 0.04)),
        *_lamps(look, half, side, lamp),
        *(block((0.02, slot, tall), (half - 0.015, y, lamp), BLACK) for y in slots),
        *(
            block((0.02, 0.09, 0.06), (-half + 0.015, y, lamp), TAIL_LAMP)
            for y in (-side + 0.14, side - 0.14)
        ),
        *(block((0.004, 0.2, 0.05), (x, 0.0, bumper - 0.02), SILVER) for x in (half + 0.008, -half - 0.008)),
    )


def _lamps(look: CarLook, front: float, side: float, z: float) -> tuple[Shape, ...]:
    places = (-side + 0.2, side - 0.2)
    blinkers = (block((0.02, 0.04, 0.04), (front - 0.015, y * (side - 0.07), z), AMBER) for y in (-1.0, 1.0))
    if look.lamps:
        return (*(drum(0.09, 0.03, (front - 0.02, y, z), LAMP, ALONG) for y in places), *blinkers)
    return (*(block((0.025, 0.12, 0.055), (front - 0.015, y, z), LAMP) for y in places), *blinkers)


def _spread(count: int, half: float) -> Sequence[float]:
    """Return places spread evenly from -half to half."""
    return [half * (2 * (k + 0.5) / count - 1) for k in range(count)]
