"""GETGEO's COG: the built robot's centre of gravity, with C MuJoCo as the oracle."""

import mujoco
import numpy as np
import pytest

from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.server.gamebots.sensors import geometry
from usarmjx.server.protocol.grammar import to_vector

FOUR_DECIMALS = 1.01e-4
NOWHERE = ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0)))


@pytest.mark.parametrize("name", ["P2AT", "ATRVJr", "ERS", "Submarine", "AirRobot"])
def test_cog_is_the_built_robots(name):
    """One of each kind of vehicle and two that the manual's example lines have (9.3)."""
    robot = ROBOTS.get(name)
    (message,) = geometry(kinematic_tree_of(robot), "Robot", "")
    spec = new_spec(NOWHERE, Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    x, y, z = data.subtree_com[model.body("chassis").id]
    np.testing.assert_allclose(to_vector(message.get("COG")), (x, -y, -z), atol=FOUR_DECIMALS)
