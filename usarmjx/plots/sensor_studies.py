"""What sensors read in known situations: the numbers behind the plots of docs/sensors.md."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.transforms import angles_from_mat
from usarmjx.cameras.picture import Picture
from usarmjx.models.build.body_plan import forward_kinematics
from usarmjx.models.drives.state import RobotState
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.spec.arena import ArenaSpec, StartPose
from usarmjx.models.spec.robot import Mount, options
from usarmjx.sensors.base import Sensor, SensorInput
from usarmjx.sensors.gps import MAX_SATELLITES
from usarmjx.sensors.ranging import RangeSettings, range_readings
from usarmjx.sensors.rays.raycast import NO_HITS, Hits
from usarmjx.sensors.rfid import RfidSettings
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene
from usarmjx.sim.world import sense_self

START_HEIGHT = 0.188
"""Height of start poses above the ground (manual 5.3.5) [m]."""
PATH_LENGTH, PATH_HALF_WIDTH, PATH_PERIODS = 30.0, 7.0, 3
"""The winding way that is driven for the INS: length and half width [m], and how many times it swings."""
DRIVE_SECONDS = 300.0
"""How long that takes [s]."""


@dataclass(frozen=True, eq=False)
class RangeStudy:
    """What the range sensors of a robot read at one position, in world axes.

    Attributes:
        pose: x, y [m] and yaw [rad] of the robot (3,).
        origin: Where the laser's beams start [m] (2,).
        ends: Where they end [m] (beams, 2).
        hit: Whether they met something (beams,).
        sonars: x, y [m] and yaw [rad] of the sonars (sonars, 3).
        echoes: What they read [m] (sonars,).
        beam_angle: Full angle of each sonar's cone [rad] (sonars,).
        no_echo: Whether they heard nothing (sonars,).
    """

    pose: np.ndarray
    origin: np.ndarray
    ends: np.ndarray
    hit: np.ndarray
    sonars: np.ndarray
    echoes: np.ndarray
    beam_angle: np.ndarray
    no_echo: np.ndarray


def range_study(
    arena: ArenaSpec, at: tuple[float, float], yaw: float, robot: str = "P2AT", seed: int = 0
) -> RangeStudy:
    """Return what laser scanner and sonars of a robot read, once, that stands at x, y [m].

    Raises:
        UnknownNameError: No such robot, or it has no scanner or no sonars.
    """
    kept = tuple(m for m in ROBOTS.get(robot).sensors if m.kind in ("RangeScanner", "Sonar"))
    spec = replace(ROBOTS.get(robot), name=f"{robot} with ranges", sensors=kept)
    start = StartPose(tag="Here", at=(*at, START_HEIGHT), yaw=yaw)
    batch = Batch(build_scene(replace(arena, starts=(start,)), [spec]), engine="c", seed=seed)
    state, ((*readings,),) = batch.observe(batch.reset())
    group = batch.scene.groups[0]
    world, physics = jax.tree.map(lambda x: x[0], (state.worlds, batch.physics(state)))
    bodies = jax.tree.map(lambda x: x[0], sense_self(batch.scene, world, physics, group).bodies)
    scanner, ring = (group.suite.index(kind) for kind in ("RangeScanner", "Sonar"))
    beams, echoes = (np.asarray(readings[index].value)[0, 0] for index in (scanner, ring))
    origin, along = (np.asarray(v)[:, :2] for v in group.suite.sensors[scanner].rays(bodies))
    pos, mat = map(np.asarray, group.suite.sensors[ring].mount_poses(bodies))
    limit = group.suite.sensors[scanner].settings[0].max_range
    sonars = group.suite.sensors[ring].settings
    return RangeStudy(
        pose=np.array([*np.asarray(bodies.pos)[0, :2], angles_from_mat(np.asarray(bodies.mat)[0])[2]]),
        origin=origin[0],
        ends=origin + along * beams[:, None],
        hit=beams < limit,
        sonars=np.column_stack([pos[:, :2], angles_from_mat(mat)[:, 2]]),
        echoes=echoes,
        beam_angle=np.array([settings.beam_angle for settings in sonars]),
        no_echo=echoes >= np.array([settings.max_range for settings in sonars], np.float32),
    )


def camera_study(
    arena: ArenaSpec,
    at: tuple[float, float],
    yaw: float,
    robot: str,
    width: int,
    height: int,
    *,
    camera: int = 0,
) -> Picture:
    """Return what a camera of a robot sees (height, width, ...) that stands at x, y [m].

    Raises:
        UnknownNameError: No such robot or camera.
    """
    spec = replace(ROBOTS.get(robot), name=f"{robot} without sensors", sensors=())
    start = StartPose(tag="Here", at=(*at, START_HEIGHT), yaw=yaw)
    batch = Batch(build_scene(replace(arena, starts=(start,)), [spec]), engine="c")
    return jax.tree.map(np.asarray, batch.render_robot(batch.reset(), 0, 0, camera, width, height))


def single_sensor(kind: str, **settings: object) -> Sensor:
    """Return a sensor on the origin of a P2AT that has no other."""
    mount = Mount(kind=kind, name=kind, options=options(**settings))
    return suite_of(replace(P2AT, name=f"P2AT with {kind}", sensors=(mount,))).sensors[0]


def sensor_input_at(
    sensor: Sensor, pos: jax.Array, yaw: jax.Array, time: jax.Array, hits: Hits = NO_HITS
) -> SensorInput:
    """Return what a sensor draws on at a position (3,) and with a heading (), the robot's wheels at rest."""
    joints = jnp.zeros(len(sensor.plan.parts) - 1)
    zero, turn = jnp.zeros(3), jnp.stack([jnp.cos(yaw / 2), 0.0 * yaw, 0.0 * yaw, jnp.sin(yaw / 2)])
    state = RobotState(pos=pos, quat=turn, linear=zero, angular=zero, joint_pos=joints, joint_vel=joints)
    return SensorInput(time=time, state=state, bodies=forward_kinematics(sensor.plan, state), hits=hits)


