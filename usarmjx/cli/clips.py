"""`usarmjx train --clips`: clips of a training beside its curves."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from usarmjx.cli.startup_messages import say

if TYPE_CHECKING:
    from usarmjx.plots.clips import Sink
    from usarmjx.train.envs.env import Env
    from usarmjx.train.envs.state import EnvState
    from usarmjx.train.learning.config import Config
    from usarmjx.train.learning.rollout_inputs import RolloutInputs


class ClippedTraining:
    """A training of which clips are made.

    Args:
        out: Folder of the run; clips go into its folder `clips`, and into TensorBoard's.
        every: Iterations from one clip to the next.
        wandb: Whether the run is shown in Weights & Biases, too.
    """

    def __init__(self, out: Path, every: int, wandb: bool) -> None:
        self._out, self._every, self._wandb = out, every, wandb
        self._held = ExitStack()

    def begin(self, env: "Env", config: "Config") -> None:
        """Take the training's worlds and its settings."""
        from usarmjx.plots.clips import Clips
        from usarmjx.train.learning.tensorboard import TensorBoardLog

        agents = sum(len(group.agents) for group in env.groups)
        steps = config.rollout_length * config.num_worlds * agents
        # A file of its own, as the curves' is held by the training; TensorBoard shows it as a run beside it.
        board = TensorBoardLog(self._out / "tensorboard" / "clips", 0)
        self._held.callback(board.close)

        def to_board(rank: str, path: Path, iteration: int) -> None:
            board.show_picture(iteration * steps, f"clips/{rank}", path.read_bytes())

        sinks: tuple[Sink, ...] = (to_board, _to_wandb) if self._wandb else (to_board,)
        self._clips = Clips(env, self._out / "clips", self._every, sinks)

    def look(self, state: "EnvState") -> None:
        """Ignore it."""

    def inspect(self, inputs: "RolloutInputs") -> None:
        """Make clips, if the iteration is one of those."""
        from usarmjx.base.errors import WriteError

        try:
            self._clips.inspect(inputs)
        except (OSError, WriteError) as error:
            say(f"no clips of iteration {inputs.iteration}: {error}; training goes on")

    def close(self) -> None:
        """Complete TensorBoard's file."""
        self._held.close()


def _to_wandb(rank: str, path: Path, iteration: int) -> None:
    """Add a clip to what is logged next; a service elsewhere may fail, training goes on."""
    from usarmjx.train.learning.metrics import find_wandb

    del iteration
    module = find_wandb()
    try:
        module.log({f"clips/{rank}": module.Video(str(path), format="gif")}, commit=False)
    except Exception as error:
        say(f"note: Weights & Biases has no clip {path.name}: {error}")
