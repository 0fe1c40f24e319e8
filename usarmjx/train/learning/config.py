"""How a policy is trained: hyper-parameters, and how they are set on a command line."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, cast

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.engines import choose_engine
from usarmjx.train.tasks import TASKS

HOST_ENGINES = ("c",)
"""Engines whose worlds are in the memory of processors whatever JAX runs on."""
MEASURED: dict[str, Any] = {
    "entropy": 0.0,
    "target_kl": 0.02,
    "layers": (256, 128),
    "critic_layers": (256, 128),
    "imitate": 1_000_000,
    "checkpoint_every": 10,
}
"""What the runs of `explore` and `victim-search` were made with that docs/training.md tells of."""
SMALL: dict[str, Any] = {
    **MEASURED,
    "learning_rate": 1e-3,
    "layers": (128, 64),
    "critic_layers": (128, 64),
    "imitate": 350_000,
    "imitate_std": 0.1,
    "steps": 900_000,
}
"""What runs of `hover-inspect` were made with on two cores; those of `convoy` and `stairs` only imitate."""
SHORT_SIGHT = {"discount": 0.97, "trace": 0.9}
# What each task is trained with, where it differs from `Config`. Keys are task names in lower case.
HYPERPARAMETERS: dict[str, dict[str, Any]] = {
    "drive-to-goal": {"discount": 0.98, "learning_rate": 1e-3, "entropy": 0.002, "steps": 2_000_000},
    **{f"explore{old}": {**MEASURED, **SHORT_SIGHT, "steps": 21_000_000} for old in ("", "-v1")},
    **{f"victim-search{old}": {**MEASURED, **SHORT_SIGHT, "steps": 16_000_000} for old in ("", "-v1")},
    "explore-v2": {**MEASURED, **SHORT_SIGHT, "imitate": 5_000_000, "steps": 24_000_000},
    "victim-search-v2": {
        **MEASURED,
        **{"discount": 0.99, "trace": 0.95, "memory": 64},
        **{"imitate": 6_000_000, "imitate_std": 0.1, "steps": 36_000_000},
    },
    "relay-chain": {**MEASURED, "discount": 0.99, "trace": 0.95, "imitate": 6_000_000, "steps": 40_000_000},
    "soccer": {**MEASURED, "steps": 20_000_000},
    "stairs": {**SMALL, "imitate": 160_000, "imitate_std": 0.03, "steps": 160_000},
    "hover-inspect": SMALL,
    "wander": {**SMALL, "imitate": 400_000, "imitate_std": 0.2, "steps": 800_000},
    "convoy": {**SMALL, "imitate": 1_000_000, "imitate_std": 0.05, "steps": 1_000_000},
}
# What else, where the worlds are on a GPU.
ON_GPU: dict[str, dict[str, Any]] = {
    "drive-to-goal": {"worlds": 1024},
    **{f"victim-search{version}": {"worlds": 1024, "minibatches": 16} for version in ("", "-v1", "-v2")},
    **{
        task: {"worlds": 2048, "minibatches": 16}
        for task in HYPERPARAMETERS
        if task != "drive-to-goal" and not task.startswith("victim-search")
    },
}
for task in ("hover-inspect", "wander"):
    ON_GPU[task] |= {"steps": 10_000_000, "imitate": 1_000_000, "learning_rate": 3e-4}
ON_GPU["stairs"] |= {"steps": 1_000_000, "imitate": 1_000_000}
ON_GPU["convoy"] = {}  # 20 million steps in 2048 worlds, with actions that stray, came to half the score

USUAL_ENGINE: dict[str, str] = dict.fromkeys(
    (
        "drive-to-goal",
        *("explore", "explore-v1", "explore-v2"),
        *("victim-search", "victim-search-v1", "victim-search-v2"),
        "relay-chain",
        "convoy",
        "hover-inspect",
        "wander",
    ),
    "planar",
)
"""What `auto` is in trainings of these tasks on any machine; their scores are those of C MuJoCo."""
USUAL_PHYSICS: dict[str, str] = dict.fromkeys(
    (
        *("explore", "explore-v1", "explore-v2"),
        *("victim-search", "victim-search-v1", "victim-search-v2"),
        "relay-chain",
    ),
    "coarse",
)
"""... and the settings of that engine's physics, where they are not the task's."""


def training_engine(task: str, engine: str) -> str:
    """Return the engine that a task is trained on: what is meant by `auto`, or the one that is named.

    Raises:
        UnknownNameError: No such engine; lists those there are.
    """
    usual = USUAL_ENGINE.get(task.lower())
    return usual if usual and engine.lower() == "auto" else choose_engine(engine, "train")


def training_fields(task: str, engine: str) -> dict[str, str]:
    """Return the fields of a task that a training sets otherwise, on an engine that `auto` is."""
    physics, usual = USUAL_PHYSICS.get(task.lower()), USUAL_ENGINE.get(task.lower())
    return {"physics": physics} if physics and engine == usual else {}


def fields_by_hand(task: str, engine: str, fields: Mapping[str, Any]) -> str:
    """Return the fields of a task that a run has and a bare command would not set, as `advice=false`."""
    usual = training_fields(task, engine)
    return ", ".join(f"{name}={value}" for name, value in fields.items() if usual.get(name) != value)


def horizon_of(episode_steps: int) -> dict[str, float]:
    """Return a discount and a trace that see as far as an episode lasts.

    What comes after a whole episode counts 1/e of what comes now, and the advantage estimate looks a tenth of
    an episode ahead before it trusts the critic.
    """
    discount = 1.0 - 1.0 / max(episode_steps, 2)
    return {"discount": discount, "trace": max(0.0, 1.0 - 10.0 / max(episode_steps, 10)) / discount}


def on_gpu(engine: str) -> bool:
    """Return whether the worlds of an engine are on a GPU here; JAX is started by that."""
    import jax

    return engine not in HOST_ENGINES and jax.default_backend() != "cpu"


SCHEDULES = ("constant", "linear", "adaptive")

# Settings, what they must be, and that in words.
_BOUNDS: tuple[tuple[tuple[str, ...], Callable[[Any], bool], str], ...] = (
    (
        ("steps", "worlds", "rollout", "epochs", "minibatches", "blocks", "checkpoint_every", "keep"),
        lambda value: value >= 1,
        "at least 1",
    ),
    (("imitate", "renew"), lambda value: value >= 0, "at least 0"),
    (("discount", "trace", "curriculum"), lambda value: 0.0 <= value <= 1.0, "from 0 to 1"),
    (
        ("learning_rate", "target_kl", "clip", "max_gradient", "reward_scale", "imitate_std"),
        lambda value: value > 0.0,
        "above 0",
    ),
)


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of a run; the defaults suit a small task on a CPU.

    Attributes:
        steps: Agent steps in all: robots times worlds times actions. The last iteration is a whole one.
        worlds: Worlds in all, of all processes.
        seed: Of all random numbers.
        rollout: Actions of every robot between two updates.
        epochs: How often an update goes through a rollout.
        minibatches: Parts that an epoch is divided into, by worlds.
        blocks: Most blocks that the worlds are shuffled in, each for itself; the number of processes must
            divide it, and then it does not matter how many there are.
        learning_rate: Of Adam, at the start.
        schedule: `constant`; `linear`, down to 0 at the last step; or `adaptive`, so that an update changes
            the policy by about `target_kl`.
        target_kl: Divergence of the new policy from the old one that `adaptive` aims at.
        discount: Of the next step's value.
        trace: Lambda of the advantage estimate: 0 trusts the critic, 1 the sum of rewards.
        clip: How far the ratio of new to old probability may be from 1 before it stops to count.
        entropy: Weight of the entropy bonus.
        value: Weight of the critic's loss.
        max_gradient: Longer gradients are cut to this length.
        reward_scale: Rewards are multiplied by this.
        layers: Widths of the policy's hidden layers.
        critic_layers: Widths of the critic's hidden layers.
        memory: Units of the GRU behind the hidden layers of policy and critic; 0: no memory.
        shared: All classes of robots have one policy; it tells them apart by an offset of its first layer.
        normalise_obs: Shift and scale what the networks see by its running mean and deviation.
        normalise_values: Let the critic learn values shifted and scaled in the same way.
        stagger: Begin the first episodes at random times, so that the worlds' time-outs do not coincide.
        imitate: Agent steps at the start in which the policy learns to do what the task's baseline would do;
            0: PPO from the first step.
        imitate_std: Deviation of actions before they are squashed that imitation acts with in the end, and
            PPO begins with. Smaller where a robot must not stray, as in narrow windows.
        curriculum: Share of the run in which generated arenas get harder, from the easiest to all; 0: all
            of them from the start.
        renew: Iterations after which other generated arenas take the place of those in training, if the
            task's can be replaced; 0: never.
        checkpoint_every: Iterations between checkpoints; there is always one at the end.
        keep: Latest checkpoints that are kept; the best one is kept too.
    """

    steps: int = 1_000_000
    worlds: int = 64
    seed: int = 0
    rollout: int = 32
    epochs: int = 4
    minibatches: int = 4
    blocks: int = 8
    learning_rate: float = 3e-4
    schedule: str = "adaptive"
    target_kl: float = 0.01
    discount: float = 0.99
    trace: float = 0.95
    clip: float = 0.2
    entropy: float = 0.003
    value: float = 0.5
    max_gradient: float = 1.0
    reward_scale: float = 1.0
    layers: tuple[int, ...] = (64, 64)
    critic_layers: tuple[int, ...] = (64, 64)
    memory: int = 0
    shared: bool = False
    normalise_obs: bool = True
    normalise_values: bool = True
    stagger: bool = True
    imitate: int = 0
    imitate_std: float = 0.3
    curriculum: float = 0.0
    renew: int = 4
    checkpoint_every: int = 20
    keep: int = 2

    def __post_init__(self) -> None:
        """Refuse what cannot be trained with.

        Raises:
            UsageError: Names the setting, and what it may be.
        """
        for names, fine, words in _BOUNDS:
            for name in names:
                if not fine(getattr(self, name)):
                    raise UsageError(f"{name} is {getattr(self, name)}; it must be {words}")
        if self.schedule not in SCHEDULES:
            raise UsageError(f"schedule is {self.schedule!r}; it may be {', '.join(SCHEDULES)}")
        if self.memory < 0 or min((*self.layers, *self.critic_layers, 1)) < 1 or not self.layers:
            raise UsageError(
                f"layers {self.layers}, critic_layers {self.critic_layers}, memory {self.memory}: the policy "
                "needs a hidden layer, widths are at least 1, memory at least 0"
            )
        if not self.critic_layers:
            raise UsageError("critic_layers is empty; the critic needs a hidden layer")
        if self.worlds % self.minibatches:
            raise UsageError(f"{self.worlds} worlds cannot be divided into {self.minibatches} minibatches")

    @property
    def shuffled_blocks(self) -> int:
        """Blocks that the worlds are shuffled in: each minibatch takes as many worlds of each of them."""
        share = self.worlds // self.minibatches
        return max(n for n in range(1, min(self.blocks, share) + 1) if share % n == 0)

    def check_processes(self, processes: int) -> None:
        """Refuse numbers of processes that the worlds cannot be shared out to.

        Raises:
            UsageError: Says what to change.
        """
        if self.shuffled_blocks % processes:
            raise UsageError(
                f"{self.worlds} worlds in {self.minibatches} minibatches are shuffled in "
                f"{self.shuffled_blocks} blocks, which {processes} processes cannot share: set blocks to a "
                f"multiple of {processes} that divides {self.worlds // self.minibatches}"
            )

    def iterations(self, agents: int) -> int:
        """Return the number of rollouts and updates, with that many robots in a world."""
        return -(-self.steps // (self.rollout * self.worlds * agents))

    def imitations(self, agents: int) -> int:
        """Return in how many of them the policy imitates the baseline."""
        return -(-self.imitate // (self.rollout * self.worlds * agents))


def check_names(settings: Iterable[str]) -> None:
    """Refuse settings that there are not.

    Raises:
        UnknownNameError: Lists those there are.
    """
    known = [field.name for field in fields(Config)]
    if bad := sorted(set(settings) - set(known)):
        raise UnknownNameError(f"unknown setting {', '.join(bad)}; known: {', '.join(known)}")


def task_config(task: str, *, gpu: bool = False, **settings: Any) -> Config:  # noqa: ANN401 - values of any field
    """Return the settings for a task, some of them set otherwise.

    Args:
        task: Name of the task; of one that is not in the table `Config` has the settings.
        gpu: Whether the worlds are on a GPU.
        settings: What is set otherwise. Minibatches that are not set are as many as the worlds allow.

    Raises:
        UnknownNameError: No such setting; lists those there are.
        UsageError: A value that it may not have.
    """
    check_names(settings)
    name = task.lower()
    own = {**HYPERPARAMETERS.get(name, {}), **(ON_GPU.get(name, {}) if gpu else {})}
    if own and "discount" not in own:
        own |= horizon_of(TASKS.get(task).episode_steps)
    chosen: dict[str, Any] = {**own, **settings}
    if "minibatches" not in settings and isinstance(worlds := chosen.get("worlds", Config.worlds), int):
        chosen["minibatches"] = max(1, math.gcd(worlds, chosen.get("minibatches", Config.minibatches)))
    return Config(**chosen)


def from_record(record: Mapping[str, Any]) -> Config:
    """Return the settings from what `asdict` gave, read back from JSON."""
    values: dict[str, Any] = {
        key: tuple(cast(list[Any], value)) if isinstance(value, list) else value
        for key, value in record.items()
    }
    check_names(values)
    return Config(**values)


def differences(old: Config, new: Config, but: tuple[str, ...] = ()) -> list[str]:
    """Return in words which settings differ, but for some."""
    before, after = asdict(old), asdict(new)
    return [
        f"{key}: {before[key]} -> {after[key]}"
        for key in before
        if before[key] != after[key] and key not in but
    ]


def _truth(text: str) -> bool:
    values = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    return values[text.lower()]


def _widths(text: str) -> tuple[int, ...]:
    return tuple(int(float(width)) for width in text.strip("[]() ,").split(",") if width.strip())


# bool before int: a bool is an int.
_READERS: dict[type, Callable[[str], Any]] = {
    bool: _truth,
    int: int,
    float: float,
    tuple: _widths,
    str: str,
}


def read_as(example: Any, text: str) -> Any:  # noqa: ANN401 - of the example's type
    """Return a value of the same type as the example.

    Raises:
        ValueError: The text does not read as that.
        KeyError: The text is no truth value.
    """
    kind = next((kind for kind in _READERS if isinstance(example, kind)), str)
    if kind is tuple and example and isinstance(example[0], str):
        return tuple(word.strip() for word in text.split(",") if word.strip())
    return _READERS[kind](text)


def parse_settings(pairs: Iterable[str], examples: Mapping[str, Any], what: str) -> dict[str, Any]:
    """Return settings given as `key=value`, each of the type of its example.

    Args:
        pairs: As typed; tuples are numbers or words with commas between them.
        examples: What may be set, with a value of its type.
        what: What they are settings of, for messages.

    Raises:
        UnknownNameError: A key that may not be set; lists those that may.
        UsageError: A pair or value that does not read.
    """
    found: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals:
            raise UsageError(f"{pair!r} is not of the form key=value")
        if key not in examples:
            raise UnknownNameError(f"{what} has no setting {key!r}; it has: {', '.join(examples)}")
        try:
            found[key] = read_as(examples[key], text)
        except (KeyError, ValueError) as error:
            kind = type(examples[key]).__name__
            raise UsageError(f"{key}={text}: {what} needs a value of type {kind} there") from error
    return found
