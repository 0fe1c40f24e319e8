"""Heights that the manual lists are those of decks and roofs: what is above stands there."""

import mujoco
import numpy as np
import pytest

from tests.models.robots.test_manual_figures import FIGURES
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import bounding_box
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec

BUILT = 5e-4  # m: a Zerg's wheels of 2 x 0.0606 m rise above its deck by as much
EQUIPMENT = {
    "P2DX": 1,
    "ATRVJr": 1,
    "Hummer": 0,
    "SnowStorm": 1,
    "Sedan": 0,
    "Zerg": 0,
    "Rugbot": 1,
    "Kenaf": 2,
}
"""How many solids of the chassis are scanners and posts on its deck."""


def tops(name):
    """Height above the ground of the top of each solid [m], by the part that it belongs to."""
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, ROBOTS.get(name), "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    own = np.flatnonzero(model.geom_bodyid >= 2)
    mat = data.geom_xmat[own].reshape(-1, 3, 3)
    middle = data.geom_xpos[own] + np.einsum("gij,gj->gi", mat, model.geom_aabb[own, :3])
    half = np.einsum("gij,gj->gi", np.abs(mat), model.geom_aabb[own, 3:])
    ground = (middle - half)[:, 2].min()
    heights: dict[str, list[float]] = {}
    for geom, top in zip(own, (middle + half)[:, 2] - ground, strict=True):
        heights.setdefault(model.body(model.geom_bodyid[geom]).name, []).append(float(top))
    return heights


@pytest.mark.parametrize("name", EQUIPMENT)
def test_the_deck_or_roof_is_as_high_as_the_manual_says(name):
    heights, listed = tops(name), FIGURES[name][0][2]
    above = sorted(top for top in heights.pop("chassis") if top > listed - BUILT)
    assert above[0] == pytest.approx(listed, abs=BUILT)
    assert len(above) == 1 + EQUIPMENT[name]
    cameras = {camera.parent for camera in ROBOTS.get(name).cameras}
    for part, higher in heights.items():
        carries = part in cameras or part.removesuffix("1") + "2" in cameras or "Camera" in part
        assert max(higher) < listed + BUILT or carries, part


def test_a_sedan_fills_the_manuals_box():
    """Whatever makes its weight is inside: rays of others hear of it where the body is."""
    low, high = bounding_box(ROBOTS.get("Sedan"))
    np.testing.assert_allclose(high - low, FIGURES["Sedan"][0], atol=BUILT)


def test_an_atrvjrs_wheels_are_those_of_the_geo_example():
    """Manual 9.3: radius .1922, track .5120, width .6318; what 12.4.1 says of them is guessed, it says."""
    for wheel in ROBOTS.get("ATRVJr").wheels:
        radius, half_width = wheel.shapes[0].size[:2]
        assert radius == pytest.approx(0.1922, abs=1e-6)
        assert 2 * half_width == pytest.approx(0.6318 - 0.5120, abs=1e-3)
