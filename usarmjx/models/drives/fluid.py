"""Forces of air and water on a hull: buoyancy, added mass and drag of an ellipsoid; the underwater drive.

All of it acts as an external wrench, so that every engine computes the same. Body axes are MuJoCo's (x
forward, y left, z up) with the origin in the hull's middle.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usarmjx.base.arrays import Array, ArrayLike
from usarmjx.base.backend import xp
from usarmjx.base.rotations import mat_from_quat, matvec
from usarmjx.base.transforms import GRAVITY, Vec3
from usarmjx.models.drives.base import Drive, RobotState, VehicleType

AIR_DENSITY, WATER_DENSITY = 1.225, 1000.0
"""Densities of air at sea level (ISA) and of fresh water [kg/m3]."""
QUADRATURE_NODES = 40
"""Gauss-Legendre nodes of Lamb's integrals, which reach an error of 1e-8 even for a rod 50 times as long as
wide."""

MAX_NORMAL_FORCE_COEF = 1.17
"""Normal force coefficient of a square plate across the flow (Hoerner, Fluid-Dynamic Drag, 3-9)."""


def shape_factors(radii: Vec3) -> np.ndarray:
    """Return Lamb's alpha, beta and gamma of an ellipsoid (3,); their sum is 2 (Hydrodynamics, 114).

    alpha = a b c times the integral over s from 0 to infinity of 1 / ((a^2 + s) sqrt((a^2 + s) (b^2 + s)
    (c^2 + s))). With s = (1 / t^2 - 1) r^2, r being the mean radius, the integrand is smooth on [0, 1].
    """
    points, weights = np.polynomial.legendre.leggauss(QUADRATURE_NODES)
    t, weights = (points + 1) / 2, weights / 2
    # The mean radius squared; the substitution of the docstring maps the infinite range to [0, 1].
    scale = math.prod(radii) ** (2 / 3)
    grown = scale + (np.square(radii)[:, None] - scale) * t**2  # t^2 (a^2 + s)
    integrals = 2 * scale * (weights * t**2 / grown / np.sqrt(grown.prod(0))).sum(1)
    return math.prod(radii) * integrals


def added_mass(radii: Vec3) -> tuple[np.ndarray, np.ndarray]:
    """Return the added mass of an ellipsoid, relative to the displaced fluid.

    Returns:
        Ratios to its mass for motion along the axes (3,), and to its moments of inertia for rotation about
        them (3,): k1, k2 and k' of Lamb's table (Hydrodynamics, 115) where two axes are equal.
    """
    factors, square = shape_factors(radii), np.square(radii)
    along = factors / (2 - factors)
    about = np.zeros(3)
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        difference, total, bent = square[j] - square[k], square[j] + square[k], factors[k] - factors[j]
        if difference:
            about[axis] = difference**2 * bent / (2 * difference - total * bent) / total
    return along, about


@dataclass(frozen=True, kw_only=True)
class Hull:
    """An ellipsoid that weighs as much as the fluid that it displaces, with its contents.

    Two things differ from a bare ellipsoid: the moment that turns a long hull broadside on (Munk's) is left
    out, as if fixed fins balanced it, and roll and pitch have some damping at rest.

    Attributes:
        radii: Half length, half width, half height [m].
        density: Density of the fluid [kg/m3].
        mass: Mass of the robot in the physics engine; less than the displaced fluid's where the gas in the
            hull does not count [kg].
        inertia: Moments of inertia in the physics engine, about its centre of gravity [kg m2].
        drag: Drag coefficients for flow along x, y and z, on the areas facing it.
        cog_depth: Depth of the centre of gravity below the hull's middle [m].
        damping: Damping ratio of roll and pitch.
    """

    radii: Vec3
    density: float
    mass: float
    inertia: Vec3
    drag: Vec3
    cog_depth: float
    damping: float = 0.2

    @cached_property
    def displaced_mass(self) -> float:
        """Mass of the displaced fluid [kg]."""
        return self.density * 4 / 3 * math.pi * math.prod(self.radii)

    @cached_property
    def weight(self) -> float:
        """Weight of the hull with its contents [N]."""
        return self.displaced_mass * GRAVITY

    @cached_property
    def displaced_inertia(self) -> np.ndarray:
        """Moments of inertia of the displaced fluid [kg m2] (3,)."""
        square = np.square(self.radii)
        return self.displaced_mass / 5 * (square.sum() - square)

    @cached_property
    def added_mass_factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Ratios of `added_mass`."""
        return added_mass(self.radii)

    @cached_property
    def drag_factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Drag over squared speed [N s2/m2] (3,), and its moment over squared turning rate [N m s2] (3,).

        The moment is that of the drag of all strips of the hull across the flow: the integral of
        sqrt(1 - t^2) |t|^3 over the hull's length is 4/15.
        """
        a, b, c = self.radii
        x, y, z = self.drag
        pressure = self.density / 2
        along = pressure * math.pi * np.array([x * b * c, y * a * c, z * a * b])
        about = np.array([a * (y * c**4 + z * b**4), b * (z * a**4 + x * c**4), c * (y * a**4 + x * b**4)])
        return along, pressure * 8 / 15 * about

    def effective_inertia(self, share: ArrayLike = 1.0) -> tuple[Array, Array]:
        """Return mass and inertia (..., 3) with the added mass, for an immersed share (..., 1)."""
        along, about = self.added_mass_factors
        return self.displaced_mass * (1 + share * along), self.displaced_inertia * (1 + share * about)

    def immersion(self, depth: Array, up: Array) -> tuple[Array, Array]:
        """Return the share of the hull under water (..., 1) and the centre of that volume [m] (..., 3).

        An ellipsoid is a stretched ball, and so is the part of it below a plane.

        Args:
            depth: Depth of the hull's middle below the surface [m] (...,).
            up: The upward direction in body axes (..., 3).
        """
        radii = np.array(self.radii, np.float32)
        reach = xp.linalg.norm(radii * up, axis=-1, keepdims=True)
        level = xp.clip(depth[..., None] / reach, -1.0, 1.0)
        # Volume and centroid of a spherical segment, in units of the ball's.
        share = (2 + 3 * level - level**3) / 4
        middle = -0.75 * (1 - level) ** 2 * (1 + level) ** 2 / xp.maximum(4 * share, 1e-6)
        return share, radii**2 * up / reach * middle

    def body_wrench(self, mat: Array, force: Array, torque: Array, share: ArrayLike = 1.0) -> Array:
        """Return the wrench (..., 6), world axes, that gives the engine's body the hull's acceleration.

        The engine knows neither the added mass nor the gas, so force and torque are scaled by the ratio of
        its inertia to the hull's.

        Args:
            mat: Orientation (..., 3, 3).
            force: Body axes [N] (..., 3).
            torque: About the centre of gravity, body axes [N m] (..., 3).
            share: Immersed share, which has added mass (..., 1).
        """
        mass, inertia = self.effective_inertia(share)
        force = force * (self.mass / mass)
        torque = torque * (np.array(self.inertia) / inertia)
        return xp.concatenate([matvec(mat, force), matvec(mat, torque)], -1)

    def fluid_wrench(self, state: RobotState, depth: Array | None = None) -> Array:
        """Return the wrench (..., 6), world axes, of weight, buoyancy and drag, without the engine's gravity.

        Args:
            state: The robots; leading axes (...,).
            depth: Depth of their origins below the surface [m] (...,); None: they are wholly immersed.
        """
        mat = mat_from_quat(state.quat)
        up, linear, angular = mat[..., 2, :], matvec(mat.mT, state.linear), state.angular
        share, middle = (1.0, np.zeros(3, np.float32)) if depth is None else self.immersion(depth, up)
        along, about = self.drag_factors
        mass, _ = self.effective_inertia(share)
        # Righting moment per angle; the damping is 2 z sqrt(k I), of the same ratio z at every size.
        stiff = np.array([1.0, 1.0, 0.0]) * self.weight * self.cog_depth
        calm = 2 * self.damping * np.sqrt(stiff * self.effective_inertia()[1])
        force = (share - 1) * self.weight * up - share * along * xp.abs(linear) * linear
        # The fluid dragged along keeps its momentum as the hull turns (Kirchhoff), not its speed.
        force = force + mass * xp.cross(angular, linear) - xp.cross(angular, mass * linear)
        lever = middle + np.array([0.0, 0.0, self.cog_depth])
        torque = xp.cross(lever, share * self.weight * up)
        torque = torque - share * (about * xp.abs(angular) + calm) * angular
        gravity = np.array([0.0, 0.0, self.mass * GRAVITY, 0.0, 0.0, 0.0])
        return self.body_wrench(mat, force, torque, share) + gravity


def plate_force(area: float, slope: float, speed: Array, across: Array) -> Array:
    """Return the force on a plate along its normal [N] (...,).

    Thin-plate theory: the coefficient of the normal force is `slope` times the sine of the angle of attack,
    up to that of a plate across the flow.

    Args:
        area: Area of the plate [m2].
        slope: Slope of the lift coefficient over the angle of attack [1/rad].
        speed: Speed of the plate through the water [m/s] (...,).
        across: Its component along the plate's normal [m/s] (...,).
    """
    sine = across / xp.maximum(speed, 1e-6)
    return (
        -WATER_DENSITY
        / 2
        * area
        * speed**2
        * xp.clip(slope * sine, -MAX_NORMAL_FORCE_COEF, MAX_NORMAL_FORCE_COEF)
    )


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
        hull: Hull in the water.
        propeller_pitch: Pitch of the propeller [m].
        max_spin: Highest speed of the propeller [rad/s].
        slip: Relative loss of the propeller's advance.
        rudder_area: Area of the rudder [m2].
        plane_area: Area of the stern plane [m2].
        max_angle: Largest angle of rudder and stern plane [rad].
        stern_arm: Distance of rudder and stern plane behind the middle [m].
        slope: Slope of their lift coefficient over the angle of attack [1/rad].
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
        """The vehicle type that STA, GEO and CONF report."""
        return "NauticVehicle"

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports: the only one in manual 9.3's text; its example has another."""
        return "VariableDepth"

    @property
    def full_scale(self) -> dict[str, float]:
        """Speed of the propeller [rad/s], angles of rudder and stern plane [rad]."""
        return {"Propeller": self.max_spin, "Rudder": self.max_angle, "SternPlane": self.max_angle}

    @property
    def top_speed(self) -> float:
        """Speed at the propeller's highest speed [m/s]."""
        return self.max_spin * self.propeller_pitch / (2 * math.pi) * (1 - self.slip)

    def steering_angles(self, joints: Mapping[str, float], setpoint: Array) -> dict[str, float]:
        """Return the angles of rudder and stern plane [rad]; they follow at once."""
        del joints
        return {"rudder": float(setpoint[1]), "stern_plane": float(setpoint[2])}

    @cached_property
    def _thrust_coefficient(self) -> float:
        """Thrust over squared speed of the wash [N s2/m2].

        At the steady speed (1 - slip) w thrust equals drag, which gives this ratio.
        """
        advance = (1 - self.slip) ** 2
        return float(self.hull.drag_factors[0][0]) * advance / (1 - advance)

    def passive_wrench(self, state: RobotState, depth: Array) -> Array:
        """Return buoyancy and drag (..., 6), zero outside water."""
        return self.hull.fluid_wrench(state, depth)

    def wrench(self, setpoint: Array, state: RobotState, depth: Array) -> Array:
        """Return the wrench of propeller, rudder and stern plane (..., 6)."""
        mat = mat_from_quat(state.quat)
        spin, rudder, plane = (setpoint[..., i] for i in range(3))
        linear = xp.moveaxis(matvec(mat.mT, state.linear), -1, 0)
        turn = xp.moveaxis(state.angular, -1, 0)
        wash = spin * self.propeller_pitch / (2 * math.pi)
        thrust = self._thrust_coefficient * (wash * xp.abs(wash) - linear[0] * xp.abs(linear[0]))
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
