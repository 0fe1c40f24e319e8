"""Rollouts: robots act under the present policy, and their trajectories are recorded."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.base.errors import UsageError
from usarmjx.base.program_cache import PrecompiledProgram, ProgramCache, compile_program
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import EnvState, Memory
from usarmjx.train.envs.task import Carry, Policy
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.league import Match, Rivals
from usarmjx.train.learning.networks import fold_each, sample_actions
from usarmjx.train.learning.ppo import reset_carry, teacher_obs, teacher_of
from usarmjx.train.learning.train_state import (
    STAGGER_STREAM,
    Networks,
    TrainState,
    critic_values,
    policy_params,
    unscaled_values,
)
from usarmjx.train.learning.trajectory import (
    Background,
    Decision,
    GroupArrays,
    RolloutEnds,
    RolloutState,
    StepView,
    Trajectory,
    step_view,
)

Collected: TypeAlias = tuple[RolloutState, Trajectory, RolloutEnds, dict[str, jax.Array]]
"""Worlds after a rollout, its steps, its ends, and sums over it for the log."""


def _learners(alive: GroupArrays, decision: Decision) -> GroupArrays:
    """Return the agents that are alive and, in a league, play for the policy; () if all do."""
    if decision.match is None:
        return alive
    # One group: `Rivals` refuses a league of more.
    learns = (decision.match.learns,)
    return tuple(a & b for a, b in zip(alive, learns, strict=True)) if alive else learns


def _stack_steps(
    rows: list[tuple[Trajectory, dict[str, jax.Array]]],
) -> tuple[Trajectory, dict[str, jax.Array]]:
    """Return steps with a leading axis over them, and the sums over them."""
    steps, sums = jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)
    return steps, jax.tree.map(lambda one: one.sum(0), sums)


def _sum_worlds(rows: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Return sums over worlds (worlds,) in one reduction: a GPU starts a kernel for each separate one."""
    single = [jnp.asarray(row, jnp.float32) for row in rows.values()]
    return dict(zip(rows, jnp.stack(single).sum(1), strict=True))


HELD_FIELDS = (
    *("reward", "done", "truncated", "final_obs", "final_privileged", "final_alive", "final_score"),
    *("bad", "metrics"),
)
"""Results of a step that a world keeps until the action ends, once its episode has ended."""


RIVALS = 2**31 - 3
"""Fold of a rollout's key for what rivals draw, apart from all steps' numbers."""


def _where_open(open_: jax.Array, going: jax.Array, ended: jax.Array) -> jax.Array:
    return jnp.where(open_.reshape(-1, *[1] * (going.ndim - 1)), going, ended)


def _no_watcher(state: EnvState) -> None:
    """Ignore the state: the default without a watcher."""
    del state


def _step_sums(after: StepView, ended: jax.Array, bad: jax.Array) -> dict[str, jax.Array]:
    """Return the sums of a step for the log (worlds,): ended episodes, bad worlds and the task's metrics."""
    return {
        "episodes": ended,
        "score": jnp.where(ended, after.final_score, 0.0),
        "bad": bad,
        **{f"step/{name}": jnp.where(bad, 0.0, one) for name, one in after.metrics.items()},
        **{f"end/{name}": jnp.where(ended, one, 0.0) for name, one in after.metrics.items()},
    }


