"""What the solids of shipped arenas have on them in pictures, by their colour.

Robots that find their way by what they see need something to hold on to; contacts and range sensors do not
meet it. What has a texture of its own, as signs have, keeps it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from usarmjx.models.arenas.elements import STONE, WOOD
from usarmjx.models.arenas.floorplan import WALL_RGBA
from usarmjx.models.arenas.pieces import BRICK, CONCRETE
from usarmjx.models.spec.shapes import Rgba, Shape

TexturesByColour = Mapping[Rgba, str]
"""Textures of `spec.textures` by colours."""

BARE: TexturesByColour = {WOOD: "wood", STONE: "concrete", CONCRETE: "concrete", BRICK: "brick"}
"""What is made of plywood, stone, concrete and bricks looks it."""
PANELLED: TexturesByColour = {**BARE, WALL_RGBA: "wood"}
"""Walls of boards, as in halls for tests."""
BRICKED: TexturesByColour = {**BARE, WALL_RGBA: "brick"}
CAST: TexturesByColour = {**BARE, WALL_RGBA: "concrete"}


def finished(shapes: Iterable[Shape], finish: TexturesByColour) -> tuple[Shape, ...]:
    """Return solids with the textures of their colours."""
    return tuple(
        shape if shape.texture else replace(shape, texture=finish.get(shape.rgba, "")) for shape in shapes
    )
