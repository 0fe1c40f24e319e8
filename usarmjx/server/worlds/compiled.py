"""The functions of one robot class in a served world, compiled before a robot of that class appears."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.models.build.body_plan import BodyPoses, forward_kinematics, kinematic_tree_of
from usarmjx.models.drives.state import RobotState
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.base import Reading, SensorInput
from usarmjx.sensors.rays.raycast import NO_HITS, Hits
from usarmjx.sensors.suite import SensorMemory, suite_of
from usarmjx.sensors.surroundings import NO_SURROUNDINGS, Surroundings
from usarmjx.sim.control import ActuatorInputs, DriveConditions, RobotCommand, compute_actuation, idle_command
from usarmjx.sim.world import depth_in_water, drowns

RAY_BATCH_SIZE = 512
"""Robots cast their rays in batches of this size, so that few sizes are ever compiled."""


class CompiledRobot:
    """The functions of one robot class, compiled here and not at their first call.

    The rays, which take longest to compile, are cast by a function that all classes share.
    """

    def __init__(
        self, robot: RobotSpec, arena: ArenaSpec, period: float, surroundings: Surroundings | None
    ) -> None:
        plan, suite = kinematic_tree_of(robot), suite_of(robot)
        zeros, joint = np.zeros(3, np.float32), np.zeros(len(plan.parts) - 1, np.float32)
        quat = np.array([1, 0, 0, 0], np.float32)
        state = RobotState(
            pos=zeros, quat=quat, linear=zeros, angular=zeros, joint_pos=joint, joint_vel=joint
        )
        capacity = RAY_BATCH_SIZE * -(-sum(suite.ray_counts) // RAY_BATCH_SIZE)
        passed = [materials_present(sensor.transparent, arena) for sensor in suite.sensors]
        of_ray = np.pad(
            np.repeat(np.arange(len(passed)), suite.ray_counts), (0, capacity - sum(suite.ray_counts))
        )
        # What rays pass of what there is, and which of them do; a single one in most arenas.
        self.ray_queries = [
            (some, np.array([p == some for p in passed])[of_ray]) for some in sorted(set(passed), key=sorted)
        ]

        def bodies_and_rays(state: RobotState, around: Surroundings | None) -> tuple[BodyPoses, Array, Array]:
            bodies = forward_kinematics(plan, state)
            origin, direction = suite.rays(bodies, NO_SURROUNDINGS if around is None else around)
            fill = ((0, capacity - len(origin)), (0, 0))
            return bodies, jnp.pad(origin, fill), jnp.pad(direction, fill, constant_values=1.0)

        def read(
            inputs: SensorInput, memory: SensorMemory, key: jax.Array
        ) -> tuple[SensorMemory, tuple[Reading, ...]]:
            return suite.read(inputs, memory, key)

        self.bodies_and_rays = _compile(bodies_and_rays, state, surroundings)
        bodies, origin, _ = self.bodies_and_rays(state, surroundings)
        hits = Hits(distance=jnp.zeros(len(origin)), cosine=jnp.zeros(len(origin)))
        inputs = SensorInput(
            time=np.zeros((), np.float32), state=state, bodies=bodies, hits=NO_HITS, surroundings=surroundings
        )
        key = jax.random.key(0)
        self.start = _compile(suite.init_memory, inputs, key)
        self.read = _compile(read, inputs.replace(hits=hits), self.start(inputs, key), key)

        def run(
            command: RobotCommand, state: RobotState, act: Array, time: Array, powered: Array
        ) -> tuple[ActuatorInputs, Array]:
            depth = depth_in_water(arena, jnp.asarray(state.pos))
            drowned = drowns(robot, depth)
            now = DriveConditions(time=time, powered=powered & ~drowned, depth=depth)
            return compute_actuation(plan, command, state, act, now, period), drowned

        command, act = jax.tree.map(np.array, idle_command(robot)), np.zeros(len(plan.actuated), np.float32)
        compiled = _compile(run, command, state, act, np.zeros((), np.float32), np.array(True))
        self.drive = lambda *inputs: jax.device_get(compiled(*inputs))


def _compile(function: Callable[..., Any], *example: Any) -> Callable[..., Any]:  # noqa: ANN401
    return jax.jit(function).lower(*example).compile()


def materials_present(passes: frozenset[str], arena: ArenaSpec) -> frozenset[str]:
    """Return which of some materials there are in an arena."""
    solids = [*arena.shapes, *(shape for loose in arena.loose for shape in loose.shapes)]
    return passes & {shape.material for shape in solids}
