"""How high obstacles may be for a robot class to get over them as often as asked, as measured.

`crossings.json` holds what `usarmjx arena obstacles --robot CLASS --write FILE` found: of each class and kind
of obstacle heights over the robot's step, and the share of perturbed drives that got over three in a row.
"""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files

from usarmjx.base.errors import SpecError
from usarmjx.models.generate.obstacles import HIGHEST, LOWEST

CROSSINGS_FILE = "crossings.json"

SuccessCurve = Sequence[tuple[float, float]]
"""Heights over the robot's step, rising, and the share of drives that got over obstacles of that height."""


@cache
def measured_crossings() -> Mapping[str, Mapping[str, SuccessCurve]]:
    """Return what was measured, by class and kind of obstacle."""
    return json.loads(files("usarmjx.models.generate").joinpath(CROSSINGS_FILE).read_text(encoding="utf-8"))[
        "classes"
    ]


def highest_at(curve: SuccessCurve, success: float) -> float:
    """Return up to which height over the step at least that share of the drives gets over obstacles.

    What succeeds more often than something lower counts as that; between two heights it goes evenly.
    """
    held, share = curve[0]
    for height, found in curve[1:]:
        found = min(found, share)
        if found < success:
            return held + (height - held) * (share - success) / (share - found) if share > success else held
        held, share = height, found
    return held


def highest_obstacle(robot: str, kind: str, risk: float) -> float:
    """Return how high the highest obstacles are for a class, over its step.

    Args:
        robot: The class; "" if only a footprint is known.
        kind: A name of `obstacles.OBSTACLES`.
        risk: Share of the drives that may fail. Without any, obstacles are no higher than the step, and no
            higher than every drive got over; classes that were not measured are taken to climb their step.

    Raises:
        SpecError: A risk for a class that was not measured.
    """
    known = measured_crossings()
    curve = known.get(robot, {}).get(kind)
    if curve is None:
        if risk:
            there = ", ".join(known)
            raise SpecError(f"a risk of {risk:g} for {robot or 'a footprint'}: measured are {there}")
        return HIGHEST
    return max(LOWEST, highest_at(curve, 1.0 - risk)) if risk else min(HIGHEST, highest_at(curve, 1.0))
