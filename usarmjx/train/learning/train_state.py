"""State that training changes: the networks' parameters, the optimiser's state, running statistics."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax.struct import PyTreeNode

from usarmjx.base import random
from usarmjx.base.errors import UsageError, extra
from usarmjx.base.program_cache import ProgramCache, compile_program
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.league import League, start_league
from usarmjx.train.learning.networks import (
    AnyNetwork,
    LearnedPolicy,
    Network,
    Params,
    PolicyParams,
    SetNetwork,
    Statistics,
    apply_network,
    init_network,
    init_statistics,
    normalise,
)

with extra("train"):
    import optax

POLICY_STREAM, CRITIC_STREAM, ROLLOUT_STREAM, UPDATE_STREAM, STAGGER_STREAM = range(5)
"""First folds of the run's key."""


class ActorCriticParams(PyTreeNode, kw_only=True):
    """Parameters of all networks.

    Attributes:
        policy: Per group; of a policy that all share only one.
        critic: Per group.
        group_bias: Bias that a shared policy adds to its first layer for each group (width,); else empty.
    """

    policy: tuple[Params, ...]
    critic: tuple[Params, ...]
    group_bias: tuple[jax.Array, ...] = ()

    @property
    def group_policies(self) -> tuple[Params, ...]:
        """Those of each group's policy."""
        if not self.group_bias:
            return self.policy
        # Added into the bias of the first layer: acting and exporting need not know that groups share one.
        params = self.policy[0]["params"]
        first = params["layer_0"]
        return tuple(
            {"params": {**params, "layer_0": {**first, "bias": first["bias"] + own}}}
            for own in self.group_bias
        )


class TrainState(PyTreeNode, kw_only=True):
    """All that an update changes; the same in every process.

    Attributes:
        params: Parameters of all networks.
        opt_state: Adam's moments.
        obs_statistics: Statistics of the observations, per group (obs_size,).
        privileged_statistics: Those of the critics' privileged inputs (privileged_size,).
        return_statistics: Those of the returns, per group ().
        learning_rate: Learning rate ().
        iteration: Updates so far ().
        league: Past selves; None: there is no league.
    """

    params: ActorCriticParams
    opt_state: Any
    obs_statistics: tuple[Statistics, ...]
    privileged_statistics: Statistics
    return_statistics: tuple[Statistics, ...]
    learning_rate: jax.Array
    iteration: jax.Array
    league: League | None = None


@dataclass(frozen=True)
class Networks:
    """Shapes of all networks.

    Attributes:
        policy: The policy.
        critic_layers: Widths of the critic's hidden layers.
        privileged_size: Numbers that only critics see.
        shared: Whether all groups have one policy.
    """

    policy: LearnedPolicy
    critic_layers: tuple[int, ...]
    privileged_size: int
    shared: bool = False

    @property
    def groups(self) -> tuple[AgentGroup, ...]:
        """The agents."""
        return self.policy.groups

    def critic(self, group: int) -> AnyNetwork:
        """Return the critic of a group, which knows its robots apart."""
        robots, layout = len(self.groups[group].agents), self.policy.layout(group)
        if layout is None:
            return Network(self.critic_layers, self.policy.memory, 1, robots=robots)
        sees = self.policy.kind == "cnn"
        return SetNetwork(self.critic_layers, 1, layout, chooses=False, sees=sees, robots=robots)

    @property
    def agent_count(self) -> int:
        """Robots of a world that learn."""
        return sum(len(group.agents) for group in self.groups)

    def is_imitating(self, train_state: "TrainState", config: Config) -> jax.Array:
        """Return whether the policy still imitates a teacher ()."""
        return train_state.iteration < config.imitations(self.agent_count)

    def init(self, key: jax.Array) -> ActorCriticParams:
        """Return weights to begin with."""
        # Separate streams: a change of the policy's groups leaves the critics' first weights as they were.
        policy, critic = (jax.random.fold_in(key, s) for s in (POLICY_STREAM, CRITIC_STREAM))
        policies = self.policy.init(policy)
        none = jnp.zeros(self.policy.layers[0])
        return ActorCriticParams(
            policy=policies[:1] if self.shared else policies,
            # Zeros: all groups begin with the same policy.
            group_bias=tuple(none for _ in self.groups) if self.shared else (),
            critic=tuple(
                init_network(self.critic(g), jax.random.fold_in(critic, g), group, self.privileged_size)
                for g, group in enumerate(self.groups)
            ),
        )


