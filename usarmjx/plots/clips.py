"""Clips of a training: the best, the median and the worst world of an iteration, from above."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from usarmjx.plots.play import EpisodeRecording, positions_of, save_recording
from usarmjx.train.envs.env import Env, EnvState
from usarmjx.train.learning.rollout_inputs import RolloutInputs, play_again

RANKS = ("best", "median", "worst")
Sink = Callable[[str, Path, int], None]
"""Receives a clip: `best`, `median` or `worst`, its GIF file, and the number of the iteration."""


def ranked_worlds(reward: np.ndarray, bad: np.ndarray) -> dict[str, int]:
    """Return the worlds with the highest, the median and the lowest sum of rewards, by rank.

    Args:
        reward: Rewards of each step (steps, worlds).
        bad: Steps in which a world went bad (steps, worlds); such a world counts only if all are bad.
    """
    sound = np.flatnonzero(~bad.any(0))
    worlds = np.asarray(sound if len(sound) else np.arange(bad.shape[1]), int)
    order = worlds[np.argsort(reward[:, worlds].sum(0), kind="stable")]
    return dict(zip(RANKS, map(int, (order[-1], order[len(order) // 2], order[0])), strict=True))


class Clips:
    """Clips of every n-th iteration of a training, made by playing its rollout again.

    A clip goes on to the end of the rollout, or of the episode if that is sooner. Engines that compile a
    whole iteration compile a single action once more for this.

    Args:
        env: The worlds of the training.
        folder: For the GIF files.
        every: Iterations from one to the next.
        sinks: Receivers of each clip.
    """

    def __init__(self, env: Env, folder: Path, every: int, sinks: tuple[Sink, ...] = ()) -> None:
        self._env, self._folder, self._every, self._sinks = env, folder, every, sinks

    def inspect(self, inputs: RolloutInputs) -> None:
        """Make clips of a rollout, if its iteration is one of those."""
        if inputs.iteration % self._every:
            return
        worlds = ranked_worlds(np.asarray(inputs.reward), np.asarray(inputs.bad))
        for rank, shown in self._shown(inputs, worlds).items():
            path = self._folder / f"iteration-{inputs.iteration:06d}-{rank}.gif"
            save_recording(shown, path)
            for sink in self._sinks:
                sink(rank, path, inputs.iteration)

    def _shown(self, inputs: RolloutInputs, worlds: dict[str, int]) -> dict[str, EpisodeRecording]:
        env = self._env
        ended = np.asarray(inputs.done).cumsum(0) > 0
        moments = {rank: [self._moment(inputs.env_state, world)] for rank, world in worlds.items()}
        for step, _, after in play_again(env, inputs, inputs.steps):
            for rank, world in worlds.items():
                if not ended[step, world]:
                    moments[rank].append(self._moment(after, world))
        names = tuple(one.name or f"{one.spec.name}{slot}" for slot, one in enumerate(env.scene.roster))
        goal = getattr(inputs.env_state.memory, "goal", None)
        in_plane = goal is not None and np.ndim(goal) == 2 and np.shape(goal)[1] == 2
        found: dict[str, EpisodeRecording] = {}
        for rank, world in worlds.items():
            scores, poses, loose = (np.array(column) for column in zip(*moments[rank], strict=True))
            found[rank] = EpisodeRecording(
                task=f"{env.name}, iteration {inputs.iteration}, {rank}",
                arena=env.batch.arena_of(inputs.env_state.batch, world),
                names=names,
                times=np.arange(len(scores)) * env.period,
                scores=scores,
                poses=poses,
                loose=loose,
                goal=np.asarray(goal)[world] if in_plane else None,
                end="",
            )
        return found

    def _moment(self, state: EnvState, world: int) -> tuple[float, np.ndarray, np.ndarray]:
        return float(np.asarray(state.score)[world]), *positions_of(self._env, state, world)
