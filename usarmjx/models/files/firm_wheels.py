"""Light wheels that bear much, as casters: tyres that do not sink into the ground."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from usarmjx.models.compile.kinematic_tree import lowest_point
from usarmjx.models.compile.measure import robot_at_rest
from usarmjx.models.files.robot_drive import MAX_LIFT
from usarmjx.models.types.robot import Part, RobotSpec
from usarmjx.models.types.shapes import SURFACES, Tyre

MAX_SINKING = 1e-3
"""Depth to which a wheel may sink under its share of the weight [m]."""
STOCK_SLIP = Tyre().slip


def with_firm_wheels(robot: RobotSpec, wheels: Collection[str]) -> RobotSpec:
    """Return a robot whose wheels on the ground sink at most by about `MAX_SINKING`.

    MuJoCo makes a contact as soft as the body is light that it touches, whatever rests on that body: under a
    force f the depth is (1 - d) f w t^2 d, for impedance d, inverse weight w of the body and time constant t.

    Args:
        robot: The robot.
        wheels: Names of the parts that roll.
    """
    parts = [part for part in robot.parts if part.name in wheels and part.shapes]
    if not parts:
        return robot
    model, data, own = robot_at_rest(robot)
    lows = {
        part.name: lowest_point(model, data, model.geom_bodyid == model.body(part.name).id) for part in parts
    }
    ground = lowest_point(model, data, own)
    borne = [part for part in parts if lows[part.name] <= ground + MAX_LIFT]
    if not borne:
        return robot
    force = float(np.sum(model.body_mass)) * float(np.abs(model.opt.gravity[2])) / len(borne)
    firm = {
        part.name: MAX_SINKING / depth
        for part in borne
        if (depth := _depth(part, force * float(model.body_invweight0[model.body(part.name).id, 0])))
        > MAX_SINKING
    }
    changed = tuple(_firmer(part, firm[part.name]) if part.name in firm else part for part in robot.parts)
    return replace(robot, parts=changed)


def _depth(part: Part, acceleration: float) -> float:
    """Return how deep a wheel sinks [m], from the acceleration of its free body by the same force [m/s2]."""
    surface = SURFACES[part.shapes[0].surface]
    impedance = surface.solimp[1]
    return (1.0 - impedance) * impedance * surface.solref[0] ** 2 * acceleration


def _firmer(part: Part, share: float) -> Part:
    """Return a wheel whose contact sinks to a share of its depth."""
    tyre = Tyre(min_slip=STOCK_SLIP * share)
    return replace(part, shapes=tuple(replace(shape, tyre=tyre) for shape in part.shapes))
