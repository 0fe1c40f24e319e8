"""Measurements of a robot that follow from its parts, for GETGEO and GETCONF of one built from a file."""

from dataclasses import replace

import mujoco
import numpy as np

from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import bounding_corners, kinematic_tree_of, lowest_point
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec

MEASUREMENT_DECIMALS = 6
"""Decimals of the measurements, micrometres and milligrams: kinematic trees are in single precision."""

ROUND = ("sphere", "capsule", "cylinder", "ellipsoid")
"""Kinds of shapes whose first size is the radius of a wheel."""


def with_measurements(robot: RobotSpec) -> RobotSpec:
    """Return a robot with dimensions, mass, height and wheel measurements of its parts.

    `dimensions` are those of the box around it at rest, `wheel_separation` and `wheel_base` the largest
    distances of its wheels.

    Raises:
        SpecError: It cannot be built.
    """
    tree = kinematic_tree_of(robot)
    low, high = bounding_box(robot)
    wheels = [i for i, part in enumerate(tree.parts) if part in {wheel.name for wheel in robot.wheels}]
    spread = np.ptp(tree.rest_pos[wheels], axis=0) if wheels else np.zeros(3)
    radii = [shape.size[0] for part in robot.wheels for shape in part.shapes if shape.kind in ROUND]
    length, width, height = (high - low).round(MEASUREMENT_DECIMALS).tolist()
    return replace(
        robot,
        dimensions=(length, width, height),
        mass=round(tree.mass, MEASUREMENT_DECIMALS),
        origin_height=round(tree.clearance, MEASUREMENT_DECIMALS),
        wheel_radius=radii[0] if radii else 0.0,
        wheel_separation=round(float(spread[1]), MEASUREMENT_DECIMALS),
        wheel_base=round(float(spread[0]), MEASUREMENT_DECIMALS),
    )


def bounding_box(robot: RobotSpec) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper corner of the box around a robot at rest [m] (3,), MuJoCo's axes."""
    return bounding_corners(*robot_at_rest(robot))


def robot_at_rest(robot: RobotSpec) -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray]:
    """Return the model of a robot in an empty arena, its data at rest, and which geoms are its own (n,)."""
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data, model.geom_bodyid >= 2  # bodies 0 and 1 are the world and the arena


def chassis_heights(robot: RobotSpec) -> np.ndarray:
    """Return how high the lowest point of each of the chassis' solids is above that of the robot [m] (n,)."""
    model, data, own = robot_at_rest(robot)
    lows = np.zeros(len(robot.chassis))
    for i in range(len(lows)):
        lows[i] = lowest_point(model, data, np.arange(model.ngeom) == model.geom(f"chassis/{i}").id)
    return lows - lowest_point(model, data, own)
