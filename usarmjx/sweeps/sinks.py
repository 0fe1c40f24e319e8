"""Where cells are shown beside their folder: TensorBoard, Weights & Biases."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from usarmjx.base.errors import UsageError, one_line
from usarmjx.sweeps.settings import as_text
from usarmjx.sweeps.store import CellRecord
from usarmjx.sweeps.table import scores_of
from usarmjx.train.learning.wandb_log import find_wandb

Sink = Callable[[CellRecord], None]
"""Is told of each cell that is finished or has failed."""


def numbers_of(record: CellRecord) -> dict[str, float]:
    """Return what is shown of a cell: mean score, means of the metrics, numbers among its settings."""
    good = record.good
    shown = {"score": float(scores_of(record).mean())} if good else {}
    for name, values in record.metrics.items():
        if good:
            shown[f"metric/{name}"] = float(np.mean([values[number] for number in good]))
    return shown


def tensorboard_sink(folder: Path) -> Sink:
    """Return what writes cells to TensorBoard: step k is the k-th cell that was played.

    Raises:
        UsageError: tensorboardX is missing.
    """
    try:
        from usarmjx.train.learning.board import Board
    except ImportError as error:
        raise UsageError("TensorBoard needs tensorboardX: pip install usarmjx[train]") from error
    board, count = Board(Path(folder), 0), [0]

    def show(record: CellRecord) -> None:
        count[0] += 1
        settings = {
            f"setting/{key}": float(value)
            for key, value in record.settings.items()
            if isinstance(value, int | float) and not isinstance(value, bool)
        }
        board.show(count[0], {**settings, **numbers_of(record)})

    return show


def wandb_sink(project: str, name: str) -> Sink:
    """Return what sends cells to Weights & Biases, each as a run of one group.

    Raises:
        UsageError: wandb is missing, or cannot begin.
    """
    module = find_wandb()

    def show(record: CellRecord) -> None:
        config = {key: as_text(value) for key, value in record.settings.items()}
        try:
            run = module.init(
                project=project, group=name, name=record.key, config=config, reinit="finish_previous"
            )
            run.log(numbers_of(record))
            run.finish(exit_code=0 if record.failed is None else 1)
        except Exception as error:  # of a service elsewhere
            raise UsageError(f"Weights & Biases: {one_line(error)}") from error

    return show
