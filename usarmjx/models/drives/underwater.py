"""The drive of a submarine: a propeller, a rudder and a stern plane (manual 9.4, 12.9)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.rotations import mat_from_quat, matvec
from usarmjx.models.drives.base import Drive, VehicleType
from usarmjx.models.drives.fluid import WATER_DENSITY, Hull
from usarmjx.models.drives.state import RobotState

STALLED = 1.17
"""Normal force coefficient of a square plate across the flow (Hoerner, Fluid-Dynamic Drag, 3-9)."""


def plate_force(area: float, slope: float, speed: Array, across: Array) -> Array:
    """Return the force on a plate along its normal [N] (...,).

    Thin-plate theory, with a coefficient of the normal force of `slope` times the sine of the angle of
    attack, up to what a plate across the flow has.

    Args:
        area: Of the plate [m2].
        slope: Of the lift coefficient over the angle of attack [1/rad].
        speed: Of the plate through the water [m/s] (...,).
        across: The part of it along the plate's normal [m/s] (...,).
    """
    sine = across / xp.maximum(speed, 1e-6)
    return -WATER_DENSITY / 2 * area * speed**2 * xp.clip(slope * sine, -STALLED, STALLED)


@dataclass(frozen=True, kw_only=True)
class Underwater(Drive):
    """A hull afloat in water, one propeller, and plates in the flow at the stern.

    Propeller is positive ahead, Rudder to the right (manual 9.4's example). The manual gives no sign for
    SternPlane: here positive makes the boat rise, going ahead. The planes lift the stern and so the boat,
    which the righting moment keeps level: at 0.3 m/s it is far below the speed (over 2 m/s) from which on
    its pitch would take it the other way.

    A propeller of pitch p at n rad/s sends water back at w = n p / 2 pi; going at u it pushes with
    c (w |w| - u |u|), as an actuator disc does, and c is such that the boat makes good (1 - slip) w. Stopped
    it brakes. The water in the disc, and so past the plates, goes at (u + w) / 2. Without power the propeller
    turns freely and the plates with the flow.

    Attributes:
        hull: What the water acts on.
        propeller_pitch: Of the propeller [m].
        max_spin: Of the propeller [rad/s].
        slip: Share of the propeller's way that is lost.
        rudder_area: [m2].
        plane_area: [m2].
        max_angle: Of rudder and stern plane [rad].
        stern_arm: How far rudder and planes are behind the middle [m].
        slope: Of their lift coefficient over the angle of attack [1/rad].
    """

    hull: Hull
    propeller_pitch: float
    max_spin: float
    slip: float
    rudder_area: float
    plane_area: float
    max_angle: float
    stern_arm: float
    slope: float

    @property
    def vehicle(self) -> VehicleType:
        """The type that STA, GEO and CONF report."""
        return "NauticVehicle"

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports: the only one in manual 9.3's text, whose example differs."""
        return "VariableDepth"

    @property
    def full_scale(self) -> dict[str, float]:
        """Speed of the propeller [rad/s], angles of rudder and stern plane [rad]."""
        return {"Propeller": self.max_spin, "Rudder": self.max_angle, "SternPlane": self.max_angle}

    @property
    def top_speed(self) -> float:
        """What the propeller makes of its highest speed [m/s]."""
        return self.max_spin * self.propeller_pitch / (2 * math.pi) * (1 - self.slip)

    def steering_angles(self, joints: Mapping[str, float], setpoint: Array) -> dict[str, float]:
        """Return the angles of rudder and stern plane [rad]; they follow at once."""
        del joints
        return {"rudder": float(setpoint[1]), "stern_plane": float(setpoint[2])}

    @cached_property
    def _grip(self) -> float:
        """Thrust over squared speed of the water sent back [N s2/m2]."""
        advance = (1 - self.slip) ** 2
        return float(self.hull.drag_factors[0][0]) * advance / (1 - advance)

    def passive_wrench(self, state: RobotState, depth: Array) -> Array:
        """Return buoyancy and drag (..., 6), nothing outside water."""
        return self.hull.fluid_wrench(state, depth)

    def wrench(self, setpoint: Array, state: RobotState, depth: Array) -> Array:
        """Return what propeller, rudder and stern plane exert (..., 6)."""
        mat = mat_from_quat(state.quat)
        spin, rudder, plane = (setpoint[..., i] for i in range(3))
        linear = xp.moveaxis(matvec(mat.mT, state.linear), -1, 0)
        turn = xp.moveaxis(state.angular, -1, 0)
        wash = spin * self.propeller_pitch / (2 * math.pi)
        thrust = self._grip * (wash * xp.abs(wash) - linear[0] * xp.abs(linear[0]))
        # Flow at the plates: ahead as in the propeller's disc, to the left and up as the stern moves.
        ahead = (linear[0] + wash) / 2
        left = linear[1] - self.stern_arm * turn[2]
        up = linear[2] + self.stern_arm * turn[1]
        # Normals to the left and up at rest. Rudder right: its trailing edge goes to the right.
        sideways = plate_force(
            self.rudder_area,
            self.slope,
            xp.hypot(ahead, left),
            left * xp.cos(rudder) - ahead * xp.sin(rudder),
        )
        lift = plate_force(
            self.plane_area,
            self.slope,
            xp.hypot(ahead, up),
            up * xp.cos(plane) - ahead * xp.sin(plane),
        )
        drag = -sideways * xp.sin(rudder) - lift * xp.sin(plane)
        side, rise = sideways * xp.cos(rudder), lift * xp.cos(plane)
        force = xp.stack([thrust + drag, side, rise], -1)
        torque = xp.stack([xp.zeros_like(side), self.stern_arm * rise, -self.stern_arm * side], -1)
        share, _ = self.hull.immersion(depth, mat[..., 2, :])
        return self.hull.body_wrench(mat, share * force, share * torque, share)
