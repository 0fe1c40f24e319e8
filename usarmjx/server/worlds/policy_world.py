"""A served world whose robots a policy drives; clients take over some of them.

All worlds of the batch do the policy's task. It reads sensors once for each action, as in training, and
clients are told the same readings, so nothing changes for the policy when somebody looks on.
"""

from dataclasses import replace
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
from usarmjx.server.worlds.batch_world import ClaimedWorld
from usarmjx.server.worlds.host import Robot
from usarmjx.sim.batch import choose
from usarmjx.sim.control import idle
from usarmjx.sim.radio import present_links
from usarmjx.sim.world import World, observe
from usarmjx.train.envs.actions import Orders, carry_out
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.policy import Policy
from usarmjx.train.envs.task import View

Readings = tuple[tuple[Reading, ...], ...]


class Drivers(struct.PyTreeNode, kw_only=True):
    """What drives the worlds.

    Attributes:
        task: The task's memory (worlds, ...).
        policy: The policy's memory (worlds, ...).
        length: Actions since the task began (worlds,).
        score: The task's score so far (worlds,).
        turn: How often the task has begun (worlds,).
    """

    task: Any
    policy: Any
    length: jax.Array
    score: jax.Array
    turn: jax.Array


class DrivenWorld(ClaimedWorld):
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
        self._drivers: Drivers | None = None
        self._decided = 0.0
        self._episodes = np.zeros(env.worlds, int)
        look, tell = jax.vmap(self._look), jax.vmap(self._tell)
        self._look_all = jax.jit(jax.default_matmul_precision("highest")(look))
        self._begin_all = jax.jit(jax.vmap(self._begin))
        self._judge_all = jax.jit(jax.vmap(env.task.judge))
        self._see_all = jax.jit(jax.vmap(env.task.observe))
        self._tell_all = jax.jit(jax.default_matmul_precision("highest")(tell))
        self._act = jax.jit(policy.act)
        super().__init__(env.batch, instance)
        self._decide()

    # What follows up to `_tell` is traced, of one world.

    def _look(self, world: World, physics: PhysicsState) -> tuple[World, Readings]:
        world, readings = observe(self._env.scene, world, physics)
        if self._env.scene.radio is not None:
            world = world.replace(links=present_links(self._env.scene, world, physics))
        return world, readings

    def _begin(self, view: View, key: jax.Array, turn: jax.Array) -> Any:  # noqa: ANN401 - the task's memory
        return self._env.task.start(view, jax.random.fold_in(key, turn))

    def _tell(
        self,
        view: View,
        memory: Any,  # noqa: ANN401
        actions: tuple[jax.Array, ...],
        claimed: jax.Array,
    ) -> World:
        """Give orders to the robots that nobody has claimed (robots,)."""
        task, scene = self._env.task, self._env.scene
        told = tuple(jnp.clip(jnp.where(jnp.isfinite(a), a, 0.0), -1.0, 1.0) for a in actions)
        orders = _for_the_unclaimed(task.act(view, memory, told), view, claimed)
        world = carry_out(scene, view.world, view.physics, orders)
        teams = tuple(
            after.replace(
                command=jax.tree.map(partial(choose, claimed[team.slots]), before.command, after.command)
            )
            for team, before, after in zip(scene.teams, view.world.teams, world.teams, strict=True)
        )
        return world.replace(teams=teams)

    def _decide(self) -> None:
        """Read the sensors of all worlds, judge, and let the policy give its orders."""
        env, physics = self._env, self._batch.physics(self._state)
        worlds, readings = self._look_all(self._state.worlds, physics)
        views = View(world=worlds, physics=physics, readings=readings, scene=env.scene)
        drivers, began = self._judged(views)
        obs = self._see_all(views, drivers.task)
        memory = jax.tree.map(partial(choose, began), self._policy.start(env.worlds), drivers.policy)
        memory, actions = self._act(memory, obs, jax.random.fold_in(self._key, self._steps))
        worlds = self._tell_all(views, drivers.task, actions, self._claims())
        self._state = self._state.replace(worlds=worlds)
        self._drivers = drivers.replace(policy=memory)
        self._decided = self.time
        if self.robots:
            self._hand_on(jax.device_get(jax.tree.map(lambda x: x[self._instance], readings)))

    def _hand_on(self, readings: Readings) -> None:
        """Keep what clients will want of the served world's readings."""
        for robot in self.robots.values():
            team, place = self._batch.scene.team_of(robot.slot)
            for sensor, reading in enumerate(readings[team]):
                if reading.fresh[place]:
                    robot.pending[sensor] = np.asarray(reading.value[place])

    def _judged(self, views: View) -> tuple[Drivers, jax.Array]:
        """Return the drivers, and where the task begins anew (worlds,)."""
        count, episodes = self._env.worlds, np.asarray(self._state.worlds.episode)
        keys = jax.random.split(jax.random.fold_in(self._key, 1 << 30), count)
        if self._drivers is None:
            zero = jnp.zeros(count, jnp.int32)
            task = self._begin_all(views, keys, zero)
            start = self._policy.start(count)
            began = jnp.ones(count, bool)
            drivers = Drivers(task=task, policy=start, length=zero, score=jnp.zeros(count), turn=zero)
        else:
            verdict, before = self._judge_all(views, self._drivers.task), self._drivers
            over = verdict.terminated | (before.length + 1 >= self._env.episode_steps)
            began = over | jnp.asarray(episodes != self._episodes)
            turn = before.turn + began
            fresh = self._begin_all(views, keys, turn)
            drivers = Drivers(
                task=jax.tree.map(partial(choose, began), fresh, verdict.memory),
                policy=before.policy,
                length=jnp.where(began, 0, before.length + 1),
                score=verdict.score,
                turn=turn,
            )
        self._episodes = episodes
        return drivers, began

    def _claims(self) -> np.ndarray:
        """Return which robots clients have (worlds, robots)."""
        claimed = np.zeros((self._env.worlds, self._env.scene.robots), bool)
        claimed[self._instance, list(self.robots)] = True
        return claimed

    @property
    def score(self) -> float:
        """The task's score of the served world so far."""
        return 0.0 if self._drivers is None else float(self._drivers.score[self._instance])

    def agents(self) -> dict[str, int]:
        """Return the names of the task's robots, and their slots."""
        named = enumerate(self._env.scene.roster)
        return {entry.name or f"{entry.spec.name}{slot}": slot for slot, entry in named}

    def spawn(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        """Take over the robot of that name where it is, or put the first free one of its class there."""
        self.check_place(pos)
        slots = {agent.lower(): slot for agent, slot in self.agents().items()}
        slot = slots.get(name.lower())
        new = (
            self._put_first(robot, name, pos, angles) if slot is None else self._take_over(slot, robot, name)
        )
        new.born = self._decided  # reports come when something has just been measured
        return new

    def _put_first(self, robot: RobotSpec, name: str, pos: Vec3, angles: Vec3) -> Robot:
        for team in self._batch.scene.teams:
            free = [int(slot) for slot in team.slots if int(slot) not in self.robots]
            if team.robot.name == robot.name and free:
                return self._wake(free[0], robot, name, pos, angles)
        raise UsageError(f"no {robot.name} left to take over; the robots here: {', '.join(self.agents())}")

    def _take_over(self, slot: int, robot: RobotSpec, name: str) -> Robot:
        number, _ = self._batch.scene.team_of(slot)
        team = self._batch.scene.teams[number]
        if team.robot.name != robot.name or slot in self.robots:
            what = "taken" if slot in self.robots else f"a {team.robot.name}, not a {robot.name}"
            raise UsageError(f"{name} is {what}")
        command = jax.tree.map(np.array, idle(robot))
        new = Robot(slot=slot, name=name, suite=team.suite, command=command, born=self.time)
        self.robots[slot] = new
        self.tell(new, command)
        return new

    def remove(self, robot: Robot) -> None:
        """Give the robot back to the policy; it stands still until the next action."""
        if self.robots.get(robot.slot) is robot:
            self.tell(robot, jax.tree.map(np.array, idle(robot.spec)))
            del self.robots[robot.slot]

    def step(self) -> None:
        """Advance all worlds by one control step; after as many as an action lasts, the policy acts."""
        super().step()
        if self._drivers is not None and self._steps % self._env.task.repeat == 0:
            self._decide()

    def observe(self, due: list[Robot]) -> None:
        """See whose battery has drowned; what was measured was handed on when the policy acted."""
        for robot in due:
            team, place = self._batch.scene.team_of(robot.slot)
            robot.drowned = bool(self._state.worlds.teams[team].drowned[self._instance, place])


def _for_the_unclaimed(orders: Orders, view: View, claimed: jax.Array) -> Orders:
    """Return orders without letters from robots that are claimed (robots,), and orders to their effecters."""
    scene, letters = view.scene, orders.letters
    if letters is not None:
        letters = letters.replace(to=letters.to & ~claimed[:, None])
    operations = tuple(
        replace(one, where=one.where & ~claimed[scene.teams[one.team].slots]) for one in orders.operations
    )
    return replace(orders, letters=letters, operations=operations)
