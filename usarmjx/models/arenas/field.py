"""DM-Field: a large, flat, open ground for cars and flyers, with some walls at its edge. The plan is ours."""

from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape

HALF = 200.0
"""Half the field's side [m]; the ground extends beyond it."""
WALL = (10.0, 0.1, 1.5)
"""Half lengths of a wall [m]."""
SPACING = 10.0
"""Distance between two starts [m]."""
BRICK = (0.6, 0.35, 0.3, 1.0)


def _wall(x: float, y: float, along_y: bool) -> Shape:
    length, thickness, height = WALL
    size = (thickness, length, height) if along_y else (length, thickness, height)
    return Shape(kind="box", size=size, at=(x, y, height), surface="wall", rgba=BRICK)


FIELD = ArenaSpec(
    name="DM-Field",
    aliases=("field",),
    about="A flat ground of 400 x 400 m with walls in the middle of each side, for cars and flyers.",
    shapes=(
        _wall(HALF, 0.0, along_y=True),
        _wall(-HALF, 0.0, along_y=True),
        _wall(0.0, HALF, along_y=False),
        _wall(0.0, -HALF, along_y=False),
    ),
    starts=(
        *(
            StartPose(
                tag=f"Start{1 + 5 * row + column}",
                at=((row - 2) * SPACING, (2 - column) * SPACING, START_ELEVATION),
            )
            for row in range(5)
            for column in range(5)
        ),
        StartPose(tag="PlayerStart", at=(-3 * SPACING, 0.0, START_ELEVATION)),
    ),
    extent=((-HALF, HALF), (-HALF, HALF)),
    robots=("Hummer", "SnowStorm", "Sedan", "Cooper", "AirRobot", "Passarola"),
)