def make_networks(groups: tuple[AgentGroup, ...], privileged_size: int, config: Config) -> Networks:
    """Return the networks for some agents.

    Raises:
        UsageError: They are to share a policy, but what they see or do differs in size; or observations have
            no layout, which the network reads.
    """
    if config.shared_policy and len({(group.obs_size, group.action_size) for group in groups}) > 1:
        sizes = ", ".join(f"{one.name} sees {one.obs_size} and does {one.action_size}" for one in groups)
        raise UsageError(f"these cannot share a policy, they see and do different numbers: {sizes}")
    policy = LearnedPolicy(groups, config.hidden_sizes, config.gru_size, config.network)
    policy.check()
    return Networks(policy, config.critic_hidden_sizes, privileged_size, shared=config.shared_policy)


def make_optimiser(config: Config) -> optax.GradientTransformation:
    """Return the optimiser, whose steps are still to be multiplied by minus the learning rate."""
    # A larger epsilon than Adam's 1e-8, as in PPO's reference code: small second moments give no leaps.
    return optax.chain(optax.clip_by_global_norm(config.max_grad_norm), optax.scale_by_adam(eps=1e-5))


def make_train_state(networks: Networks, config: Config) -> TrainState:
    """Return the train state before the first update."""
    return train_state_maker(networks, config, None)(random.key(config.seed))


def train_state_maker(
    networks: Networks, config: Config, program_cache: ProgramCache | None
) -> Callable[[jax.Array], TrainState]:
    """Return the compiled function from a key to the train state before the first update.

    Args:
        networks: Shapes.
        config: Settings, whose seed does not matter.
        program_cache: Cache of programs for such networks and settings.
    """
    return compile_program(partial(_initial, networks, config), program_cache, "TrainState", precise=False)


def _initial(networks: Networks, config: Config, key: jax.Array) -> TrainState:
    params = networks.init(key)
    fresh = TrainState(
        params=params,
        opt_state=make_optimiser(config).init(params),
        obs_statistics=tuple(init_statistics(group.obs_size) for group in networks.groups),
        privileged_statistics=init_statistics(networks.privileged_size),
        return_statistics=tuple(init_statistics() for _ in networks.groups),
        # Of a fixed type: the result of an update has it, and the next one is not compiled anew.
        learning_rate=jnp.float32(config.learning_rate),
        iteration=jnp.int32(0),
    )
    return fresh.replace(league=start_league(policy_params(fresh), config.league)) if config.league else fresh


def policy_params(train_state: TrainState) -> PolicyParams:
    """Return the policy alone."""
    return PolicyParams(
        weights=train_state.params.group_policies,
        mean=tuple(one.mean for one in train_state.obs_statistics),
        std=tuple(one.std for one in train_state.obs_statistics),
    )


def critic_values(
    networks: Networks,
    train_state: TrainState,
    seen: tuple[tuple[jax.Array, ...], jax.Array],
    carry: tuple[jax.Array, ...],
    is_first: tuple[jax.Array, ...],
) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, ...]]:
    """Return the critics' values of a sequence of steps.

    Args:
        networks: Shapes.
        train_state: Weights and statistics.
        seen: Observations, per group (steps, worlds, robots, obs_size), and privileged inputs
            (steps, worlds, privileged_size).
        carry: The critics' before the first step, per group (worlds, robots, memory).
        is_first: Whether it is reset before the step, per group (steps, worlds[, robots]).

    Returns:
        Values in the critics' own scale (`unscaled_values` undoes it), per group (steps, worlds, robots), and
        the carry afterwards.
    """
    obs, privileged = seen
    shared = normalise(
        train_state.privileged_statistics.mean, train_state.privileged_statistics.std, privileged
    )
    found: list[tuple[jax.Array, jax.Array]] = []
    for g, rows in enumerate(obs):
        scale = train_state.obs_statistics[g]
        x = networks.policy.normalised(g, scale.mean, scale.std, rows)
        params = train_state.params.critic[g]
        value, after = apply_network(networks.critic(g), params, x, shared, carry[g], is_first[g])
        found.append((value[..., 0], after))
    return tuple(value for value, _ in found), tuple(after for _, after in found)


def unscaled_values(train_state: TrainState, values: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
    """Return the critics' values in the unit of rewards."""
    return tuple(
        one * stats.std + stats.mean for one, stats in zip(values, train_state.return_statistics, strict=True)
    )
