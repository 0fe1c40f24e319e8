"""What robots see of what is around them: their range sensors' readings as numbers from 0 to 1."""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.models.build.body_plan import BodyPoses
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.ranging import RangeScanner
from usarmjx.sensors.suite import suite_of
from usarmjx.train.envs.task import TaskView

MAX_READINGS = 24
"""More readings of one sensor than this are seen in sectors."""
MAX_RANGE = 5.0
"""What is farther away than this looks alike [m]: a sonar's range."""


def first_kind(robot: RobotSpec, kinds: tuple[str, ...]) -> str | None:
    """Return the first of some types of sensors that a robot has; None: it has none of them."""
    there = {mount.kind.lower() for mount in robot.sensors}
    return next((kind for kind in kinds if kind.lower() in there), None)


def ranges(view: TaskView, group: int, kinds: tuple[str, ...]) -> jax.Array:
    """Return what a group's range sensors see (robots, n): 0 touching, 1 free for `MAX_RANGE` or more.

    Of the given types the first that the robots have is read. Of more than `MAX_READINGS` readings the
    shortest of each of equal sectors counts.
    """
    robots = len(view.scene.groups[group].slots)
    kind = first_kind(view.scene.groups[group].robot, kinds)
    if kind is None:
        return jnp.zeros((robots, 0))
    seen = view.sensor(group, kind).reshape(robots, -1)
    return jnp.clip(reduce_to_sectors(seen) / MAX_RANGE, 0.0, 1.0)


def range_lines(robot: RobotSpec, kinds: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return what lines `ranges` measures along, on a level robot's axes.

    Returns:
        Where they begin, x forward and y left [m] (n, 2), and their directions, positive to the left
        [rad] (n,); those of a sector are its middle's.
    """
    kind = first_kind(robot, kinds)
    if kind is None:
        return np.zeros((0, 2), np.float32), np.zeros(0, np.float32)
    suite = suite_of(robot)
    sensor, plan = suite.sensors[suite.index(kind)], suite.plan
    with jax.ensure_compile_time_eval():  # constants, whoever is being traced
        rest = BodyPoses(pos=jnp.asarray(plan.rest_pos), mat=jnp.tile(jnp.eye(3), (len(plan.parts), 1, 1)))
        pos, mat = map(np.asarray, sensor.mount_poses(rest))
    along = sensor.directions() @ mat[0].T if isinstance(sensor, RangeScanner) else mat[:, :, 0]
    origin = np.broadcast_to(pos[:, :2] if len(pos) > 1 else pos[:1, :2], (len(along), 2))
    angle = np.arctan2(along[:, 1], along[:, 0])
    each = -(-len(angle) // MAX_READINGS)
    middles = np.array(
        [len(part) // 2 + part[0] for part in np.split(np.arange(len(angle)), _cuts(angle, each))]
    )
    return origin[middles].astype(np.float32), angle[middles].astype(np.float32)


def _cuts(angle: np.ndarray, each: int) -> list[int]:
    return list(range(each, len(angle), each))


def reduce_to_sectors(seen: jax.Array) -> jax.Array:
    """Return the shortest of each of at most `MAX_READINGS` equal sectors of readings (..., n)."""
    n = seen.shape[-1]
    each = -(-n // MAX_READINGS)
    room = -(-n // each) * each - n
    padded = jnp.concatenate([seen, jnp.full((*seen.shape[:-1], room), jnp.inf)], -1)
    return padded.reshape(*seen.shape[:-1], -1, each).min(-1)
