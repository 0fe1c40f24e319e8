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

SPHERE = wp.constant(int(_gjk.GeomType.SPHERE))
CAPSULE = wp.constant(int(_gjk.GeomType.CAPSULE))
ELLIPSOID = wp.constant(int(_gjk.GeomType.ELLIPSOID))
MESH = wp.constant(int(_gjk.GeomType.MESH))
BOX = wp.constant(int(_gjk.GeomType.BOX))
STALLED = wp.constant(1e-3)
"""Distance below which searches stall [m]."""
ATTEMPTS = wp.constant(5)
"""Most searches for a pair. One that begins at another guess stalls in a tenth to a third of these cases."""
SHORT = wp.constant(12)
"""Iterations of all searches but the last for cylinders and boxes.

Wheels in `yellow` had 57,000 searches: 95.4 % ended, all but four of these within 12 iterations. Threads of a
warp wait for each other, so a stalled search should not use all of its iterations.
"""


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
        most = iterations
        if attempt + 1 < ATTEMPTS and kind1 != ELLIPSOID and kind2 != ELLIPSOID and kind2 != MESH:
            most = wp.min(iterations, SHORT)
        result = _search(tolerance, most, geom1, geom2, x2 + guess, x2, kind1, kind2, cutoff, is_discrete)
        # A search that ends has reached the origin, or a plane between the geoms.
        if result.separated or result.dist <= tolerance:
            break
        guess = wp.vec3(guess[1], guess[2], guess[0]) + 0.3 * guess
        attempt += 1
    return result


_phase: Any = _function(name="unstalled_gjk_phase", module=__name__)(
    with_globals(_gjk.gjk_phase.func, gjk=unstalled_gjk)
)


@wp.func
def unstalled_phase(  # noqa: ANN201
    tolerance: float,
    cutoff: float,
    iterations: int,
    geom1: Any,  # noqa: ANN401
    geom2: Any,  # noqa: ANN401
    kind1: int,
    kind2: int,
    x_1: wp.vec3,
    x_2: wp.vec3,
):
    """Return what MuJoCo Warp's function before EPA does; pairs with a box that stall have EPA next."""
    deep, dist, count, x1, x2, result, one, other = _phase(
        tolerance, cutoff, iterations, geom1, geom2, kind1, kind2, x_1, x_2
    )
    # Geoms that are apart mostly end the search by a plane between them, without a distance.
    whole = (kind1 == BOX or kind2 == BOX) and kind1 != CAPSULE and kind1 != SPHERE
    if whole and not deep and cutoff == 0.0 and dist > tolerance and dist < STALLED:
        deep, result = True, GJKResult()  # no simplex: EPA finds nothing
    return deep, dist, count, x1, x2, result, one, other
