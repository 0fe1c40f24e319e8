"""Drives in water and air, and the forces of both on a hull: buoyancy, added mass, drag of an ellipsoid.

All of it acts as an external wrench, so that every engine computes the same. Body axes are MuJoCo's (x
forward, y left, z up) with the origin in the hull's middle.

The flying drives are those of four rotors, and of a blimp with vectored thrust (manual 9.4, 12.20, 12.21.3).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usarmjx.base.backend import Array, ArrayLike, xp
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
    # Lamb, Hydrodynamics, 114: added mass along an axis over the displaced mass.
    along = factors / (2 - factors)
    about = np.zeros(3)
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        difference, total, bent = square[j] - square[k], square[j] + square[k], factors[k] - factors[j]
        # A body of revolution moves no fluid as it turns about its axis: the formula is 0 / 0 there.
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
        # In units of the half height along the vertical: -1 just above the water, 1 just below its surface.
        level = xp.clip(depth[..., None] / reach, -1.0, 1.0)
        # Volume and centroid of a spherical segment, in units of the ball's.
        share = (2 + 3 * level - level**3) / 4
        # Above the water both are 0.
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
        # The third row of the rotation is the world's vertical in body axes; MuJoCo's angular velocity is in
        # body axes already, its linear one in the world's.
        up, linear, angular = mat[..., 2, :], matvec(mat.mT, state.linear), state.angular
        # A blimp is surrounded by its fluid at any height.
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
        # The engine pulls the body down by its own weight; the hull's weight is in the force already.
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
    # At rest there is no flow, and the squared speed makes the force 0 whatever the angle.
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
        # Thrust c (w^2 - u^2) equals drag k u^2 at u = (1 - slip) w.
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
        # Out of the water propeller and plates push nothing.
        share, _ = self.hull.immersion(depth, mat[..., 2, :])
        return self.hull.body_wrench(mat, share * force, share * torque, share)


MAX_TILT = math.radians(65)
"""Largest tilt, whatever the command [rad]."""
MIN_LIFT_SHARE = 0.3
"""Smallest lift of the rotors, as a share of the weight."""


@dataclass(frozen=True, kw_only=True)
class RotaryWing(Drive):
    """Rotors that push along the body's up axis, and turn the body in order to move it.

    A cascade: speed is controlled by acceleration, acceleration by tilt, tilt by torque. Speeds are those of
    the body's heading, level with the ground; they are held until the next command. Signs: up, forward, to
    the right, clockwise seen from above.

    Attributes:
        max_speeds: Highest vertical, forward and lateral speed [m/s].
        max_turn: Highest rotational speed [rad/s].
        mass: Mass of the robot [kg].
        inertia: Moments of inertia about its centre of gravity [kg m2].
        drag_areas: Drag coefficient times area for air along x, y and z [m2].
        max_thrust: Largest thrust of all rotors together [N].
        max_torque: Largest torque of the rotors about x, y and z [N m].
        acceleration_tilt: Largest tilt for speeding up and slowing down [rad]; holding a speed may take more.
        speed_gain: Acceleration over error of speed [1/s].
        bandwidth: Bandwidth of the tilt control [rad/s]; the damping ratio is 0.9.
        turn_gain: Angular acceleration over error of turning rate [1/s].
    """

    max_speeds: Vec3
    max_turn: float
    mass: float
    inertia: Vec3
    drag_areas: Vec3
    max_thrust: float
    max_torque: Vec3
    acceleration_tilt: float
    speed_gain: float = 2.0
    bandwidth: float = 12.0
    turn_gain: float = 5.0

    @property
    def vehicle(self) -> VehicleType:
        """The vehicle type that STA, GEO and CONF report."""
        return "AerialVehicle"

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports."""
        return "RotaryWing"

    @property
    def full_scale(self) -> dict[str, float]:
        """Vertical, forward and lateral speed [m/s], rotational speed [rad/s]."""
        names = ("AltitudeVelocity", "LinearVelocity", "LateralVelocity")
        return {**dict(zip(names, self.max_speeds, strict=True)), "RotationalVelocity": self.max_turn}

    @property
    def top_speed(self) -> float:
        """Speed with all three components at their highest [m/s]."""
        return math.hypot(*self.max_speeds)

    def _drag(self, mat: Array, linear: Array) -> Array:
        """Return the drag of the air, world axes [N] (..., 3)."""
        # Areas belong to the faces of the body, so the speed is taken along its axes.
        speed, areas = matvec(mat.mT, linear), np.array(self.drag_areas, np.float32)
        return matvec(mat, -AIR_DENSITY / 2 * areas * xp.abs(speed) * speed)

    def passive_wrench(self, state: RobotState, depth: Array) -> Array:
        """Return the drag of the air (..., 6)."""
        del depth
        force = self._drag(mat_from_quat(state.quat), state.linear)
        return xp.concatenate([force, xp.zeros_like(force)], -1)

    def wrench(self, setpoint: Array, state: RobotState, depth: Array) -> Array:
        """Return thrust and torque of the rotors (..., 6)."""
        del depth
        mat = mat_from_quat(state.quat)
        turn = -setpoint[..., 3:]  # clockwise to counter-clockwise
        force = self._wanted_force(setpoint, mat, state.linear, turn)
        axis = mat[..., 2]
        thrust = xp.clip(_thrust(force, axis), 0.0, self.max_thrust) * axis
        return xp.concatenate([thrust, matvec(mat, self._torque(force, mat, state.angular, turn))], -1)

    def _wanted_force(self, setpoint: Array, mat: Array, linear: Array, turn: Array) -> Array:
        """Return the wanted force of the rotors, world axes [N] (..., 3): against weight, drag and inertia.

        Args:
            setpoint: One number per key (..., 4).
            mat: Orientations (..., 3, 3).
            linear: Velocities [m/s] (..., 3).
            turn: Turning rates to the left [rad/s] (..., 1).
        """
        # A body that points straight up has no heading: then no level speed is wanted.
        heading = mat[..., :2, 0] / xp.maximum(_length(mat[..., :2, 0]), 1e-6)
        level = setpoint[..., 1:2] * heading - setpoint[..., 2:3] * _left_of(heading)
        wanted = xp.concatenate([level, setpoint[..., :1]], -1)
        push = self.speed_gain * (wanted - linear)
        strongest = GRAVITY * math.tan(self.acceleration_tilt)
        # Shortened as a whole: the direction stays.
        share = strongest / xp.maximum(_length(push[..., :2]), strongest)
        # A speed that turns with the body is an acceleration towards the inside of the curve.
        level_push = push[..., :2] * share + turn * _left_of(level)
        force = self.mass * xp.concatenate([level_push, push[..., 2:]], -1) - self._drag(mat, linear)
        weight = self.mass * GRAVITY
        # Some lift is always wanted: a force of 0 has no direction to turn into.
        rise = xp.clip(force[..., 2:] + weight, MIN_LIFT_SHARE * weight, self.max_thrust)
        most = rise * math.tan(MAX_TILT)
        sideways = force[..., :2] * (most / xp.maximum(_length(force[..., :2]), most))
        return xp.concatenate([sideways, rise], -1)

    def _torque(self, force: Array, mat: Array, angular: Array, turn: Array) -> Array:
        """Return the torque, body axes [N m] (..., 3), that turns the up axis into the force, and yaws.

        Args:
            force: Wanted force, world axes [N] (..., 3).
            mat: Orientations (..., 3, 3).
            angular: Turning rates, body axes [rad/s] (..., 3).
            turn: Wanted turning rates about the vertical [rad/s] (..., 1).
        """
        wanted = matvec(mat.mT, force / _length(force))  # body axes
        tilt = _left_of(wanted[..., :2])  # z cross wanted: its length is the angle's sine
        up = wanted[..., 2:]
        # Beyond a right angle the sine falls again: there the tilt counts in full.
        tilt = xp.where(up > 0, tilt, tilt / xp.maximum(_length(tilt), 1e-3))
        # Upside down the axis of the tilt is undefined: turn over the side.
        tilt = xp.where(up < -0.99, np.array([1.0, 0.0], np.float32), tilt)
        rate = angular - turn * mat[..., 2, :]
        pull = xp.concatenate([self.bandwidth**2 * tilt, xp.zeros_like(up)], -1)
        # 1.8 is twice the damping ratio 0.9.
        gains = np.array([1.8 * self.bandwidth, 1.8 * self.bandwidth, self.turn_gain], np.float32)
        most = np.array(self.max_torque, np.float32)
        return xp.clip(np.array(self.inertia, np.float32) * (pull - gains * rate), -most, most)


