"""Scores of a team that a client drives over TCP, in buildings of a split: `examples/team_client.py`.

    python -m benchmarks.team_over_tcp explore-v3 baseline packaged --split validation --worlds 12 --engine c

A server in this process serves each building at ports of its own. Its clock stands while clients compute,
so that no score depends on the load of the machine. The score is that of the task for the map of the client's
base; the server counts contacts. The wireless server has the task's radio.
"""

import argparse
import asyncio
import contextlib
import importlib.util
import json
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from usarmjx.base.estimates import estimate_groups
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.loop_meter import run_metered
from usarmjx.server.network.ports import bound_ports, count_up
from usarmjx.server.runtime.loop import ServerLoop, StepClock
from usarmjx.server.wireless.net import WirelessSettings, make_wireless
from usarmjx.server.worlds.policy_world import PolicyBatch, PolicyWorld
from usarmjx.train.evaluation.yardsticks import task_to_play
from usarmjx.train.make import build_env
from usarmjx.train.mapping.maps import FREE
from usarmjx.train.policies.sources import zero_policy
from usarmjx.train.tasks import ExploreBase, TeamMind

Ports = tuple[int, int]
HOST = "127.0.0.1"
PORTS = {"--port": 0, "--wss-port": 0, "--wss2-port": 0, "--position-port": 0}
CLIENT = Path(__file__).parents[1] / "examples/team_client.py"
WAIT = 0.001
"""Interval of looks at sockets while the clock stands [s]."""


class GivenSteps(StepClock):
    """A clock that makes as many control steps as it is given, at once."""

    def __init__(self) -> None:
        super().__init__(0.0)
        self._left, self._done = 0, threading.Event()

    def give(self, steps: int) -> None:
        """Let the worlds make some control steps, and wait until they have."""
        self._done.clear()
        self._left = steps
        self._done.wait()

    def takes_step(self) -> bool:
        """Take one of those that are left."""
        taken = self._left > 0
        self._left -= taken
        return taken

    async def sleep(self, period: float) -> None:
        """Let sockets have their turn."""
        del period
        if not self._left:
            self._done.set()
        await asyncio.sleep(0.0 if self._left else WAIT)


@contextlib.contextmanager
def served(shared: PolicyBatch, count: int) -> Iterator[tuple[GivenSteps, list[Ports]]]:
    """Serve worlds of a batch; give the clock, and the ports of robots and of the radio of each."""
    radio, clock = shared.env.scene.radio, GivenSteps()
    assert radio is not None  # as the task has one
    with bound_ports(HOST, count_up(PORTS, count)) as bound:
        servers, worlds = list[BotServer](), [PolicyWorld(shared, number) for number in range(count)]
        for number, (world, own) in enumerate(zip(worlds, bound, strict=True)):
            names = {name: own[f"--{name}-port"] for name in ("wss", "wss2", "position")}
            wss, wss2, position = (int(one.getsockname()[1]) for one in names.values())
            service = make_wireless(world, radio, WirelessSettings(HOST, wss, wss2, position), names)
            servers.append(BotServer(world, BotServerSettings(HOST), [service], own["--port"], str(number)))
            world.warm_up()
        ports = [tuple(int(own[name].getsockname()[1]) for name in ("--port", "--wss-port")) for own in bound]
        loop = ServerLoop(servers, clock)

        def run() -> None:
            with contextlib.redirect_stdout(sys.stderr):
                run_metered(loop.run())

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        while not loop.listening:
            time.sleep(WAIT)
        try:
            yield clock, [(one[0], one[1]) for one in ports]
        finally:
            loop.stop()
            thread.join(10.0)


def client_module() -> ModuleType:
    """Import the example."""
    spec = importlib.util.spec_from_file_location("team_client", CLIENT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def play(task: ExploreBase, name: str, policy: str, worlds: int, engine: str) -> dict[str, Any]:
    """Return the scores of a policy over TCP, and their parts, by world."""
    client = client_module()
    env = build_env(task, worlds, name=name, engine=engine, seed=0)
    shared = PolicyBatch(env, zero_policy(env))
    mind, choose = TeamMind(task, env.scene.arena.extent), client.chooser(policy, name, task)
    steps, worth = task.episode_steps, task.worth_of_steps()
    with served(shared, worlds) as (clock, ports):
        clock.give(task.repeat - shared.steps)  # reports come right after readings
        teams = [client.TeamClient(mind.another(), choose, own) for own in ports]
        had = [np.zeros(0, bool)] * worlds
        mapped, points = np.zeros(worlds), np.zeros(worlds)
        contacts = np.zeros(worlds)
        try:
            for step in range(1, steps):  # the first has passed
                clock.give(task.repeat)
                for world, team in enumerate(teams):
                    if not team.act():
                        continue
                    memory = shared.task_memory(world)
                    there = np.asarray(memory.reachable)
                    has = there & (team.mind.squares[0] == FREE)
                    if not len(had[world]):
                        had[world] = has
                    share = (has & ~had[world]).sum() / there.sum()
                    had[world] |= has
                    mapped[world] += share
                    points[world] += 100.0 * share * worth[step]
                    contacts[world] = max(contacts[world], float(memory.contacts))
        finally:
            for team in teams:
                team.close()
    return {"mapped": mapped, "points": points, "contacts": contacts, "score": points - task.price * contacts}


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Return a line for each policy."""
    lines = ["| team | score | 95 % interval | mapped | contacts |", "|---|---|---|---|---|"]
    for name, row in rows.items():
        score = estimate_groups(np.asarray(row["score"]))
        points, price = np.mean(row["points"]), np.mean(row["score"]) - np.mean(row["points"])
        interval = f"{score.low:.1f} to {score.high:.1f}"
        lines.append(f"| {name} | {score.value:.1f} | {interval} | {points:.1f} | {price:.1f} |")
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Score teams that clients drive over TCP.")
    parser.add_argument("task", help="explore-v3")
    parser.add_argument("policies", nargs="+", help="as --policy of examples/team_client.py")
    parser.add_argument("--split", default="validation")
    parser.add_argument("--worlds", type=int, default=12)
    parser.add_argument("--engine", default="c")
    parser.add_argument("--steps", type=int, help="of an episode; else the task's")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(words)
    changes = {} if options.steps is None else {"episode_steps": options.steps}
    task, worlds = task_to_play(options.task, options.worlds, options.split, **changes)
    if not isinstance(task, ExploreBase):
        parser.error(f"only explore-v3 has a score that the base's map gives, not {options.task}")
    rows = {name: play(task, options.task, name, worlds, options.engine) for name in options.policies}
    print(table(rows))
    if options.json:
        kept = {name: {key: value.tolist() for key, value in row.items()} for name, row in rows.items()}
        options.json.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
