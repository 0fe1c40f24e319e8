"""An endless stream of generated arenas that replace those of earlier iterations.

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

MAX_WORKERS, CORES_PER_WORKER, MIN_CORES = 6, 2, 8
"""Processes that generate arenas, at most, for how many cores there is one, and from how many on."""
GENERATIONS_AHEAD = 2
"""Generations that are requested before they are due: one may take longer than its interval."""


class ArenaStream:
    """The arenas of each iteration. The next ones are generated beside the training.

    Which they are depends on the iteration alone, so that a run that is resumed meets the same ones.

    Args:
        env: The environment; arenas that are not renewable stay.
        interval: Iterations between two replacements; 0: the arenas stay.
        iterations: Iterations of the run: no arenas are generated for later ones.
        workers: Processes that generate them; 0: a thread of this one does.
    """

    def __init__(self, env: Env, interval: int, iterations: int, workers: int = 0) -> None:
        self._env = env
        self.interval = (
            interval if getattr(env, "renewable", False) else 0
        )  # environments of one's own need it not
        self._last = (iterations - 1) // self.interval if self.interval else 0
        self._requests: dict[int, Future[ArenaState]] = {}
        self._workers = WorkerProcesses(workers, [Buildings.__module__]) if workers and self._last else None
        self._pool = ThreadPoolExecutor(1, "arenas")
        finalize(self, self._pool.shutdown, wait=False, cancel_futures=True)

    def is_refresh(self, iteration: int) -> bool:
        """Return whether arenas are replaced before an iteration, counted from 0."""
        return bool(self.interval) and iteration > 0 and iteration % self.interval == 0

    def arenas(self, iteration: int) -> ArenaState | None:
        """Return the arenas of an iteration (arenas, ...); None: those of the beginning."""
        if not self.interval:
            return None
        generation = iteration // self.interval
        self._requests = {number: made for number, made in self._requests.items() if number >= generation}
        present = self._request(generation) if generation else None
        ahead = GENERATIONS_AHEAD if self._workers else 1
        for later in range(generation + 1, min(generation + ahead, self._last) + 1):
            self._request(later)
        return present.result() if present else None

    def _request(self, generation: int) -> "Future[ArenaState]":
        if generation not in self._requests:
            self._requests[generation] = self._pool.submit(_generated, self._env, generation, self._workers)
        return self._requests[generation]


def _generated(env: Env, generation: int, workers: WorkerProcesses | None) -> ArenaState:
    with use_workers(workers):
        return env.redrawn_arenas(generation)


def workers_for(processes: int) -> int:
    """Return the number of processes that generate arenas for each of some trainers on this host."""
    mine = cores() // processes
    return min(MAX_WORKERS, mine // CORES_PER_WORKER) if mine >= MIN_CORES else 0