def _length(vector: Array) -> Array:
    """Return the length of vectors (..., n) as (..., 1)."""
    return xp.linalg.norm(vector, axis=-1, keepdims=True)


def _left_of(level: Array) -> Array:
    """Return vectors in the x-y plane (..., 2), turned a quarter to the left."""
    return xp.stack([-level[..., 1], level[..., 0]], -1)


def _thrust(force: Array, axis: Array) -> Array:
    """Return the thrust along the body's up axis (..., 3) for a wanted force (..., 3) [N] (..., 1).

    While the axis is near the force, the thrust keeps the height. A body far from its wanted attitude, as
    after a crash, must not push itself on: only the component of the force along the axis remains.
    """
    near, far = math.cos(math.radians(5)), math.cos(math.radians(15))
    # 0.1 below keeps a body on its side from dividing by zero.
    along = (force * axis).sum(-1, keepdims=True)
    trust = xp.clip((along / _length(force) - far) / (near - far), 0.0, 1.0)
    return along + trust * (force[..., 2:] / xp.maximum(axis[..., 2:], 0.1) - along)


@dataclass(frozen=True, kw_only=True)
class Blimp(Drive):
    """Two thrusters on a bar that turns, and a propeller at the tail.

    ThrustPropeller is the wanted speed along the bar's direction in the body's x-z plane, XZAngle that
    direction, positive upward; TailPropeller is the turning rate, positive to the left (manual 12.21.3's
    example turns right with -0.3). It takes the keys of other flying robots too. Manual 12.21.1 gives the
    same top speed forward and upward, though the hull has many times the drag upward: so a governor adjusts
    the thrust to hold the speed, and damps sideways drift (chosen). All forces act through the centre of
    gravity.

    Attributes:
        hull: Hull in the air.
        max_angle: Largest angle of the bar [rad].
        max_thrust_speed: Highest speed [m/s].
        max_turn: Highest turning rate [rad/s].
        max_thrust: Largest thrust of both thrusters [N].
        max_torque: Largest torque of the tail propeller [N m].
        response: Time constant of the governors [s].
        leeway: Time in which its governors remove two thirds of a sideways drift [s].
    """

    hull: Hull
    max_angle: float
    max_thrust_speed: float
    max_turn: float
    max_thrust: float
    max_torque: float
    response: float = 2.0
    leeway: float = 4.0

    @property
    def vehicle(self) -> VehicleType:
        """The vehicle type that STA, GEO and CONF report."""
        return "AerialVehicle"

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports: manual 9.3 has only this one for flying robots."""
        return "RotaryWing"

    @property
    def full_scale(self) -> dict[str, float]:
        """Angle of the thrusters [rad], speed [m/s], turning rate [rad/s]."""
        return {
            "XZAngle": self.max_angle,
            "ThrustPropeller": self.max_thrust_speed,
            "TailPropeller": self.max_turn,
        }

    @property
    def other_keys(self) -> dict[str, float]:
        """Keys of flying robots (manual 9.4); it cannot move sideways, so 0 is the only lateral speed."""
        speed = self.max_thrust_speed
        names = ("AltitudeVelocity", "LinearVelocity", "LateralVelocity", "RotationalVelocity")
        return dict(zip(names, (speed, speed, 0.0, self.max_turn), strict=True))

    def to_own_keys(self, values: Mapping[str, ArrayLike], setpoint: Array) -> Mapping[str, ArrayLike]:
        """Return speeds up and ahead as the bar's angle and the speed along it, and turns with its sign."""
        most = {**self.full_scale, **self.other_keys}
        # Each key is limited by itself: one that is too large leaves the others what they are.
        given = {
            key: xp.clip(xp.asarray(value, xp.float32), -most[key], most[key])
            for key, value in values.items()
        }
        own: dict[str, ArrayLike] = {key: value for key, value in given.items() if key not in self.other_keys}
        if "RotationalVelocity" in given:
            own["TailPropeller"] = -given["RotationalVelocity"]
        if "AltitudeVelocity" in given or "LinearVelocity" in given:
            angle, speed = setpoint[..., 0], setpoint[..., 1]
            # The component that is not given keeps its present value.
            up = given.get("AltitudeVelocity", speed * xp.sin(angle))
            ahead = given.get("LinearVelocity", speed * xp.cos(angle))
            # XZAngle covers a half turn only: a speed backwards is a negative speed along the opposite
            # direction.
            sign = xp.where(ahead < 0.0, -1.0, 1.0)
            total = xp.hypot(up, ahead)
            own["XZAngle"] = xp.where(total > 1e-6, xp.arctan2(sign * up, sign * ahead), angle)
            own["ThrustPropeller"] = sign * total
        return own

    @property
    def limits(self) -> np.ndarray:
        """Largest absolute value of each key (keys,): both speeds of the other keys at once add up."""
        own = super().limits
        return own * np.array([1.0, math.sqrt(2.0), 1.0], np.float32)

    @property
    def top_speed(self) -> float:
        """Highest speed, ahead and up at once [m/s]."""
        return math.sqrt(2.0) * self.max_thrust_speed

    def passive_wrench(self, state: RobotState, depth: Array) -> Array:
        """Return lift and drag (..., 6)."""
        del depth
        return self.hull.fluid_wrench(state)

    def wrench(self, setpoint: Array, state: RobotState, depth: Array) -> Array:
        """Return thrust and the tail propeller's torque (..., 6)."""
        del depth
        mat = mat_from_quat(state.quat)
        angle, speed, turn = (setpoint[..., i : i + 1] for i in range(3))
        along, about = self.hull.drag_factors
        mass, inertia = self.hull.effective_inertia()
        linear = matvec(mat.mT, state.linear)
        wanted = speed * xp.concatenate([xp.cos(angle), xp.zeros_like(angle), xp.sin(angle)], -1)
        # Drag at the wanted speed is fed forward; a gain makes up for the rest within the response time.
        thrust = along * xp.abs(wanted) * wanted + mass / self.response * (wanted - linear)
        thrust = thrust + xp.cross(state.angular, mass * linear)  # Coriolis force of the turn
        # The bar lies in the x-z plane: its thrusters cannot push sideways.
        thrust = thrust * np.array([1.0, 0.0, 1.0])
        thrust = thrust * (self.max_thrust / xp.maximum(_length(thrust), self.max_thrust))
        aside = np.array([0.0, 1.0, 0.0], np.float32) * mass / self.leeway
        thrust = thrust - xp.clip(aside * linear, -self.max_thrust, self.max_thrust)
        error = turn - state.angular[..., 2:]
        torque = about[2] * xp.abs(turn) * turn + inertia[2] / self.response * error
        torque = xp.clip(torque, -self.max_torque, self.max_torque) * np.array([0.0, 0.0, 1.0])
        return self.hull.body_wrench(mat, thrust, torque)
