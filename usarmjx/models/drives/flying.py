"""Drives of flying robots: four rotors, and a blimp with vectored thrust (manual 9.4, 12.20, 12.21.3)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from usarmjx.base.arrays import Array, ArrayLike
from usarmjx.base.backend import xp
from usarmjx.base.rotations import mat_from_quat, matvec
from usarmjx.base.transforms import GRAVITY, Vec3
from usarmjx.models.drives.base import Drive, RobotState, VehicleType
from usarmjx.models.drives.fluid import AIR_DENSITY, Hull

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
        heading = mat[..., :2, 0] / xp.maximum(_length(mat[..., :2, 0]), 1e-6)
        level = setpoint[..., 1:2] * heading - setpoint[..., 2:3] * _left_of(heading)
        wanted = xp.concatenate([level, setpoint[..., :1]], -1)
        push = self.speed_gain * (wanted - linear)
        strongest = GRAVITY * math.tan(self.acceleration_tilt)
        share = strongest / xp.maximum(_length(push[..., :2]), strongest)
        # A speed that turns with the body is an acceleration towards the inside of the curve.
        level_push = push[..., :2] * share + turn * _left_of(level)
        force = self.mass * xp.concatenate([level_push, push[..., 2:]], -1) - self._drag(mat, linear)
        weight = self.mass * GRAVITY
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
        thrust = along * xp.abs(wanted) * wanted + mass / self.response * (wanted - linear)
        thrust = thrust + xp.cross(state.angular, mass * linear)  # Coriolis force of the turn
        thrust = thrust * np.array([1.0, 0.0, 1.0])
        thrust = thrust * (self.max_thrust / xp.maximum(_length(thrust), self.max_thrust))
        aside = np.array([0.0, 1.0, 0.0], np.float32) * mass / self.leeway
        thrust = thrust - xp.clip(aside * linear, -self.max_thrust, self.max_thrust)
        error = turn - state.angular[..., 2:]
        torque = about[2] * xp.abs(turn) * turn + inertia[2] / self.response * error
        torque = xp.clip(torque, -self.max_torque, self.max_torque) * np.array([0.0, 0.0, 1.0])
        return self.hull.body_wrench(mat, thrust, torque)