class Rollout:
    """Rollouts in the worlds of this process.

    Attributes:
        worlds: Number of worlds that a policy acts in.

    Args:
        env: The worlds of this process.
        networks: Shapes of policy and critics.
        config: Settings.
        first: Number of the first world.
        teacher: Policy to imitate for the first `config.imitation_steps` agent steps.
        program_cache: Cache of its programs.
    """

    def __init__(
        self,
        env: Env,
        networks: Networks,
        config: Config,
        first: int = 0,
        teacher: Policy | None = None,
        program_cache: ProgramCache | None = None,
    ) -> None:
        self.env, self.networks, self.config, self.first = env, networks, config, first
        # Environments of one's own need no task.
        self._turn_length: int = getattr(getattr(env, "task", None), "turn_length", 0)
        if self._turn_length % config.action_repeat:
            raise UsageError(
                f"action_repeat is {config.action_repeat}, but robots choose goals and messages in turns of "
                f"{self._turn_length} steps: set a divisor of that"
            )
        self.teacher, self.worlds = teacher, env.worlds
        self.rivals = Rivals(env, networks.policy, config, teacher_of(env)) if config.league else None
        self.look: Callable[[EnvState], None] = _no_watcher
        """Receives the worlds: after every action, or where a whole rollout is compiled, after that."""
        # Networks bear TensorFloat-32, which physics and sensors do not.
        compiled = partial(compile_program, program_cache=program_cache, owner="Rollout", precise=False)
        self._decide, self._account = compiled(self._choose_actions), compiled(self._record_step)
        self._stack, self._bound = compiled(_stack_steps), compiled(self._rollout_ends)
        self._begin = compiled(self._initial_carry)
        self._collect_at_once = PrecompiledProgram(compiled(self._scan))

    def collect(self, train_state: TrainState, start: RolloutState, key: jax.Array) -> Collected:
        """Return the next rollout state, trajectory, ends, and sums for the log."""
        if not self.env.traceable:
            return self._loop(train_state, start, key)
        collected = self._collect_at_once(train_state, start, key)
        self.look(collected[0].env_state)
        return collected

    def compile_ahead(self, *shapes: Any, tell: Callable[[Any], None]) -> None:  # noqa: ANN401 - PyTrees
        """Compile `collect` for arguments of such shapes, on their devices; worlds are traceable.

        Args:
            shapes: Shapes of its arguments.
            tell: Receives the shapes of the result as soon as they are known.
        """
        self._collect_at_once.compile(*shapes, tell=tell)

    def start(self, level: float) -> RolloutState:
        """Return the worlds at the start of their first episodes, some of which will be short."""
        config = self.config
        given, key = self._seeds()
        # A seed on the device puts all worlds there from their first step on: nothing is compiled twice.
        seed = jax.device_put(given, jax.local_devices()[0])
        env = self.env.reset(seed, level) if config.curriculum else self.env.reset(seed)
        number, offset, carry = self._begin(key)
        if config.stagger_resets:  # by counting steps that never were, so nothing else of an episode changes
            env = env.replace(length=offset.astype(env.length.dtype))
            if (task := getattr(self.env, "task", None)) is not None:
                env = env.replace(memory=task.started_at(env.memory, env.length))
        return RolloutState(
            env_state=env,
            world_index=number,
            # One carry starts both: the critic's memory is as wide as the policy's.
            policy_carry=carry,
            critic_carry=carry,
            teacher_carry=() if self.teacher is None else self.teacher.initial_carry(self.env.worlds),
            episode_return=jnp.zeros(self.env.worlds),
            is_first=jnp.ones(self.env.worlds, bool),
            # Any player: the first step draws another, as all episodes begin with it.
            opponent=None if self.rivals is None else jnp.zeros(self.env.worlds, jnp.int32),
        )

    def _seeds(self) -> tuple[Any, jax.Array]:
        """Return what the worlds' first reset takes as a seed, and the key of the first episodes' lengths."""
        seed = self.config.seed
        # A seed within 32 bits goes as a plain number, a longer one only as a key.
        given = random.key(seed) if seed >> 32 else np.uint32(seed)
        return given, jax.random.fold_in(random.key(seed), STAGGER_STREAM)

    def _initial_carry(self, key: jax.Array) -> tuple[jax.Array, jax.Array, GroupArrays]:
        """Return the worlds' numbers, the offsets of their first episodes, and the carry."""
        number = self.first + jnp.arange(self.worlds)
        # By the worlds' numbers: offsets do not depend on the processes that share the worlds.
        keys = fold_each(key, number)

        def draw(key: jax.Array) -> jax.Array:
            start = jax.random.randint(key, (), 0, self.env.episode_steps)
            # A multiple of the repeat, so that a time-out falls on the end of an action, as it does later.
            # Worlds take turns together, so that what is due in one is due in all of them.
            return start - start % max(self.config.action_repeat, 2 * self._turn_length)

        offset = jax.vmap(draw)(keys)
        return number, offset, self.networks.policy.initial_carry(self.worlds)

    @jax.named_scope("policy")
    def _choose_actions(
        self,
        train_state: TrainState,
        view: StepView,
        carry: tuple[GroupArrays, GroupArrays, Carry],
        worlds: jax.Array,
        key: tuple[jax.Array, jax.Array | np.int32],
        background: Background,
    ) -> tuple[GroupArrays, Decision]:
        """Return actions, and the decision behind them; `key` is the rollout's and the number of the step."""
        policy = self.networks.policy
        logits, after = policy.distribution_params(policy_params(train_state), view.obs, carry[0])
        # By the worlds' numbers among all processes: draws do not depend on the distribution of worlds.
        raw = sample_actions(policy, logits, fold_each(jax.random.fold_in(*key), worlds))
        kinds = [policy.distribution(g) for g in range(len(raw))]
        value, critic = self._value(train_state, view.obs, view.privileged, carry[1])
        log_prob = tuple(k.log_prob(p, a) for k, p, a in zip(kinds, logits, raw, strict=True))
        # After the log-probabilities: they are of the policy's own draws, and replaced agents do not learn.
        match, raw = self._against_rivals(train_state, view.obs, raw, background, (*key, worlds))
        seen = (view.obs, background.memory)
        teacher, teacher_action = self._teacher_action(train_state, seen, carry[2], jax.random.fold_in(*key))
        return tuple(kind.postprocess(action) for kind, action in zip(kinds, raw, strict=True)), Decision(
            raw_action=raw,
            log_prob=log_prob,
            value=value,
            teacher_action=teacher_action,
            policy_carry=after,
            critic_carry=critic,
            teacher_carry=teacher,
            match=match,
        )

    def _against_rivals(
        self,
        train_state: TrainState,
        obs: GroupArrays,
        raw: GroupArrays,
        background: Background,
        key: tuple[Any, ...],
    ) -> tuple[Match | None, GroupArrays]:
        """Return the games of a league, and the actions with those of its players; none: there is no league.

        `key` is the rollout's, the number of the step, and the numbers of the worlds.
        """
        league, rivals = train_state.league, self.rivals
        if league is None or rivals is None or background.opponent is None:
            return None, raw
        rollout, step, worlds = key
        drawing, acting = jax.random.split(jax.random.fold_in(jax.random.fold_in(rollout, RIVALS), step))
        match = rivals.match(league, background.opponent, background.is_first, fold_each(drawing, worlds))
        return match, (rivals.replace_actions(league, match, obs[0], raw[0], acting, worlds),)

    def _teacher_action(
        self, train_state: TrainState, seen: tuple[GroupArrays, Memory], carry: Carry, key: jax.Array
    ) -> tuple[Carry, GroupArrays]:
        """Return the teacher's carry and actions; zeros once imitation is over."""
        teacher, groups = self.teacher, self.networks.groups
        if teacher is None:
            return carry, ()
        obs, memory = seen
        zeros = tuple(jnp.zeros((*o.shape[:2], g.action_size)) for o, g in zip(obs, groups, strict=True))
        # A branch, not `where`: a planner may cost more than the physics, and is not run after imitation.
        return jax.lax.cond(
            self.networks.is_imitating(train_state, self.config),
            lambda: teacher.act(carry, teacher_obs(self.env, memory, obs, self.config.teacher), key),
            lambda: (carry, zeros),
        )

    def _value(
        self, train_state: TrainState, obs: GroupArrays, privileged: jax.Array, carry: GroupArrays
    ) -> tuple[GroupArrays, GroupArrays]:
        obs_sequence = tuple(one[None] for one in obs)
        # The carry is reset between steps: nothing is left to reset within this one.
        is_first = (jnp.zeros((1, len(privileged)), bool),) * len(obs)
        value, after = critic_values(
            self.networks, train_state, (obs_sequence, privileged[None]), carry, is_first
        )
        return unscaled_values(train_state, tuple(one[0] for one in value)), after

    def _record_step(
        self,
        train_state: TrainState,
        episode: tuple[jax.Array, jax.Array],
        decision: Decision,
        before: StepView,
        after: StepView,
    ) -> tuple[Trajectory, tuple[GroupArrays, GroupArrays, Carry], jax.Array, dict[str, jax.Array]]:
        """Return a step of the trajectory, the carries and returns after it, and sums for the log.

        `episode` is the return of the running episode, and whether it began with the step.
        """
        episode_return, is_first = episode
        numbers = (*before.obs, before.privileged[:, None], *(reward[..., None] for reward in after.reward))
        finite = jnp.stack([jnp.isfinite(one).all((1, 2)) for one in numbers]).all(0)
        # A world whose numbers are not finite is as bad as one whose physics failed: neither is trained on.
        bad = after.bad | ~finite
        # A bad step ends the episode, so no memory of it goes on; it is no time-out.
        done = after.done | bad
        truncated = after.truncated & ~bad
        zeros = tuple(jnp.zeros_like(value) for value in decision.value)
        # Few steps truncate an episode: only then the critic runs a second time.
        bootstrap = jax.lax.cond(
            self._any(truncated),
            lambda: self._value(train_state, after.final_obs, after.final_privileged, decision.critic_carry)[
                0
            ],
            lambda: zeros,
        )
        # A reward of a bad step may be NaN, which would stay in the episode's return.
        reward = tuple(jnp.where(bad[:, None], 0.0, one) for one in after.reward)
        episode_return = episode_return + self._team_reward(reward)
        ended = done & ~bad
        alive, survived = (_learners(one or (), decision) for one in (before.alive, after.final_alive))
        step = Trajectory(
            obs=before.obs,
            privileged=before.privileged,
            raw_action=decision.raw_action,
            log_prob=decision.log_prob,
            value=decision.value,
            reward=tuple(one * self.config.reward_scale for one in reward),
            bootstrap_value=bootstrap,
            is_first=is_first,
            done=done,
            truncated=truncated,
            bad=bad,
            teacher_action=decision.teacher_action,
            alive=alive,
            survived=survived,
        )
        episode_sums = {
            "return": jnp.where(ended, episode_return, 0.0),
            # By the state before the step: a reset in the step has set the later length to 0.
            "length": jnp.where(ended, before.length + 1, 0),
            "timeouts": truncated,
        }
        results = self._results(train_state, decision, (ended, before.length + 1, after.final_score))
        sums = _sum_worlds({**episode_sums, **_step_sums(after, ended, bad), **results})
        carry = self._next_carry(decision, before, after, done)
        return step, carry, jnp.where(done, 0.0, episode_return), sums

    def _team_reward(self, reward: GroupArrays) -> jax.Array:
        """Return the mean reward of all robots but rivals in a league (worlds,)."""
        own = reward if self.rivals is None else tuple(one[:, self.rivals.team] for one in reward)
        return sum((one.sum(1) for one in own), jnp.float32(0.0)) / sum(one.shape[1] for one in own)

    def _results(
        self, train_state: TrainState, decision: Decision, ended: tuple[jax.Array, jax.Array, jax.Array]
    ) -> dict[str, jax.Array]:
        """Return the results of a league's games that ended, see `Rivals.results`; without one nothing."""
        league, match, rivals = train_state.league, decision.match, self.rivals
        if league is None or match is None or rivals is None:
            return {}
        return rivals.results(league, match.opponent, ended, train_state.iteration)

    def _any(self, where: jax.Array) -> jax.Array:
        """Return whether something is true in any world (worlds,) that is computed at once ()."""
        return where.any()

    def _next_carry(
        self, decision: Decision, before: StepView, after: StepView, done: jax.Array
    ) -> tuple[GroupArrays, GroupArrays, Carry]:
        """Return the carries of policies, critics and teacher, reset where an episode is over (worlds,).

        Those of agents that were not alive, or are not alive any more, are reset, too.
        """
        reset, teacher = self.networks.policy.reset_carry, decision.teacher_carry
        if self.teacher is not None:
            teacher = reset_carry(self.teacher, teacher, done)
        policy, critic = reset(decision.policy_carry, done), reset(decision.critic_carry, done)
        if before.alive is not None and after.alive is not None:
            # A robot that drops out or joins within an episode begins without memory.
            through = tuple(a & b for a, b in zip(before.alive, after.alive, strict=True))
            policy, critic = (self.networks.policy.reset_agents(one, through) for one in (policy, critic))
        return policy, critic, teacher

    def _rollout_ends(
        self,
        train_state: TrainState,
        before: tuple[GroupArrays, GroupArrays],
        after: tuple[jax.Array, GroupArrays],
        view: StepView,
    ) -> RolloutEnds:
        """Return the rollout's ends; `after` is the worlds' numbers, and the critics' carry."""
        last, _ = self._value(train_state, view.obs, view.privileged, after[1])
        return RolloutEnds(
            world_index=after[0], policy_carry=before[0], critic_carry=before[1], last_value=last
        )

    def _step(
        self,
        train_state: TrainState,
        state: RolloutState,
        key: jax.Array,
        step: jax.Array | np.int32,
    ) -> tuple[RolloutState, tuple[Trajectory, dict[str, jax.Array]]]:
        before = step_view(state.env_state)
        carry = (state.policy_carry, state.critic_carry, state.teacher_carry)
        background = Background(
            # Only a teacher reads the task's memory: without one it is no input of the compiled program.
            memory=() if self.teacher is None else state.env_state.memory,
            opponent=state.opponent,
            is_first=state.is_first,
        )
        actions, decision = self._decide(
            train_state, before, carry, state.world_index, (key, step), background
        )
        env = self._held(state.env_state, actions)
        row, (policy, critic, teacher), episode_return, sums = self._account(
            train_state, (state.episode_return, state.is_first), decision, before, step_view(env)
        )
        state = state.replace(
            env_state=env,
            policy_carry=policy,
            critic_carry=critic,
            teacher_carry=teacher,
            episode_return=episode_return,
            is_first=row.done,
            opponent=None if decision.match is None else decision.match.opponent,
        )
        return state, (row, sums)

    def _held(self, before: EnvState, actions: GroupArrays) -> EnvState:
        """Return the worlds after `action_repeat` steps with the same actions, with the rewards of all.

        An episode that ends within them ends the action; what follows of the next one is not rewarded.
        """
        # Outside the loop, whose carry must have the types of a result from the beginning.
        after = self.env.step(before, actions)

        def again(_: Any, now: EnvState) -> EnvState:  # noqa: ANN401 - a number
            then = self.env.step(now, actions)
            sums = tuple(a + b for a, b in zip(now.reward, then.reward, strict=True))
            going = then.replace(reward=sums)
            # Only results are kept: state and observations go on, into the next episode.
            kept = {
                name: jax.tree.map(partial(_where_open, ~now.done), getattr(going, name), getattr(now, name))
                for name in HELD_FIELDS
            }
            return then.replace(**kept)

        repeats = self.config.action_repeat - 1
        if not repeats:
            return after
        if self.env.traceable:
            return jax.lax.fori_loop(0, repeats, again, after)
        # An engine on the host cannot be traced: its steps are called one by one.
        for number in range(repeats):
            after = again(number, after)
        return after

    def _scan(self, train_state: TrainState, start: RolloutState, key: jax.Array) -> Collected:
        names: list[str] = []

        def step(state: RolloutState, number: jax.Array) -> tuple[RolloutState, tuple[Trajectory, jax.Array]]:
            state, (row, sums) = self._step(train_state, state, key, number)
            # Filled while JAX traces this function; the sums leave the scan as one array.
            names[:] = sums
            return state, (row, jnp.stack([*sums.values()]))

        state, (steps, sums) = jax.lax.scan(step, start, jnp.arange(self.config.rollout_length))
        return state, steps, self._ends(train_state, start, state), dict(zip(names, sums.sum(0), strict=True))

    def _loop(self, train_state: TrainState, start: RolloutState, key: jax.Array) -> Collected:
        state = start
        rows: list[tuple[Trajectory, dict[str, jax.Array]]] = []
        for step in range(self.config.rollout_length):
            state, row = self._step(train_state, state, key, np.int32(step))
            rows.append(row)
            self.look(state.env_state)
        steps, sums = self._stack(rows)
        return state, steps, self._ends(train_state, start, state), sums

    def _ends(self, train_state: TrainState, start: RolloutState, end: RolloutState) -> RolloutEnds:
        after = (end.world_index, end.critic_carry)
        return self._bound(
            train_state, (start.policy_carry, start.critic_carry), after, step_view(end.env_state)
        )
