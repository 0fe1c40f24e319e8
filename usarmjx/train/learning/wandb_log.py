"""A run in Weights & Biases: the same numbers as in TensorBoard, over agent steps."""

from collections.abc import Callable, Mapping
from typing import Any

from usarmjx.base.errors import UsageError, one_line

IterationWatch = Callable[[dict[str, Any]], None]
"""Is told what is written of each iteration."""


def find_wandb() -> Any:  # noqa: ANN401 - a package that may be missing
    """Return the module wandb.

    Raises:
        UsageError: It is missing.
    """
    try:
        import wandb  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UsageError("Weights & Biases needs wandb: pip install wandb") from error
    return wandb


def wandb_watch(
    project: str, name: str, settings: Mapping[str, Any], say: Callable[[str], None]
) -> IterationWatch:
    """Return what sends iterations to a project. What the service refuses later is told of once.

    Args:
        project: Of Weights & Biases.
        name: Of the run; one that is resumed is gone on with, by this name.
        settings: Of the run.
        say: Takes a line.

    Raises:
        UsageError: wandb is missing, or cannot begin.
    """
    module = find_wandb()
    try:
        run = module.init(project=project, id=name, name=name, config=dict(settings), resume="allow")
    except Exception as error:  # of a service elsewhere
        raise UsageError(f"Weights & Biases: {one_line(error)}") from error
    failed: list[str] = []

    def watch(line: dict[str, Any]) -> None:
        numbers = {key: value for key, value in line.items() if value is not None}
        try:
            run.log(numbers, step=line["agent_steps"])
        except Exception as error:  # the training is worth more than its curve
            if not failed:
                say(f"note: Weights & Biases: {one_line(error)}; training goes on")
            failed.append(one_line(error))

    return watch
