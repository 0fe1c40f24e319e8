"""What each task is trained with unless one says otherwise; more worlds where there is a GPU."""

from collections.abc import Mapping
from typing import Any

from usarmjx.engines import choose_engine

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
