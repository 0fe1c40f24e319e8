"""The settings that a run was started with, kept beside its results as `config.json`."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.settings import default_reader
from usarmjx.base.settings.json_file import kept_text, read_kept
from usarmjx.train.envs.env import AgentGroup, Env
from usarmjx.train.learning.config import Config, differences, from_record
from usarmjx.train.task_names import recorded_name

RECORD_FILE = "config.json"
SET_FILE = "seeds.json"
"""File of a folder whose folders `seed-K` are the runs of several seeds that train together."""
FORMAT = 1
PACKAGES = ("jax", "jaxlib", "flax", "optax", "brax", "mujoco", "mujoco-mjx", "numpy")
"""Packages whose versions a record keeps, because results depend on them."""
MAY_CHANGE = ("total_steps", "keep_checkpoints", "checkpoint_interval", "black_box")
"""Settings that may differ when a run is resumed."""
FIXED = ("task", "engine", "overrides", "groups", "privileged_size", "episode_steps", "processes")
"""Fields of a record that may not differ when a run is resumed."""


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
        for name in FIXED:
            before, now = _plain(getattr(old, name)), _plain(getattr(self, name))
            if before != now:
                changed.append(f"{name}: {before} -> {now}")
        if changed:
            raise UsageError(f"the run in {folder} was started with other settings: {'; '.join(changed)}")


def _plain(value: Any) -> Any:  # noqa: ANN401 - anything that JSON can hold
    """Return a value as it is after writing and reading."""
    if isinstance(value, tuple):
        items = cast(tuple[Any, ...], value)
        value = [asdict(one) if isinstance(one, AgentGroup) else one for one in items]
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
            AgentGroup(g.name, tuple(g.agents), g.obs_size, g.action_size, g.discrete, g.layout)
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
        values = read_kept(file, needs_checksum=False)
        if values.pop("format") != FORMAT:
            raise UsageError(f"{file} was written by another version of usarmjx")
        values["config"] = from_record(values["config"])
        values["task"] = recorded_name(values["task"])
        if values.get("began_with"):
            values["began_with"]["task"] = recorded_name(values["began_with"]["task"])
        return default_reader().from_data(RunRecord, values, where=str(file))
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
