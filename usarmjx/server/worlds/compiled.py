"""The functions of one robot class in a served world, compiled before a robot of that class appears."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.models.build.body_plan import Bodies, body_plan, body_poses
from usarmjx.models.drives.state import RobotState
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.base import Sight
from usarmjx.sensors.rays.raycast import NO_HITS, Hits
from usarmjx.sensors.suite import Memory, suite_of
from usarmjx.sensors.surroundings import NOTHING, Surroundings
from usarmjx.sim.control import Circumstances, Command, Driven, drive, idle
from usarmjx.sim.world import depth_in_water, drowns

RAYS = 512
"""Robots cast their rays in lots of this size, so that few sizes are ever compiled."""


class Compiled:
    """The functions of one robot class, compiled here and not at their first call.

    The rays, which take longest to compile, are cast by a function that all classes share.
    """

    def __init__(
        self, robot: RobotSpec, arena: ArenaSpec, period: float, around: Surroundings | None
    ) -> None:
        plan, suite = body_plan(robot), suite_of(robot)
        zeros, joint = np.zeros(3, np.float32), np.zeros(len(plan.parts) - 1, np.float32)
        quat = np.array([1, 0, 0, 0], np.float32)
        state = RobotState(
            pos=zeros, quat=quat, linear=zeros, angular=zeros, joint_pos=joint, joint_vel=joint
        )
        room = RAYS * -(-sum(suite.ray_counts) // RAYS)
        passed = [passed_in(sensor.passes, arena) for sensor in suite.sensors]
        of_ray = np.pad(
            np.repeat(np.arange(len(passed)), suite.ray_counts), (0, room - sum(suite.ray_counts))
        )
        # What rays pass of what there is, and which of them do; a single one in most arenas.
        self.gazes = [
            (some, np.array([p == some for p in passed])[of_ray]) for some in sorted(set(passed), key=sorted)
        ]

        def stretch(state: RobotState, around: Surroundings | None) -> tuple[Bodies, jax.Array, jax.Array]:
            bodies = body_poses(plan, state)
            origin, direction = suite.rays(bodies, NOTHING if around is None else around)
            fill = ((0, room - len(origin)), (0, 0))
            return bodies, jnp.pad(origin, fill), jnp.pad(direction, fill, constant_values=1.0)

        def read(sight: Sight, memory: Memory, key: jax.Array) -> Any:  # noqa: ANN401
            return suite.read(sight, memory, key)

        self.stretch = _compile(stretch, state, around)
        bodies, origin, _ = self.stretch(state, around)
        hits = Hits(distance=jnp.zeros(len(origin)), cosine=jnp.zeros(len(origin)))
        sight = Sight(time=np.float32(0), state=state, bodies=bodies, hits=NO_HITS, surroundings=around)
        key = jax.random.key(0)
        self.start = _compile(suite.start, sight, key)
        self.read = _compile(read, sight.replace(hits=hits), self.start(sight, key), key)

        def run(told: Command, state: RobotState, act: Any, time: Any, powered: Any) -> tuple[Driven, Any]:  # noqa: ANN401
            depth = depth_in_water(arena, state.pos)
            drowned = drowns(robot, depth)
            now = Circumstances(time=time, powered=powered & ~drowned, depth=depth)
            return drive(plan, told, state, act, now, period), drowned

        command, act = jax.tree.map(np.array, idle(robot)), np.zeros(len(plan.actuated), np.float32)
        compiled = _compile(run, command, state, act, np.float32(0), np.bool_(True))
        self.drive = lambda *told: jax.device_get(compiled(*told))


def _compile(function: Callable[..., Any], *example: Any) -> Callable[..., Any]:  # noqa: ANN401
    return jax.jit(function).lower(*example).compile()


def passed_in(passes: frozenset[str], arena: ArenaSpec) -> frozenset[str]:
    """Return which of some materials there are in an arena."""
    solids = [*arena.shapes, *(shape for loose in arena.loose for shape in loose.shapes)]
    return passes & {shape.material for shape in solids}
