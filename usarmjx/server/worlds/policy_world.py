"""A served world whose robots a policy drives; clients take over some of them.

All worlds of the batch do the policy's task. It reads sensors once for each action, as in training, and
clients are told the same readings, so nothing changes for the policy when somebody looks on.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3
from usarmjx.engines import PhysicsState
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.base import Reading
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.server.worlds.host import Robot
from usarmjx.sim.actions import apply_actions
from usarmjx.sim.batch import select_worlds
from usarmjx.sim.control import idle_command
from usarmjx.sim.radio import update_links
from usarmjx.sim.world import World, observe
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.policy import Policy
from usarmjx.train.envs.task import TaskView

Readings = tuple[tuple[Reading, ...], ...]


class PolicyState(struct.PyTreeNode, kw_only=True):
    """What drives the worlds.

    Attributes:
        task: The task's memory (worlds, ...).
        policy: The policy's memory (worlds, ...).
        length: Actions since the task began (worlds,).
        score: The task's score so far (worlds,).
        episode: How often the task has begun (worlds,).
    """

    task: Any
    policy: Any
    length: jax.Array
    score: jax.Array
    episode: jax.Array


class PolicyWorld(BatchWorld):
    """World `instance` of a task's batch, with a policy in it.

    INIT with the name of one of the task's robots takes that robot over where it is. Any other name gets the
    first robot of its class that nobody has taken, where INIT says. Until its client leaves, the policy gives
    that robot no orders; then it drives it again.

    When the task is over, by success or by time, it begins anew where the robots are, so that no client loses
    its robot; the arena stays.

    Args:
        env: The task.
        policy: The policy.
        instance: Which world to serve.
        seed: Of the policy's random numbers and those of later rounds of the task.

    Raises:
        UsageError: The batch has no such world.
    """

    def __init__(self, env: Env, policy: Policy, instance: int = 0, seed: int = 0) -> None:
        self._env, self._policy = env, policy
        self._key = jax.random.key(seed)
        self._policy_state: PolicyState | None = None
        self._policy_time = 0.0
        self._episodes = np.zeros(env.worlds, int)
        look, tell = jax.vmap(self._sense), jax.vmap(self._apply_actions)
        self._sense_all = jax.jit(jax.default_matmul_precision("highest")(look))
        self._begin_all = jax.jit(jax.vmap(self._begin))
        self._evaluate_all = jax.jit(jax.vmap(env.task.evaluate))
        self._observe_all = jax.jit(jax.vmap(env.task.observe))
        self._apply_actions_all = jax.jit(jax.default_matmul_precision("highest")(tell))
        self._act = jax.jit(policy.act)
        super().__init__(env.batch, instance)
        self._policy_step()

    # What follows up to `_tell` is traced, of one world.

    def _sense(self, world: World, physics: PhysicsState) -> tuple[World, Readings]:
        world, readings = observe(self._env.scene, world, physics)
        if self._env.scene.radio is not None:
            world = world.replace(links=update_links(self._env.scene, world, physics))
        return world, readings

    def _begin(self, view: TaskView, key: jax.Array, turn: jax.Array) -> Any:  # noqa: ANN401 - the task's memory
        return self._env.task.start(view, jax.random.fold_in(key, turn))

    def _apply_actions(
        self,
        view: TaskView,
        memory: Any,  # noqa: ANN401
        actions: tuple[jax.Array, ...],
        claimed: jax.Array,
    ) -> World:
        """Give orders to the robots that nobody has claimed (robots,)."""
        task, scene = self._env.task, self._env.scene
        told = tuple(jnp.clip(jnp.where(jnp.isfinite(a), a, 0.0), -1.0, 1.0) for a in actions)
        return apply_actions(scene, view.world, view.physics, task.act(view, memory, told), where=~claimed)

    def _policy_step(self) -> None:
        """Read the sensors of all worlds, judge, and let the policy give its orders."""
        env, physics = self._env, self._batch.physics(self._state)
        worlds, readings = self._sense_all(self._state.worlds, physics)
        views = TaskView(world=worlds, physics=physics, readings=readings, scene=env.scene)
        drivers, began = self._evaluated(views)
        obs = self._observe_all(views, drivers.task)
        memory = jax.tree.map(
            partial(select_worlds, began), self._policy.initial_carry(env.worlds), drivers.policy
        )
        memory, actions = self._act(memory, obs, jax.random.fold_in(self._key, self._steps))
        worlds = self._apply_actions_all(views, drivers.task, actions, self._claims())
        self._state = self._state.replace(worlds=worlds)
        self._policy_state = drivers.replace(policy=memory)
        self._policy_time = self.time
        if self.robots:
            self._hand_on(jax.device_get(jax.tree.map(lambda x: x[self._instance], readings)))

    def _hand_on(self, readings: Readings) -> None:
        """Keep what clients will want of the served world's readings."""
        for robot in self.robots.values():
            team, place = self._batch.scene.group_of(robot.slot)
            for sensor, reading in enumerate(readings[team]):
                if reading.fresh[place]:
                    robot.pending[sensor] = np.asarray(reading.value[place])

    def _evaluated(self, views: TaskView) -> tuple[PolicyState, jax.Array]:
        """Return the drivers, and where the task begins anew (worlds,)."""
        count, episodes = self._env.worlds, np.asarray(self._state.worlds.episode)
        keys = jax.random.split(jax.random.fold_in(self._key, 1 << 30), count)
        if self._policy_state is None:
            zero = jnp.zeros(count, jnp.int32)
            task = self._begin_all(views, keys, zero)
            start = self._policy.initial_carry(count)
            began = jnp.ones(count, bool)
            drivers = PolicyState(task=task, policy=start, length=zero, score=jnp.zeros(count), episode=zero)
        else:
            verdict, before = self._evaluate_all(views, self._policy_state.task), self._policy_state
            over = verdict.terminated | (before.length + 1 >= self._env.episode_steps)
            began = over | jnp.asarray(episodes != self._episodes)
            turn = before.episode + began
            fresh = self._begin_all(views, keys, turn)
            drivers = PolicyState(
                task=jax.tree.map(partial(select_worlds, began), fresh, verdict.memory),
                policy=before.policy,
                length=jnp.where(began, 0, before.length + 1),
                score=verdict.score,
                episode=turn,
            )
        self._episodes = episodes
        return drivers, began

    def _claims(self) -> np.ndarray:
        """Return which robots clients have (worlds, robots)."""
        claimed = np.zeros((self._env.worlds, self._env.scene.num_robots), bool)
        claimed[self._instance, list(self.robots)] = True
        return claimed

    @property
    def score(self) -> float:
        """The task's score of the served world so far."""
        return 0.0 if self._policy_state is None else float(self._policy_state.score[self._instance])

    def agents(self) -> dict[str, int]:
        """Return the names of the task's robots, and their slots."""
        named = enumerate(self._env.scene.roster)
        return {entry.name or f"{entry.spec.name}{slot}": slot for slot, entry in named}

    def spawn(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        """Take over the robot of that name where it is, or put the first free one of its class there."""
        self.check_position(pos)
        slots = {agent.lower(): slot for agent, slot in self.agents().items()}
        slot = slots.get(name.lower())
        new = (
            self._put_first(robot, name, pos, angles) if slot is None else self._take_over(slot, robot, name)
        )
        new.spawn_time = self._policy_time  # reports come when something has just been measured
        return new

    def _put_first(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        for team in self._batch.scene.groups:
            free = [int(slot) for slot in team.slots if int(slot) not in self.robots]
            if team.robot.name == robot.name and free:
                return self._activate(free[0], robot, name, pos, angles)
        raise UsageError(f"no {robot.name} left to take over; the robots here: {', '.join(self.agents())}")

    def _take_over(self, slot: int, robot: RobotSpec, name: str) -> Robot:
        number, _ = self._batch.scene.group_of(slot)
        team = self._batch.scene.groups[number]
        if team.robot.name != robot.name or slot in self.robots:
            what = "taken" if slot in self.robots else f"a {team.robot.name}, not a {robot.name}"
            raise UsageError(f"{name} is {what}")
        command = jax.tree.map(np.array, idle_command(robot))
        new = Robot(slot=slot, name=name, suite=team.suite, command=command, spawn_time=self.time)
        self.robots[slot] = new
        self.set_command(new, command)
        return new

    def remove(self, robot: Robot) -> None:
        """Give the robot back to the policy; it stands still until the next action."""
        if self.robots.get(robot.slot) is robot:
            self.set_command(robot, jax.tree.map(np.array, idle_command(robot.spec)))
            del self.robots[robot.slot]

    def step(self) -> None:
        """Advance all worlds by one control step; after as many as an action lasts, the policy acts."""
        super().step()
        if self._policy_state is not None and self._steps % self._env.task.repeat == 0:
            self._policy_step()

    def observe(self, due: list[Robot]) -> None:
        """See whose battery has drowned; what was measured was handed on when the policy acted."""
        for robot in due:
            team, place = self._batch.scene.group_of(robot.slot)
            robot.drowned = bool(self._state.worlds.groups[team].drowned[self._instance, place])
