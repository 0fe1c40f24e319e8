"""Drives of flying robots: four rotors, and a blimp with vectored thrust (manual 9.4, 12.20, 12.21.3)."""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import GRAVITY, Vec3
from usarmjx.models.drives.base import Drive, VehicleType
from usarmjx.models.drives.fluid import AIR_DENSITY, Hull
from usarmjx.models.drives.state import RobotState

MAX_TILT = math.radians(65)
"""No more tilt than this, whatever is asked [rad]."""
LOWEST_LIFT = 0.3
"""Rotors carry at least this share of the weight."""


@dataclass(frozen=True, kw_only=True)
class RotaryWing(Drive):
    """Rotors that push along the body's up axis, and turn the body to push where it should go.

    Speed is controlled by acceleration, that by tilt, that by torque. Speeds are those of the body's
    heading, level with the ground; they are held until the next command. Signs: up, forward, to the right,
    clockwise seen from above.

    Attributes:
        max_speeds: Highest vertical, forward and lateral speed [m/s].
        max_turn: Highest rotational speed [rad/s].
        mass: Of the robot [kg].
        inertia: About its centre of gravity [kg m2].
        drag_areas: Drag coefficient times area for air along x, y and z [m2].
        max_thrust: Of all rotors together [N].
        max_torque: Of the rotors about x, y and z [N m].
        acceleration_tilt: Tilt for speeding up and slowing down [rad]; holding a speed may take more.
        speed_gain: Acceleration over error of speed [1/s].
        bandwidth: Of the tilt [rad/s]; the damping ratio is 0.9.
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
        """The type that STA, GEO and CONF report."""
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
        """All three speeds at once [m/s]."""
        return math.hypot(*self.max_speeds)

    def _drag(self, mat: jax.Array, linear: Array) -> jax.Array:
        """Return the force of the air, world axes [N] (3,)."""
        speed = linear @ mat
        return mat @ (-AIR_DENSITY / 2 * np.array(self.drag_areas, np.float32) * jnp.abs(speed) * speed)

    def passive_wrench(self, state: RobotState, depth: Array) -> jax.Array:
        """Return the drag of the air (6,)."""
        del depth
        return jnp.concatenate([self._drag(mat_from_quat(state.quat), state.linear), jnp.zeros(3)])

    def wrench(self, setpoint: Array, state: RobotState, depth: Array) -> jax.Array:
        """Return thrust and torque of the rotors (6,)."""
        del depth
        mat = mat_from_quat(state.quat)
        turn = -setpoint[3]  # clockwise to counter-clockwise
        force = self._wanted_force(setpoint, mat, state.linear, turn)
        thrust = jnp.clip(_thrust(force, mat[:, 2]), 0.0, self.max_thrust) * mat[:, 2]
        return jnp.concatenate([thrust, mat @ self._torque(force, mat, state.angular, turn)])

    def _wanted_force(self, setpoint: Array, mat: jax.Array, linear: Array, turn: jax.Array) -> jax.Array:
        """Return what the rotors should exert, world axes [N] (3,): against weight, drag and inertia."""
        heading = mat[:2, 0] / jnp.maximum(jnp.linalg.norm(mat[:2, 0]), 1e-6)
        left = jnp.stack([-heading[1], heading[0]])
        level = setpoint[1] * heading - setpoint[2] * left
        wanted = jnp.append(level, setpoint[0])
        push = self.speed_gain * (wanted - linear)
        strongest = GRAVITY * math.tan(self.acceleration_tilt)
        sideways = jnp.linalg.norm(push[:2])
        push = push.at[:2].multiply(strongest / jnp.maximum(sideways, strongest))
        # A speed that turns with the body is an acceleration towards the inside of the curve.
        inward = turn * jnp.array([-level[1], level[0], 0.0])
        force = self.mass * (push + inward) - self._drag(mat, linear)
        rise = jnp.clip(force[2] + self.mass * GRAVITY, LOWEST_LIFT * self.mass * GRAVITY, self.max_thrust)
        most = rise * math.tan(MAX_TILT)
        return jnp.append(force[:2] * (most / jnp.maximum(jnp.linalg.norm(force[:2]), most)), rise)

    def _torque(self, force: jax.Array, mat: jax.Array, angular: Array, turn: jax.Array) -> jax.Array:
        """Return the torque that tilts the up axis into the force and turns about the vertical (3,)."""
        wanted = (force / jnp.linalg.norm(force)) @ mat  # body axes
        tilt = jnp.stack([-wanted[1], wanted[0]])  # z cross wanted: its length is the angle's sine
        tilt = jnp.where(wanted[2] > 0, tilt, tilt / jnp.maximum(jnp.linalg.norm(tilt), 1e-3))
        # Upside down every axis is as good: over its side.
        tilt = jnp.where(wanted[2] < -0.99, jnp.array([1.0, 0.0]), tilt)
        rate = angular - turn * mat[2]
        pull = jnp.append(self.bandwidth**2 * tilt, 0.0)
        damp = jnp.array([1.8 * self.bandwidth, 1.8 * self.bandwidth, self.turn_gain]) * rate
        most = np.array(self.max_torque, np.float32)
        return jnp.clip(np.array(self.inertia, np.float32) * (pull - damp), -most, most)


def _thrust(force: jax.Array, axis: jax.Array) -> jax.Array:
    """Return how hard to push along the body's up axis (3,) for a wanted force (3,) [N] ().

    While the axis is near the force, as hard as keeps the height. A body that is far from where it should
    point, as after a crash, does not push itself on: only the part of the force along the axis remains.
    """
    near, far = math.cos(math.radians(5)), math.cos(math.radians(15))
    along = force @ axis
    trust = jnp.clip((along / jnp.linalg.norm(force) - far) / (near - far), 0.0, 1.0)
    return along + trust * (force[2] / jnp.maximum(axis[2], 0.1) - along)


@dataclass(frozen=True, kw_only=True)
class Blimp(Drive):
    """Two thrusters on a bar that turns, and a propeller at the tail.

    ThrustPropeller is the speed to be had along the bar's direction in the body's x-z plane, XZAngle that
    direction, positive upward; TailPropeller is the turning rate, positive to the left (manual 12.21.3's
    example turns right with -0.3). Manual 12.21.1 gives the same top speed forward and upward, though the
    hull has many times the drag upward: so the thrust is governed to hold the speed. Both forces act
    through the centre of gravity.

    Attributes:
        hull: What the air acts on.
        max_angle: Largest angle of the bar [rad].
        max_thrust_speed: Highest speed [m/s].
        max_turn: Highest turning rate [rad/s].
        max_thrust: Of both thrusters [N].
        max_torque: Of the tail propeller [N m].
        response: Time in which the governors close an error [s].
    """

    hull: Hull
    max_angle: float
    max_thrust_speed: float
    max_turn: float
    max_thrust: float
    max_torque: float
    response: float = 2.0

    @property
    def vehicle(self) -> VehicleType:
        """The type that STA, GEO and CONF report."""
        return "AerialVehicle"

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports: manual 9.3 knows only this one for what flies."""
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
    def top_speed(self) -> float:
        """In any direction [m/s]."""
        return self.max_thrust_speed

    def passive_wrench(self, state: RobotState, depth: Array) -> jax.Array:
        """Return lift and drag (6,)."""
        del depth
        return self.hull.fluid_wrench(state)

    def wrench(self, setpoint: Array, state: RobotState, depth: Array) -> jax.Array:
        """Return thrust and the tail propeller's torque (6,)."""
        del depth
        mat = mat_from_quat(state.quat)
        angle, speed, turn = setpoint[0], setpoint[1], setpoint[2]
        along, about = self.hull.drag_factors
        mass, inertia = self.hull.effective_inertia()
        linear = state.linear @ mat
        wanted = speed * jnp.stack([jnp.cos(angle), 0.0 * angle, jnp.sin(angle)])
        thrust = along * jnp.abs(wanted) * wanted + mass / self.response * (wanted - linear)
        thrust += jnp.cross(state.angular, mass * linear)  # what a turn takes from the speed ahead
        thrust = thrust * np.array([1.0, 0.0, 1.0])
        thrust *= self.max_thrust / jnp.maximum(jnp.linalg.norm(thrust), self.max_thrust)
        error = turn - state.angular[2]
        torque = about[2] * jnp.abs(turn) * turn + inertia[2] / self.response * error
        torque = jnp.clip(torque, -self.max_torque, self.max_torque) * jnp.array([0.0, 0.0, 1.0])
        return self.hull.body_wrench(mat, thrust, torque)
