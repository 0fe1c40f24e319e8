import pytest

from usarmjx.base.errors import SpecError
from usarmjx.models.arenas.pieces import walls

EXACT = 1e-12
PLAN = """
+--+--+
|     |
+--+  +
|     |
+--+--+
"""


def spans(shapes):
    """The walls as (x0, x1, y0, y1), sorted."""
    rounded = [
        tuple(round(s.at[i] + sign * s.size[i], 6) for i in (0, 1) for sign in (-1, 1)) for s in shapes
    ]
    return sorted(rounded)


def test_straight_walls_are_one_box_each_and_reach_into_the_corners():
    shapes = walls(PLAN, origin=(10.0, 20.0), cell=2.0, height=1.0, thickness=0.2)
    assert spans(shapes) == sorted(
        [
            (9.9, 14.1, 23.9, 24.1),  # the first row of text is the far one
            (9.9, 12.1, 21.9, 22.1),
            (9.9, 14.1, 19.9, 20.1),
            (9.9, 10.1, 19.9, 24.1),
            (13.9, 14.1, 19.9, 24.1),
        ]
    )
    assert all(s.at[2] == s.size[2] == 0.5 for s in shapes)  # they stand on the floor
    assert {s.surface for s in shapes} == {"wall"}


def test_a_gap_parts_a_wall():
    shapes = walls("+--+  +--+\n          \n+  +  +  +", origin=(0.0, 0.0), cell=1.0, thickness=0.0)
    assert spans(shapes) == [(0.0, 1.0, 1.0, 1.0), (2.0, 3.0, 1.0, 1.0)]


def test_rows_of_open_cells_count():
    plan = "+--+\n    \n+  +\n    \n+--+"
    assert spans(walls(plan, origin=(0.0, 0.0), cell=1.0, thickness=0.0)) == [
        (0.0, 1.0, 0.0, 0.0),
        (0.0, 1.0, 2.0, 2.0),
    ]


@pytest.mark.parametrize(
    "plan", ["", "+--+\n|  |", "+--+\n|  |\n+--", "+--+\n|  |  \n+--+", "+--+\n\n|  |\n+--+"]
)
def test_ragged_plans_are_refused(plan):
    with pytest.raises(SpecError, match="odd number of rows of the same length"):
        walls(plan, origin=(0.0, 0.0))
