"""Checks of a robot from a file on level ground: where it settles."""

import mujoco
import numpy as np

from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import HOLD_SUFFIX, RobotSpec

SETTLING_TIME = 1.0
"""Time in which a robot comes to rest [s]."""
MAX_SETTLING = 0.005
"""Largest way to the place of rest [m]."""


def settling_distance(robot: RobotSpec) -> float:
    """Return the way of a robot's origin within a second after it is put on level ground [m].

    Its motors hold their joints, as before its first command.

    Raises:
        SpecError: It cannot be built.
    """
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((-50, 50), (-50, 50))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, kinematic_tree_of(robot).clearance))
    model = spec.compile()
    data = mujoco.MjData(model)
    for actuator in range(model.nu):
        data.ctrl[actuator] = model.actuator(actuator).name.endswith(HOLD_SUFFIX)
    mujoco.mj_forward(model, data)
    chassis = model.body("chassis").id
    before = data.xpos[chassis].copy()
    for _ in range(round(SETTLING_TIME / model.opt.timestep)):
        mujoco.mj_step(model, data)
    way = float(np.linalg.norm(data.xpos[chassis] - before))
    return way if np.isfinite(way) else np.inf


def robot_faults(robot: RobotSpec) -> list[str]:
    """Return the faults of a robot on level ground, in words."""
    way = settling_distance(robot)
    found: list[str] = []
    if way > MAX_SETTLING:
        found.append(
            f"it moves by {way * 1e3:.0f} mm within {SETTLING_TIME:g} s on level ground, more than "
            f"{MAX_SETTLING * 1e3:.0f} mm: it tips, or its legs give way"
        )
    wheels = [part for part in robot.wheels if part.motor is not None]
    if wheels and robot.wheel_radius <= 0:
        found.append("its wheels are not round: no cylinder, sphere or round mesh is about their axes")
    return found
