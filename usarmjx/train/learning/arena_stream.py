"""An endless stream of generated arenas: others take the place of those that were trained on for a while.

48 large buildings are two to three seconds of work for a processor, and a GPU may need others every second:
where there are cores for it, processes beside this one make them.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from weakref import finalize

from usarmjx.base.process import cores
from usarmjx.base.worker_processes import WorkerProcesses, use_workers
from usarmjx.models.compile.arena_set import ArenaState
from usarmjx.train.envs.env import Env
from usarmjx.train.tasks.buildings import Buildings

MOST_WORKERS, CORES_A_WORKER, LEAST_CORES = 6, 2, 8
"""Processes that generate arenas, at most, for how many cores there is one, and from how many on."""
AHEAD = 2
"""Generations of arenas that processes are asked for before the first of them is met: one may take longer."""


class ArenaStream:
    """The arenas of each iteration. The next ones are generated beside the training.

    Which they are depends on the iteration alone, so that a run that is resumed meets the same ones.

    Args:
        env: The environment; other than renewable arenas stay as they are.
        every: Iterations after which others take their places; 0: they stay.
        iterations: Of the whole run: no arenas are generated for later ones.
        workers: Processes that generate them; 0: a thread of this one does.
    """

    def __init__(self, env: Env, every: int, iterations: int, workers: int = 0) -> None:
        self._env = env
        self.every = every if getattr(env, "renewable", False) else 0  # environments of one's own need it not
        self._last = (iterations - 1) // self.every if self.every else 0
        self._made: dict[int, Future[ArenaState]] = {}
        self._workers = WorkerProcesses(workers, [Buildings.__module__]) if workers and self._last else None
        self._maker = ThreadPoolExecutor(1, "arenas")
        finalize(self, self._maker.shutdown, wait=False, cancel_futures=True)

    def begins(self, iteration: int) -> bool:
        """Return whether others take their places before an iteration, counted from 0."""
        return bool(self.every) and iteration > 0 and iteration % self.every == 0

    def arenas(self, iteration: int) -> ArenaState | None:
        """Return the arenas of an iteration (arenas, ...); None: those of the beginning."""
        if not self.every:
            return None
        generation = iteration // self.every
        self._made = {number: made for number, made in self._made.items() if number >= generation}
        wanted = self._ask(generation) if generation else None
        ahead = AHEAD if self._workers else 1
        for later in range(generation + 1, min(generation + ahead, self._last) + 1):
            self._ask(later)
        return wanted.result() if wanted else None

    def _ask(self, generation: int) -> "Future[ArenaState]":
        if generation not in self._made:
            self._made[generation] = self._maker.submit(_generated, self._env, generation, self._workers)
        return self._made[generation]


def _generated(env: Env, generation: int, workers: WorkerProcesses | None) -> ArenaState:
    with use_workers(workers):
        return env.renewed_arenas(generation)


def workers_for(processes: int) -> int:
    """Return how many processes generate arenas for each of some trainers on this host."""
    mine = cores() // processes
    return min(MOST_WORKERS, mine // CORES_A_WORKER) if mine >= LEAST_CORES else 0
