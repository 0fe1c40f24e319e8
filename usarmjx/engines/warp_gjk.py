"""GJK of MuJoCo Warp, begun anew where single precision stalls it.

Close to the origin its simplex may be too flat for single precision: the distance stays at some micrometres,
never reaches zero, and geoms that overlap have no contact. In a step one to three of 100 wheels of a Hummer
that stands on a slope lost theirs. Another first guess leads to another simplex.
"""

from importlib import import_module
from typing import Any

import warp as wp

from usarmjx.base.warp_functions import with_globals

# Private; the version of MJX is pinned.
_gjk: Any = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_gjk")
GJKResult: Any = _gjk.GJKResult
_search: Any = _gjk.gjk
_function: Any = wp.func

ATTEMPTS = wp.constant(5)
"""Most searches for a pair. A search that begins at another guess stalls in a tenth of these cases."""


@wp.func
def unstalled_gjk(
    tolerance: float,
    iterations: int,
    geom1: Any,  # noqa: ANN401 - Warp's
    geom2: Any,  # noqa: ANN401
    x1: wp.vec3,
    x2: wp.vec3,
    kind1: int,
    kind2: int,
    cutoff: float,
    is_discrete: bool,
) -> Any:  # noqa: ANN401
    """Return what MuJoCo Warp's search returns, from another first guess where it stalls."""
    result = GJKResult()
    guess = x1 - x2
    attempt = wp.int32(0)
    while attempt < ATTEMPTS:
        result = _search(
            tolerance, iterations, geom1, geom2, x2 + guess, x2, kind1, kind2, cutoff, is_discrete
        )
        # A search that ends has reached the origin, or a plane between the geoms.
        if result.separated or result.dist <= tolerance:
            break
        guess = wp.vec3(guess[1], guess[2], guess[0]) + 0.3 * guess
        attempt += 1
    return result


unstalled_phase: Any = _function(name="unstalled_gjk_phase", module=__name__)(
    with_globals(_gjk.gjk_phase.func, gjk=unstalled_gjk)
)
"""MuJoCo Warp's function before EPA, with these searches."""
