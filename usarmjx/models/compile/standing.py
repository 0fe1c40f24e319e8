"""Height at which a robot class stands: contacts and springs carry its weight there, so nothing drops."""

from functools import cache

import mujoco
import numpy as np

from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.layout import index_robot
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec

START_GAP = 0.002
"""Robots that fly or dive, or cannot stand, start this far above the floor: none starts inside it [m]."""
SETTLING_STEPS = 200
"""Steps of the reference's physics in which a robot settles: a second. The height is the mean over the last
half, as tracks tremble."""
MAX_SINKING = 0.005
"""A robot whose chassis moves farther than this does not stand by itself [m]."""


@cache
def standing_height(robot: RobotSpec) -> float:
    """Return the height above level ground of the chassis' origin of a robot that stands [m].

    It is less than the height at which the robot just touches: contacts give way, by 0.1 mm for most classes.
    """
    clearance = kinematic_tree_of(robot).clearance
    if robot.drive.applies_wrench:
        return clearance + START_GAP
    ground = ArenaSpec(name="ground", starts=(), extent=((-2, 2), (-2, 2)))
    spec = new_spec(ground, Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data, index = mujoco.MjData(model), index_robot(model, robot, "")
    height = index.root_qposadr + 2
    data.qpos[height] = ground.floor + clearance
    data.ctrl[list(index.hold_actuator_ids)] = 1.0
    heights = list[float]()
    for _ in range(SETTLING_STEPS):
        mujoco.mj_step(model, data)
        heights.append(float(data.qpos[height]) - ground.floor)
    stands = float(np.mean(heights[SETTLING_STEPS // 2 :]))
    return stands if abs(stands - clearance) < MAX_SINKING else clearance + START_GAP


def sinking(robot: RobotSpec) -> float:
    """Return how far a standing robot sinks into level ground [m]; 0: it does not stand."""
    return max(0.0, kinematic_tree_of(robot).clearance - standing_height(robot))
