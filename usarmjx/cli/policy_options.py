"""The options that name a policy, for commands that try one or show it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.registry import unknown_name
from usarmjx.cli.common import (
    PackagesOption,
    PiecesOption,
    SeedOption,
    TaskRobotOption,
    named,
    with_robot,
)
from usarmjx.cli.completion import complete_engines, complete_policies, complete_tasks
from usarmjx.cli.known_names import AGENTS, check_policy
from usarmjx.cli.task_options import (
    TaskConfigOption,
    TaskPrintOption,
    TaskSetOption,
    print_task,
    task_pairs,
)

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env
    from usarmjx.train.envs.task import Policy
    from usarmjx.train.policies.sources import PolicySource

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
        if self.policy is not None and self.baseline is None:
            check_policy(self.policy)
        if self.agent is not None and self.agent not in AGENTS:
            raise UnknownNameError(unknown_name("agent", self.agent, AGENTS))

    def source(self) -> "PolicySource":
        """Return the policy.

        Raises:
            UsageError: None is named, or two are, or there is none of that name.
        """
        from usarmjx.train.policies.sources import baseline as by_hand
        from usarmjx.train.policies.sources import load_policy, untrained
        from usarmjx.train.task_names import is_own

        if self.agent is not None:
            if self.policy is not None or self.baseline is not None or self.task is None:
                raise UsageError(
                    f"--agent {self.agent} needs --task NAME, and neither a policy nor a --baseline"
                )
            return untrained(self.agent, self.task)
        if self.baseline is not None and self.policy is None:
            return by_hand(self.baseline, self.task)
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