def winding_path(step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] (n,) and x, y [m], yaw [rad] (n, 3) of a drive along a winding way."""
    times = np.arange(0.0, DRIVE_SECONDS + step / 2, step)
    share, swing = times / DRIVE_SECONDS, 2 * np.pi * PATH_PERIODS
    yaw = np.arctan2(PATH_HALF_WIDTH * swing * np.cos(swing * share), PATH_LENGTH)
    return times, np.column_stack([PATH_LENGTH * share, PATH_HALF_WIDTH * np.sin(swing * share), yaw])


def ins_paths(runs: int, seed: int = 0, **settings: object) -> np.ndarray:
    """Return where INS sensors believe that they are on the winding way: x, y [m] (runs, n, 2).

    Args:
        runs: How many drive it, each with noise and drift of its own.
        seed: Of the noise.
        **settings: Of the sensors.
    """
    sensor = single_sensor("INS", **settings)
    times, poses = (jnp.asarray(v, jnp.float32) for v in winding_path(sensor.settings[0].scan_interval))

    def run(key: jax.Array) -> jax.Array:
        def at(i: jax.Array) -> SensorInput:
            return sensor_input_at(sensor, jnp.append(poses[i, :2], 0.0), poses[i, 2], times[i])

        def step(memory: object, i: jax.Array) -> tuple[object, jax.Array]:
            memory, value = sensor.read(at(i), memory, jax.random.fold_in(key, i))
            return memory, jnp.asarray(value)[:2]

        # The first reading is the truth, and its noise nothing: the robot has not moved yet.
        return jax.lax.scan(step, sensor.init_memory(at(jnp.int32(0)), key), jnp.arange(len(times)))[1]

    keys = jax.vmap(partial(jax.random.fold_in, jax.random.key(seed)))(jnp.arange(runs))
    return np.asarray(jax.jit(jax.vmap(run))(keys))


def gps_errors(satellites: int, readings: int, seed: int = 0, **settings: object) -> np.ndarray:
    """Return by how much a GPS is wrong that sees so many satellites: x, y [m] (readings, 2)."""
    sensor = single_sensor("GPS", **settings)
    seen = jnp.where(jnp.arange(MAX_SATELLITES) < satellites, jnp.inf, 1.0)
    hits = Hits(distance=seen, cosine=jnp.zeros(MAX_SATELLITES))
    inputs = sensor_input_at(sensor, jnp.zeros(3), jnp.float32(0.0), jnp.float32(0.0), hits)
    keys = jax.random.split(jax.random.key(seed), readings)
    return np.asarray(jax.jit(jax.vmap(lambda key: sensor.read(inputs, (), key)[1][:2]))(keys))


def reported_ranges(distance: np.ndarray, settings: RangeSettings, seed: int = 0) -> np.ndarray:
    """Return what a range sensor reports of true distances [m] (n,), each measured for itself."""
    keys = jax.random.split(jax.random.key(seed), len(distance))
    return np.asarray(
        jax.vmap(lambda d, key: range_readings(d[None, None], (settings,), key)[0, 0])(distance, keys)
    )


def rfid_range(settings: RfidSettings, *, blocked: bool) -> float:
    """Return up to where a tag is read in the mode Attenuation [m] (manual 10.9.3.3, solved for d)."""
    loss = settings.tx_power_dbm - settings.rx_sensitivity_dbm
    return 10 ** (((loss - settings.obstacle_attenuation_db * blocked) / 20 - 5.25) / 2)
