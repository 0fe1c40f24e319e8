"""Settings of trainings: hyper-parameters, values for each task, usual engines; the record of a run."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, cast

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.settings import Setting, default_reader, validate
from usarmjx.base.settings.json_file import kept_text, read_kept
from usarmjx.engines import choose_engine
from usarmjx.train.envs.env import AgentGroup, Env
from usarmjx.train.task_names import newest_name, recorded_name
from usarmjx.train.tasks import TASKS

HOST_ENGINES = ("c",)
"""Engines whose worlds are in the memory of processors whatever JAX runs on."""
MAZE_SETTINGS: dict[str, Any] = {
    "entropy_coef": 0.0,
    "target_kl": 0.02,
    "hidden_sizes": (256, 128),
    "critic_hidden_sizes": (256, 128),
    "imitation_steps": 1_000_000,
    "checkpoint_interval": 10,
}
"""Settings of the runs of `explore-v1` and `victim-search-v1` in docs/evidence/training.md."""
SMALL_SETTINGS: dict[str, Any] = {
    **MAZE_SETTINGS,
    "learning_rate": 1e-3,
    "hidden_sizes": (128, 64),
    "critic_hidden_sizes": (128, 64),
    "imitation_steps": 350_000,
    "imitation_std": 0.1,
    "total_steps": 900_000,
}
"""Settings of runs of `hover-inspect` on two cores; `convoy` and `stairs` only imitate with them."""
GOAL_TASKS = ("explore-v3", "victim-search-v3", "relay-chain-v3")
"""Tasks whose robots choose goals."""
GOAL_SETTINGS: dict[str, Any] = {
    **{"gamma": 0.99, "gae_lambda": 0.95, "action_repeat": 8, "rollout_length": 25},
    **{"entropy_coef": 0.01, "network": "set"},
    **{"hidden_sizes": (128, 128, 128), "critic_hidden_sizes": (128, 128)},
    **{"imitation_steps": 1_000_000, "total_steps": 20_000_000},
}
SHORT_HORIZON = {"gamma": 0.97, "gae_lambda": 0.9}

# Settings of each task, as far as they differ from `Config`. Keys are task names in lower case.
HYPERPARAMETERS: dict[str, dict[str, Any]] = {
    "drive-to-goal": {"gamma": 0.98, "learning_rate": 1e-3, "entropy_coef": 0.002, "total_steps": 2_000_000},
    "explore-v1": {**MAZE_SETTINGS, **SHORT_HORIZON, "total_steps": 21_000_000},
    "victim-search-v1": {**MAZE_SETTINGS, **SHORT_HORIZON, "total_steps": 16_000_000},
    "explore-v2": {**MAZE_SETTINGS, **SHORT_HORIZON, "imitation_steps": 5_000_000, "total_steps": 24_000_000},
    **dict.fromkeys(GOAL_TASKS, GOAL_SETTINGS),
    "relay-chain-v3": {**GOAL_SETTINGS, "entropy_coef": 0.03, "teacher": "oracle"},
    "victim-search-v2": {
        **MAZE_SETTINGS,
        **{"gamma": 0.99, "gae_lambda": 0.95, "gru_size": 64},
        **{"imitation_steps": 6_000_000, "imitation_std": 0.1, "total_steps": 36_000_000},
    },
    "relay-chain-v1": {
        **MAZE_SETTINGS,
        "gamma": 0.99,
        "gae_lambda": 0.95,
        "imitation_steps": 6_000_000,
        "total_steps": 40_000_000,
    },
    "soccer-v1": {**MAZE_SETTINGS, "total_steps": 20_000_000},
    "soccer-v2": {
        **MAZE_SETTINGS,
        # Less than the task's own discount of 1: a learner with the same one gets nothing out of the gains.
        **{"gamma": 0.99, "gae_lambda": 0.95, "league": 8},
        **{"imitation_steps": 2_000_000, "total_steps": 20_000_000},
    },
    "stairs": {**SMALL_SETTINGS, "imitation_steps": 160_000, "imitation_std": 0.03, "total_steps": 160_000},
    "hover-inspect": SMALL_SETTINGS,
    "wander": {**SMALL_SETTINGS, "imitation_steps": 400_000, "imitation_std": 0.2, "total_steps": 800_000},
    "convoy": {
        **SMALL_SETTINGS,
        "imitation_steps": 1_000_000,
        "imitation_std": 0.05,
        "total_steps": 1_000_000,
    },
}

# Further settings for worlds on a GPU.
GPU_SETTINGS: dict[str, dict[str, Any]] = {
    "drive-to-goal": {"num_worlds": 1024},
    **{f"victim-search-v{number}": {"num_worlds": 1024, "num_minibatches": 16} for number in (1, 2)},
    **{task: {"num_worlds": 1024, "num_minibatches": 16} for task in GOAL_TASKS},
    **{
        task: {"num_worlds": 2048, "num_minibatches": 16}
        for task in HYPERPARAMETERS
        if task not in ("drive-to-goal", *GOAL_TASKS) and not task.startswith("victim-search")
    },
}
RECORD_FILE = "config.json"
SET_FILE = "seeds.json"
"""File of a folder whose folders `seed-K` are the runs of several seeds that train together."""
FORMAT = 1
PACKAGES = ("jax", "jaxlib", "flax", "optax", "brax", "mujoco", "mujoco-mjx", "numpy")
"""Packages whose versions a record keeps, because results depend on them."""
MAY_CHANGE = ("total_steps", "keep_checkpoints", "checkpoint_interval", "black_box")
"""Settings that may differ when a run is resumed."""
FIXED = {
    **{name: name for name in ("task", "engine", "overrides", "groups", "episode_steps", "processes")},
    "privileged_size": "numbers that only critics see",
}
"""Fields of a record that may not differ when a run is resumed, and their names in messages."""


for task in ("hover-inspect", "wander"):
    GPU_SETTINGS[task] |= {"total_steps": 10_000_000, "imitation_steps": 1_000_000, "learning_rate": 3e-4}


# Without entropy the league stays where imitation left it: it wins 1 in 20 games against the baseline.
GPU_SETTINGS["soccer-v2"] |= {
    **{"num_worlds": 4096, "total_steps": 300_000_000},
    **{"imitation_steps": 5_000_000, "entropy_coef": 0.005},
}


GPU_SETTINGS["stairs"] |= {"total_steps": 1_000_000, "imitation_steps": 1_000_000}


GPU_SETTINGS[
    "convoy"
] = {}  # 20 million steps in 2048 worlds, with actions that stray, came to half the score
DEFAULT_ENGINE: dict[str, str] = dict.fromkeys(
    (
        "drive-to-goal",
        *("explore-v1", "explore-v2", "victim-search-v1", "victim-search-v2"),
        *GOAL_TASKS,
        "relay-chain-v1",
        "convoy",
        "hover-inspect",
        "wander",
        "soccer-v2",
    ),
    "planar",
)
"""Engine that `auto` stands for in training, on any machine; scores are those of C MuJoCo."""
DEFAULT_PHYSICS: dict[str, str] = dict.fromkeys(
    (
        *("explore-v1", "explore-v2", "victim-search-v1", "victim-search-v2"),
        *GOAL_TASKS,
        "relay-chain-v1",
        "soccer-v2",
    ),
    "coarse",
)
"""Physics settings on that engine, for tasks that do not train with their own."""


def training_engine(task: str, engine: str) -> str:
    """Return the engine that a task is trained on: the named one, or the task's default for `auto`.

    Raises:
        UnknownNameError: No such engine; lists those there are.
    """
    default = DEFAULT_ENGINE.get(newest_name(task).lower())
    return default if default and engine.lower() == "auto" else choose_engine(engine, "train")


def training_fields(task: str, engine: str) -> dict[str, str]:
    """Return the fields of a task that training on the default engine changes."""
    name = newest_name(task).lower()
    physics, default = DEFAULT_PHYSICS.get(name), DEFAULT_ENGINE.get(name)
    return {"physics": physics} if physics and engine == default else {}


def overridden_fields(task: str, engine: str, fields: Mapping[str, Any]) -> str:
    """Return the fields of a task that a run sets beyond those of a bare command, as `advice=false`."""
    default = training_fields(task, engine)
    return ", ".join(f"{name}={value}" for name, value in fields.items() if default.get(name) != value)


def horizon_of(episode_steps: int) -> dict[str, float]:
    """Return a gamma and a GAE lambda that see as far as an episode lasts.

    A reward a whole episode later counts 1/e of one now, and the advantage estimate looks a tenth of an
    episode ahead before it trusts the critic.
    """
    # An episode of one step would give a gamma of 0.
    gamma = 1.0 - 1.0 / max(episode_steps, 2)
    # GAE decays by gamma times lambda: the division leaves the product at 1 - 10 / steps.
    return {"gamma": gamma, "gae_lambda": max(0.0, 1.0 - 10.0 / max(episode_steps, 10)) / gamma}


def on_gpu(engine: str) -> bool:
    """Return whether the worlds of an engine are on a GPU here; JAX is started by that."""
    import jax

    # In this order: JAX's backend is not started for worlds on the host.
    return engine not in HOST_ENGINES and jax.default_backend() != "cpu"


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of a run; the defaults suit a small task on a CPU.

    Attributes:
        total_steps: Agent steps in all: robots times worlds times actions. The last iteration is a whole one.
        num_worlds: Worlds in all, of all processes.
        seed: Seed of all random numbers.
        action_repeat: Steps of the worlds for which an action is kept; an agent step is all of them.
        rollout_length: Actions of every robot between two updates.
        num_epochs: Passes of an update through a rollout.
        num_minibatches: Parts that an epoch is divided into, by worlds.
        shuffle_blocks: Most blocks that the worlds are shuffled in, each for itself. The number of processes
            must divide it; results then do not depend on that number.
        learning_rate: Learning rate of Adam at the start.
        lr_schedule: Schedule of the learning rate. `constant`; `linear`, down to 0 at the last step; or
            `adaptive`, so that an update changes the policy by about `target_kl`.
        target_kl: Divergence of the new policy from the old one that the `adaptive` schedule aims at.
        gamma: Discount factor of the next step's value.
        gae_lambda: Lambda of generalized advantage estimation. 0 trusts the critic, 1 the sum of rewards.
        clip_epsilon: Distance of the ratio of new to old probability from 1 at which it is clipped.
        entropy_coef: Weight of the entropy bonus.
        value_coef: Weight of the critic's loss.
        max_grad_norm: Norm that longer gradients are cut to.
        reward_scale: Factor on rewards.
        network: Kind of the networks. `mlp`: layers over all numbers; `set`, of robots that choose: one layer
            for all choices, then rounds of attention between choices and other robots; `cnn`: as `set`, and
            convolutions over the picture of maps. Of the last two the hidden sizes are the width of the first
            layer, then of each round.
        hidden_sizes: Widths of the policy's hidden layers.
        critic_hidden_sizes: Widths of the critic's hidden layers.
        gru_size: Units of the GRU behind the hidden layers of policy and critic; 0: no memory.
        shared_policy: Train one policy for all classes of robots, which an offset of its first layer tells
            apart.
        normalize_obs: Shift and scale observations by their running mean and deviation.
        normalize_values: Let the critic learn values shifted and scaled in the same way.
        stagger_resets: Begin the first episodes at random times, so that the worlds' time-outs do not
            coincide.
        imitation_steps: Agent steps at the start in which the policy imitates a teacher; 0: PPO from the
            first step.
        teacher: Teacher of the imitation: the task's baseline; oracle, of robots that choose goals: the same
            on goals whose worth it knows, as it knows the building; a planner by name; a run or file.
        imitation_std: Deviation of actions before they are squashed that imitation acts with in the end, and
            PPO begins with. Smaller where a robot must not stray, as in narrow windows.
        curriculum: Share of the run in which generated arenas get harder, from the easiest to all; 0: all of
            them from the start.
        arena_refresh_interval: Iterations after which other generated arenas replace those in training, if
            the task's can be replaced; 0: never.
        league: Past selves that agents play against, in tasks with rivals; 0: only against itself.
        league_interval: Iterations between two policies that join the past selves.
        league_mix: Shares of games against idle rivals, the baseline, itself, the strongest past self, and
            any past self.
        checkpoint_interval: Iterations between checkpoints; there is always one at the end.
        keep_checkpoints: Latest checkpoints that are kept; the best one is kept too.
        black_box: Most recordings of worlds that go bad, in the folder `faults` of the run: the last two
            seconds of each. 0: none are made, and no worlds are kept for them.
    """

    total_steps: Annotated[int, Setting(ge=1, aliases=("steps",))] = 1_000_000
    num_worlds: Annotated[int, Setting(ge=1, aliases=("worlds",))] = 64
    seed: int = 0
    action_repeat: Annotated[int, Setting(ge=1)] = 1
    rollout_length: Annotated[int, Setting(ge=1, aliases=("rollout",))] = 32
    num_epochs: Annotated[int, Setting(ge=1, aliases=("epochs",))] = 4
    num_minibatches: Annotated[int, Setting(ge=1, aliases=("minibatches",))] = 4
    shuffle_blocks: Annotated[int, Setting(ge=1, aliases=("blocks",))] = 8
    learning_rate: Annotated[float, Setting(gt=0)] = 3e-4
    lr_schedule: Annotated[
        str, Setting(choices=("constant", "linear", "adaptive"), aliases=("schedule",))
    ] = "adaptive"
    target_kl: Annotated[float, Setting(gt=0)] = 0.01
    gamma: Annotated[float, Setting(ge=0, le=1, aliases=("discount",))] = 0.99
    gae_lambda: Annotated[float, Setting(ge=0, le=1, aliases=("trace",))] = 0.95
    clip_epsilon: Annotated[float, Setting(gt=0, aliases=("clip",))] = 0.2
    entropy_coef: Annotated[float, Setting(aliases=("entropy",))] = 0.003
    value_coef: Annotated[float, Setting(aliases=("value",))] = 0.5
    max_grad_norm: Annotated[float, Setting(gt=0, aliases=("max_gradient",))] = 1.0
    reward_scale: Annotated[float, Setting(gt=0)] = 1.0
    network: Annotated[str, Setting(choices=("mlp", "set", "cnn"))] = "mlp"
    hidden_sizes: Annotated[tuple[int, ...], Setting(ge=1, min_length=1, aliases=("layers",))] = (64, 64)
    critic_hidden_sizes: Annotated[
        tuple[int, ...], Setting(ge=1, min_length=1, aliases=("critic_layers",))
    ] = (64, 64)
    gru_size: Annotated[int, Setting(ge=0, aliases=("memory",))] = 0
    shared_policy: Annotated[bool, Setting(aliases=("shared",))] = False
    normalize_obs: Annotated[bool, Setting(aliases=("normalise_obs",))] = True
    normalize_values: Annotated[bool, Setting(aliases=("normalise_values",))] = True
    stagger_resets: Annotated[bool, Setting(aliases=("stagger",))] = True
    imitation_steps: Annotated[int, Setting(ge=0, aliases=("imitate",))] = 0
    teacher: str = "baseline"
    imitation_std: Annotated[float, Setting(gt=0, aliases=("imitate_std",))] = 0.3
    curriculum: Annotated[float, Setting(ge=0, le=1)] = 0.0
    arena_refresh_interval: Annotated[int, Setting(ge=0, aliases=("renew",))] = 4
    league: Annotated[int, Setting(ge=0)] = 0
    league_interval: Annotated[int, Setting(ge=1)] = 20
    league_mix: Annotated[tuple[float, ...], Setting(ge=0, min_length=5)] = (0.2, 0.2, 0.2, 0.2, 0.2)
    checkpoint_interval: Annotated[int, Setting(ge=1, aliases=("checkpoint_every",))] = 20
    keep_checkpoints: Annotated[int, Setting(ge=1, aliases=("keep",))] = 2
    black_box: Annotated[int, Setting(ge=0)] = 4

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            UsageError: Names the setting, its value and its limits.
        """
        validate(self)

    def problem(self) -> str:
        """Return the fault of settings that do not go together, in words; empty: there is none."""
        # Compiled shapes are fixed: all minibatches have the same number of worlds.
        if self.num_worlds % self.num_minibatches:
            return f"{self.num_worlds} worlds cannot be divided into {self.num_minibatches} minibatches"
        if self.network != "mlp" and (self.gru_size or self.shared_policy):
            return f"network is {self.network}, which has no gru_size and no shared_policy"
        if self.teacher != "baseline" and not self.imitation_steps:
            return f"teacher is {self.teacher}, but imitation_steps is 0: nothing is imitated"
        if self.league and (self.gru_size or self.network != "mlp"):
            return f"league is {self.league}, which needs network=mlp and gru_size=0"
        if len(self.league_mix) != 5 or sum(self.league_mix) <= 0:
            return f"league_mix is {list(self.league_mix)}, expected five shares, not all of them 0"
        if self.gru_size and self.action_repeat > 1:
            return (
                f"gru_size is {self.gru_size}, but a memory needs action_repeat 1, not {self.action_repeat}"
            )
        return ""

    @property
    def shuffled_blocks(self) -> int:
        """Blocks that the worlds are shuffled in; each minibatch takes equal shares of them."""
        # A minibatch takes an equal share of each block, so their number divides its worlds.
        share = self.num_worlds // self.num_minibatches
        return max(n for n in range(1, min(self.shuffle_blocks, share) + 1) if share % n == 0)

    def check_processes(self, processes: int) -> None:
        """Refuse numbers of processes that the worlds cannot be shared out to.

        Raises:
            UsageError: Says what to change.
        """
        if self.shuffled_blocks % processes:
            raise UsageError(
                f"{self.num_worlds} worlds in {self.num_minibatches} minibatches are shuffled in "
                f"{self.shuffled_blocks} blocks, which {processes} processes cannot share: set "
                f"shuffle_blocks to a multiple of {processes} that divides "
                f"{self.num_worlds // self.num_minibatches}"
            )

    def iterations(self, agents: int) -> int:
        """Return the number of rollouts and updates, with that many robots in a world."""
        # Rounded up: a run makes at least the steps that it was asked for.
        return -(-self.total_steps // (self.rollout_length * self.num_worlds * agents))

    def imitations(self, agents: int) -> int:
        """Return the number of them in which the policy imitates the baseline."""
        # Rounded up, too: any steps of imitation make at least one iteration.
        return -(-self.imitation_steps // (self.rollout_length * self.num_worlds * agents))


def turn_settings(task: str, turn_length: int) -> dict[str, Any]:
    """Return the settings for a task whose robots make two kinds of choices in turn, see `Task.turn_length`.

    An action is kept for a turn. As a turn is shorter than an action of the task without turns, there are
    more of them in a rollout and in the training, and each discounts the less.
    """
    usual = task_config(task)
    # Turns at least as long as an action need no other settings.
    if not turn_length or turn_length >= usual.action_repeat:
        return {}
    more = usual.action_repeat // turn_length
    counts = ("rollout_length", "imitation_steps", "total_steps")
    return {
        "action_repeat": turn_length,
        **{name: more * getattr(usual, name) for name in counts},
        **_discounts(usual, more),
    }


def wheel_settings(task: str, *, discrete: bool) -> dict[str, Any]:
    """Return the settings for a task whose robots usually choose, see `Task.discrete`, if they do not.

    A network over all numbers commands speeds in every step, with as much discount a second.
    """
    usual = task_config(task)
    if discrete or usual.network == "mlp":
        return {}
    return {"network": "mlp", "action_repeat": 1, **_discounts(usual, usual.action_repeat)}


def _discounts(usual: Config, more: int) -> dict[str, float]:
    """Return gamma and lambda of actions, as many of which together discount as a usual one."""
    # The root: as many factors multiply to the usual one.
    return {name: round(getattr(usual, name) ** (1 / more), 6) for name in ("gamma", "gae_lambda")}


def task_config(task: str, *, gpu: bool = False, **settings: Any) -> Config:  # noqa: ANN401 - values of any field
    """Return the settings for a task, with overrides.

    Args:
        task: Name of the task; a task without settings of its own gets the defaults of `Config`.
        gpu: Whether the worlds are on a GPU.
        settings: Values by field of `Config`; names of the version before are accepted with a warning.
            Without a setting there are as many minibatches as divide the worlds.

    Raises:
        UnknownNameError: No such setting; lists those there are.
        UsageError: A value that is not allowed; names its limits.
    """
    given = default_reader().values(Config, settings)
    name = newest_name(task).lower()
    own = {**HYPERPARAMETERS.get(name, {}), **(GPU_SETTINGS.get(name, {}) if gpu else {})}
    # A task without settings of its own keeps the defaults of `Config`, which the help shows.
    if own and "gamma" not in own:
        own |= horizon_of(TASKS.get(task).episode_steps)
    chosen: dict[str, Any] = {**own, **given}
    if "num_minibatches" not in given:
        # A default must suit any number of worlds: their greatest common divisor divides both.
        worlds, most = (chosen.get(key, getattr(Config, key)) for key in ("num_worlds", "num_minibatches"))
        chosen["num_minibatches"] = math.gcd(worlds, most)
    return Config(**chosen)


def from_record(record: Mapping[str, Any]) -> Config:
    """Return the settings that a file holds as JSON; names of older versions are renamed silently."""
    reader = default_reader()
    return reader.from_data(Config, reader.current_names(Config, record))


def differences(old: Config, new: Config, but: tuple[str, ...] = ()) -> list[str]:
    """Return the settings that differ, as text, but for some."""
    before, after = asdict(old), asdict(new)
    return [
        f"{key}: {before[key]} -> {after[key]}"
        for key in before
        if before[key] != after[key] and key not in but
    ]


@dataclass(frozen=True)
class EnvArguments:
    """The arguments that an environment was made with; see `make`.

    Attributes:
        engine: Engine as named, also `auto`.
        overrides: Overridden fields of the task, as typed: `make.task_values` reads them.
    """

    engine: str = "auto"
    overrides: dict[str, str] = field(default_factory=dict[str, str])


DEFAULT_ENV_ARGUMENTS = EnvArguments()


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """The settings that a run was started with.

    Attributes:
        task: Name of the environment.
        engine: Engine as named, also `auto`.
        overrides: Overridden fields of the task, as typed.
        groups: The agents.
        privileged_size: Numbers that only critics see.
        episode_steps: Steps of an episode at most.
        period: Simulated time of a step [s].
        processes: Number of processes that trained together.
        config: All settings.
        versions: Versions of the packages that results depend on.
        began_with: Run and checkpoint whose networks it began with, see `TrainedNetworks.origin`; None: with
            random ones.
    """

    task: str
    engine: str = "auto"
    overrides: dict[str, str] = field(default_factory=dict[str, str])
    groups: tuple[AgentGroup, ...]
    privileged_size: int
    episode_steps: int
    period: float
    processes: int
    config: Config
    versions: dict[str, str] = field(default_factory=dict[str, str])
    began_with: dict[str, Any] | None = None

    def save(self, folder: Path) -> None:
        """Write the record into a folder.

        Raises:
            WriteError: It cannot be written to.
        """
        with atomic_write(folder / RECORD_FILE) as fresh:
            fresh.write_text(kept_text({"format": FORMAT, **asdict(self)}), encoding="utf-8")

    def check_resumes(self, old: "RunRecord", folder: Path) -> None:
        """Refuse to go on with a run that was started as another one.

        Raises:
            UsageError: Lists the differences.
        """
        changed = differences(old.config, self.config, but=MAY_CHANGE)
        for name, shown in FIXED.items():
            before, now = _plain(getattr(old, name)), _plain(getattr(self, name))
            if before != now:
                changed.append(f"{shown}: {before} -> {now}")
        if changed:
            raise UsageError(f"the run in {folder} was started with other settings: {'; '.join(changed)}")


def _plain(value: Any) -> Any:  # noqa: ANN401 - anything that JSON can hold
    """Return a value as it is after writing and reading."""
    if isinstance(value, tuple):
        items = cast(tuple[Any, ...], value)
        value = [asdict(one) if isinstance(one, AgentGroup) else one for one in items]
    # The old record came through JSON, where tuples are lists and keys are text.
    return json.loads(json.dumps(value))


def make_record(
    env: Env, config: Config, processes: int, origin: EnvArguments = DEFAULT_ENV_ARGUMENTS
) -> RunRecord:
    """Return the record of a run."""
    return RunRecord(
        task=env.name,
        engine=origin.engine,
        overrides=origin.overrides,
        groups=tuple(
            AgentGroup(g.name, tuple(g.agents), g.obs_size, g.action_size, g.discrete, g.layout, g.vector)
            for g in env.groups
        ),
        privileged_size=env.privileged_size,
        episode_steps=env.episode_steps,
        period=env.period,
        processes=processes,
        config=config,
        versions={name: version(name) for name in PACKAGES},
    )


def load_record(folder: Path) -> RunRecord:
    """Return the record of a run.

    Raises:
        UsageError: There is none, or it does not read.
    """
    file = Path(folder) / RECORD_FILE
    if not file.is_file() and (seeds := load_seeds(Path(folder))):
        raise UsageError(
            f"{folder} has the runs of {len(seeds)} seeds: name one, as {seed_folder(folder, seeds[0])}"
        )
    if not file.is_file():
        raise UsageError(f"{folder} is no run: it has no {RECORD_FILE}")
    try:
        # Runs of earlier versions have records without a checksum.
        values = read_kept(file, needs_checksum=False)
        if values.pop("format") != FORMAT:
            raise UsageError(f"{file} was written by another version of usarmjx")
        values["config"] = from_record(values["config"])
        # Earlier releases wrote bare names, for version 1 of a task.
        values["task"] = recorded_name(values["task"])
        if values.get("began_with"):
            values["began_with"]["task"] = recorded_name(values["began_with"]["task"])
        return default_reader().from_data(RunRecord, values, where=str(file))
    # Somebody may have edited the file: parts of any type must give one line, not a traceback.
    except (KeyError, TypeError, AttributeError) as error:
        raise UsageError(f"{file} does not read: {error}") from error


@dataclass(frozen=True, kw_only=True)
class _Seeds:
    """Content of `SET_FILE`."""

    format: int
    seeds: tuple[int, ...]


def seed_folder(folder: Path, seed: int) -> Path:
    """Return the folder of a seed's run in the folder of several that train together."""
    return Path(folder) / f"seed-{seed}"


def save_seeds(folder: Path, seeds: Sequence[int]) -> None:
    """Note in a folder which seeds train together there.

    Raises:
        WriteError: It cannot be written to.
    """
    with atomic_write(folder / SET_FILE) as fresh:
        fresh.write_text(kept_text({"format": FORMAT, "seeds": list(seeds)}), encoding="utf-8")


def load_seeds(folder: Path) -> tuple[int, ...]:
    """Return the seeds that train together in a folder; none: it has no such runs.

    Raises:
        UsageError: The note of them does not read.
    """
    file = folder / SET_FILE
    if not file.is_file():
        return ()
    try:
        values = read_kept(file)
        if values["format"] != FORMAT:
            raise UsageError(f"{file} was written by another version of usarmjx")
        return tuple(default_reader().from_data(_Seeds, values, where=str(file)).seeds)
    except KeyError as error:
        raise UsageError(f"{file} does not read: {error}") from error
