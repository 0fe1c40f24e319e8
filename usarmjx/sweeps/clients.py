"""Cells whose robots clients drive over TCP: the task's worlds are served, and a program is started for each.

The clock stands until each world has a client, then it runs at the cell's speed; so this takes as long
as the episodes last, and no two runs are alike to the bit. Robots that no client has stand still.
"""

import asyncio
import contextlib
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.ports import bound_ports, count_up
from usarmjx.server.runtime.loop import ServerLoop, StepClock
from usarmjx.server.worlds.policy_world import PolicyBatch, PolicyWorld
from usarmjx.sim.world import Stream, episode_key
from usarmjx.sweeps.batch import CellEpisodes
from usarmjx.sweeps.drivers import CellDriver
from usarmjx.sweeps.resolve import Resolved
from usarmjx.sweeps.workers import children, end_with_this_process
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy, TaskView
from usarmjx.train.make import build_env
from usarmjx.train.tasks import GoalTeam

HOST = "127.0.0.1"
PATIENCE = 60.0
"""Longest time until clients come [s]."""
POLL = 0.005
"""Interval of checks whether an episode is over [s]."""
PORT, NUMBER = "USARMJX_PORT", "USARMJX_EPISODE"
"""Environment variables that tell a client where its world is, and the number of its episode."""


class _Served(PolicyBatch):
    """Worlds of a task whose first episodes are kept.

    Args:
        env: The task.
        seed: Of the task's random numbers.
    """

    def __init__(self, env: Env, seed: int) -> None:
        self.scores, self.lengths = np.full(env.worlds, np.nan), np.zeros(env.worlds, int)
        super().__init__(env, _idle(env), seed)

    def _step(self) -> None:
        super()._step()
        state = jax.device_get(self._policy_state)
        # A world that is in a later episode has closed its first.
        ended = np.isnan(self.scores) & (state.episode > 0)
        self.scores[ended] = state.score[ended]
        self.lengths[ended] = self.steps // self.env.task.repeat

    def _begin(self, view: TaskView, key: jax.Array, episode: jax.Array) -> Any:  # noqa: ANN401 - its memory
        """Begin as the episodes of a batch do, with what the world draws."""
        del key, episode
        return self.env.task.start(view, jnp.asarray(episode_key(view.world, Stream.TASK_START)))

    @property
    def over(self) -> bool:
        """Whether each world's first episode is over."""
        return not np.isnan(self.scores).any()


def _idle(env: Env) -> Policy:
    """Return a policy that does nothing."""
    sizes = [(len(group.agents), group.action_size) for group in env.groups]

    def act(
        carry: tuple[()], obs: tuple[jax.Array, ...], key: jax.Array
    ) -> tuple[tuple[()], tuple[jax.Array, ...]]:
        del key
        return carry, tuple(jnp.zeros((len(seen), *size)) for seen, size in zip(obs, sizes, strict=True))

    return Policy(initial_carry=lambda worlds: (), act=act)


def play_client(cell: Resolved, driver: CellDriver, engine: str) -> CellEpisodes:
    """Serve a cell's episodes, each a world with a port of its own, until all are over.

    Args:
        cell: The cell.
        driver: Start of clients, and speed of the clock.
        engine: The physics engine.

    Raises:
        UsageError: A client does not come, or goes before its episode is over; the task's score counts mail,
            which clients' robots do not send.
    """
    if isinstance(cell.task, GoalTeam):
        raise UsageError(
            f"a client's robots send no mail, which the score of {cell.settings['task']} counts; "
            "benchmarks/team_over_tcp.py plays it"
        )
    begun, seed = time.perf_counter(), int(cell.settings["seed"])
    # Here arenas are no data: the worlds are built with them.
    task = cell.task if cell.arenas is None else replace(cell.task, arena=cell.arenas)
    env = build_env(task, cell.episodes, name=cell.settings["task"], engine=engine, seed=seed)
    shared = _Served(env, seed)
    worlds = [PolicyWorld(shared, number) for number in range(cell.episodes)]
    with bound_ports(HOST, count_up({"--port": 0}, cell.episodes)) as bound:
        servers = [
            BotServer(world, BotServerSettings(HOST), [], own["--port"], f"episode {number}")
            for number, (world, own) in enumerate(zip(worlds, bound, strict=True))
        ]
        ports = [int(own["--port"].getsockname()[1]) for own in bound]
        # Before the clients come, whose first answers would otherwise wait for compilation.
        for world in worlds:
            world.warm_up()
        # The server prints its addresses, and the output is for results.
        with contextlib.redirect_stdout(sys.stderr):
            asyncio.run(_serve(servers, shared, driver, ports))
    return CellEpisodes(
        scores=shared.scores,
        steps=shared.lengths,
        bad=np.zeros(cell.episodes, bool),
        seconds=time.perf_counter() - begun,
    )


async def _serve(
    servers: Sequence[BotServer], shared: _Served, driver: CellDriver, ports: Sequence[int]
) -> None:
    """Serve until the episodes are over."""
    clock = StepClock(driver.speed)
    # `_until_over` lets it go on when all clients are there.
    clock.pause(True)
    loop = ServerLoop(servers, clock)
    running = asyncio.ensure_future(loop.run())
    try:
        while not loop.listening and not running.done():
            await asyncio.sleep(POLL)
        with _started(driver.command or "", ports) as clients:
            await _until_over(servers, shared, clock, clients)
    finally:
        loop.stop()
        # A failure that has ended the loop is raised here.
        await running


async def _until_over(
    servers: Sequence[BotServer],
    shared: _Served,
    clock: StepClock,
    clients: Sequence[subprocess.Popen[bytes]],
) -> None:
    since = time.monotonic()
    while not shared.over:
        for number, client in enumerate(clients):
            code = client.poll()
            if code is not None and np.isnan(shared.scores[number]):
                raise UsageError(f"the client of episode {number} ended too early, with {code}")
        if clock.paused and all(server.world.robots for server in servers):
            clock.pause(False)
        if clock.paused and time.monotonic() - since > PATIENCE:
            raise UsageError(f"a client took over no robot within {PATIENCE:g} s")
        await asyncio.sleep(POLL)


@contextlib.contextmanager
def _started(command: str, ports: Sequence[int]) -> Generator[list[subprocess.Popen[bytes]]]:
    """Start a client for each port; in the end those are ended that have not."""
    clients: list[subprocess.Popen[bytes]] = []
    guard, before = None, children()
    try:
        for number, port in enumerate(ports):
            words = [
                word.replace("{port}", str(port)).replace("{episode}", str(number))
                for word in shlex.split(command)
            ]
            told = {**os.environ, PORT: str(port), NUMBER: str(number)}
            try:
                # The output is for results, and clients must not write between them.
                clients.append(subprocess.Popen(words, env=told, stdout=subprocess.DEVNULL))
            except OSError as error:
                reason = error.strerror or error
                raise UsageError(f"client {command!r} cannot be started: {reason}") from error
        # Only the clients: earlier children have owners of their own.
        guard = end_with_this_process(children() - before)
        yield clients
    finally:
        # All first, so that the waits do not add up.
        for client in clients:
            client.terminate()
        for client in clients:
            try:
                client.wait(5.0)
            except subprocess.TimeoutExpired:
                client.kill()
                client.wait()
        if guard is not None:
            guard.kill()
            guard.wait()
