"""The options that name a task, with its fields, and those that name a policy."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, cast

import typer

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.registry import unknown_name
from usarmjx.base.settings import (
    FileValue,
    default_reader,
    describe,
    parse_assignments,
    read_file,
    summary,
    to_data,
    to_text,
)
from usarmjx.cli.common import (
    PackagesOption,
    PiecesOption,
    SeedOption,
    TaskRobotOption,
    named,
    with_robot,
)
from usarmjx.cli.known_names import AGENTS, check_policy, complete_engines, complete_policies, complete_tasks

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env
    from usarmjx.train.envs.task import Policy, Task
    from usarmjx.train.policies.sources import PolicySource


TaskSetOption = Annotated[
    list[str] | None,
    typer.Option("--set", "-c", help="A field of the task as name=value; may be repeated."),
]
TaskConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE", help="Fields of the task from a YAML, JSON or TOML file, before --set."
    ),
]
TaskPrintOption = Annotated[
    bool,
    typer.Option("--print-config", help="Write the fields of the task as a file for --config, and end."),
]
PolicyEngineOption = Annotated[
    str,
    typer.Option(
        help="warp, jax, c, planar, or auto: the best for this here.",
        autocompletion=complete_engines,
        callback=named("engine"),
    ),
]
SplitOption = Annotated[
    str | None,
    typer.Option(
        help="Buildings, where they are generated: test; validation, to choose by; train; fresh, which "
        "arena.seed draws. Default: test."
    ),
]


def task_pairs(task: str, settings: Sequence[str], config: Path | None) -> list[str]:
    """Return fields of a task from a file and from `--set`, `name=text` each; those of `--set` have priority.

    Settings of a training are skipped: `usarmjx train --print-config` writes both.

    Raises:
        UsageError: A field that the task does not have, or a value that is not allowed; names file and line.
    """
    if config is None:
        return [*settings]
    from usarmjx.train.learning.config import Config
    from usarmjx.train.make import make_task

    known = default_reader().names(Config)
    mine = {name: value for name, value in read_file(config).mapping().items() if name not in known}
    typed = dict(parse_assignments(settings, "--set"))
    fields = fields_over(typed, field_texts(make_task(task), mine))
    return [f"{name}={text}" for name, text in fields.items()]


def field_texts(task: "Task", data: Mapping[str, FileValue]) -> dict[str, str]:
    """Return checked fields of a file as texts that `--set` reads."""
    # Only checked, in the file's form: a refusal then names the file's line.
    default_reader().values(type(task), data, base=task)
    return {name: text for key, value in data.items() for name, text in _as_texts(key, value)}


def fields_over(own: Mapping[str, str], fields: Mapping[str, str]) -> dict[str, str]:
    """Return fields of a task as texts: own ones, and others that these do not replace.

    Own parts of settings replace the whole that another source has, but for physics: there they change it.
    """

    def replaced(name: str) -> bool:
        parts = name != "physics" and any(one.startswith(f"{name}.") for one in own)
        return parts or name.partition(".")[0] in own

    return {**{name: text for name, text in fields.items() if not replaced(name)}, **own}


def _as_texts(name: str, value: FileValue) -> Iterator[tuple[str, str]]:
    """Yield a field of a file as texts that `--set` reads, those of nested settings by names with dots."""
    if isinstance(value.data, dict):
        for key, item in value.data.items():
            yield from _as_texts(f"{name}.{key}", item)
    else:
        yield name, to_text(value.plain())


def print_task(task: str, trained: Mapping[str, str], pairs: Sequence[str]) -> None:
    """Write the fields of a task, as a policy was trained and as they are set, as a file for `--config`."""
    from usarmjx.train.policies.sources import task_settings

    chosen, _ = task_settings(task, trained, pairs)
    typer.echo(task_text(task, chosen), nl=False)


def task_text(task: str, overrides: Mapping[str, Any]) -> str:
    """Return the fields of a task as YAML, but for those whose names settings of a training have."""
    from usarmjx.base.settings.yaml_file import dump_yaml
    from usarmjx.train.learning.config import Config
    from usarmjx.train.make import make_task

    chosen = make_task(task, **overrides)
    names = {one.name for one in describe(Config)}
    rows = {one.name: one for one in describe(type(chosen)) if one.name not in names}
    data = {name: to_data(value) for name in rows if _is_data(value := getattr(chosen, name))}
    if "repeat" not in overrides:  # it follows from the physics
        data.pop("repeat")
    return dump_yaml(data, {name: summary(rows[name]) for name in data})


def _is_data(value: object) -> bool:
    """Return whether a field of a task reads back from a file: it is no description that Python built."""
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.comms.mail import MessageSettings
    from usarmjx.models.compile.physics import Physics
    from usarmjx.models.compile.randomization import DomainRandomization

    settings = (Physics, RadioSettings, MessageSettings, DomainRandomization)
    plain = value is None or isinstance(value, (str, bool, int, float, *settings))
    return plain or (isinstance(value, tuple) and all(map(_is_data, cast(tuple[object, ...], value))))


@dataclass(frozen=True, kw_only=True)
class PolicyOptions:
    """A policy, and what it is for; each field is an option."""

    panel: ClassVar[str] = "Policy"

    policy: Annotated[
        str | None,
        typer.Argument(
            help="Folder of a run, a file of `usarmjx export`, or the task of a packaged policy.",
            autocompletion=complete_policies,
        ),
    ] = None
    baseline: Annotated[
        str | None,
        typer.Option(
            help="Baseline of a task, in place of a trained policy.",
            autocompletion=complete_tasks,
            callback=named("baseline"),
        ),
    ] = None
    agent: Annotated[
        str | None,
        typer.Option(help="With --task: zero, which does nothing, or random, in place of a policy."),
    ] = None
    task: Annotated[
        str | None,
        typer.Option(
            help="Name of the task or FILE.py:CLASS, if it is not the one that the policy is for; alone: its "
            "packaged policy.",
            autocompletion=complete_tasks,
            callback=named("task"),
        ),
    ] = None
    checkpoint: Annotated[str, typer.Option(help="Of a run: best, last, or the number of an iteration.")] = (
        "best"
    )
    settings: TaskSetOption = None
    config: TaskConfigOption = None
    print_config: TaskPrintOption = False
    seed: SeedOption = 0
    robot: TaskRobotOption = None
    packages: PackagesOption = None
    pieces: PiecesOption = None

    def check(self) -> None:
        """Refuse a policy or an agent that is nowhere, before anything is imported.

        Raises:
            UnknownNameError: Gives the closest name and all.
        """
        # Two at once are refused by `source`, whose line says what to do.
        if self.policy is not None and self.baseline is None:
            check_policy(self.policy)
        if self.agent is not None and self.agent not in AGENTS:
            raise UnknownNameError(unknown_name("agent", self.agent, AGENTS))

    def source(self) -> "PolicySource":
        """Return the policy.

        Raises:
            UsageError: None is named, or two are, or there is none of that name.
        """
        from usarmjx.train.policies.sources import baseline as baseline_source
        from usarmjx.train.policies.sources import load_policy, untrained
        from usarmjx.train.task_names import is_own

        if self.agent is not None:
            if self.policy is not None or self.baseline is not None or self.task is None:
                raise UsageError(
                    f"--agent {self.agent} needs --task NAME, and neither a policy nor a --baseline"
                )
            return untrained(self.agent, self.task)
        if self.baseline is not None and self.policy is None:
            return baseline_source(self.baseline, self.task)
        named = self.policy or self.task
        if named is None or self.baseline is not None:
            raise UsageError("name either a run, file or packaged policy, or a --baseline")
        if self.policy is None and is_own(named):
            raise UsageError(
                f"no policy is packaged for {named}: name a run's folder too, or --baseline {named}"
            )
        found = load_policy(named, self.checkpoint)
        if found.checkpoint:
            typer.echo(f"usarmjx: {found.checkpoint}", err=True)
        return found if self.task is None else found.for_task(self.task)

    def amount(
        self, source: "PolicySource", split: str | None, worlds: int | None, episodes: int | None
    ) -> tuple[int, int]:
        """Return the numbers of worlds and of episodes, see `PolicySource.amount`."""
        return source.amount(self.pairs(source), split, worlds, episodes)

    def env(
        self, source: "PolicySource", worlds: int, engine: str, split: str | None = None
    ) -> "tuple[Env, Policy]":
        """Return worlds of the policy's task, and the policy; report fields that could not be set."""
        env, driver, notes = source.env(
            self.pairs(source), worlds=worlds, engine=engine, seed=self.seed, split=split
        )
        for note in notes:
            typer.echo(f"usarmjx: note: {note}", err=True)
        return env, driver

    def pairs(self, source: "PolicySource") -> list[str]:
        """Return the fields that are set, by file and `--set`, `name=value` each."""
        source.check_task()
        return task_pairs(source.task, with_robot(self.settings, self.robot), self.config)

    def print_fields(self) -> None:
        """Write the fields of the task as a file for `--config`."""
        source = self.source()
        print_task(source.task, source.overrides, self.pairs(source))
