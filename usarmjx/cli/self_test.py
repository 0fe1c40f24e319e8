"""The self-test of `usarmjx doctor`: a small batch steps on two engines, rays hit, a client gets reports."""

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from threading import Timer
from typing import TYPE_CHECKING

import numpy as np

from usarmjx.cli.checks import HOST, Check, Finding

if TYPE_CHECKING:
    from usarmjx.models.spec.arena import ArenaSpec
    from usarmjx.sim.batch import Batch, BatchState

ARENA, ROBOT, WORLDS, STEPS = "soccer", "P2AT", 2, 10
START_LIMIT, REPORT_LIMIT = 90.0, 30.0
"""How long a server may take to listen, and a robot to report [s]."""
LISTENING = re.compile(r"listening on [\d.]+:(\d+)")
REINSTALL = "`pip check` may tell which packages do not fit; install usarmjx in an environment of its own"
WALL_DISTANCE = 3.0
"""Of a wall's middle from where a robot starts [m]."""
TURNED = 0.1
"""Wheels that are driven for `STEPS` control steps have turned further than this [rad]."""


def try_c() -> Iterator[Finding]:
    """Step a batch on engine `c`, and cast rays."""
    yield from _step("c")


def try_jax() -> Iterator[Finding]:
    """Step a batch on engine `jax`."""
    yield from _step("jax")


def _step(engine: str) -> Iterator[Finding]:
    """Drive a robot in each world of a small batch, and look through its scanner."""
    from usarmjx.sim.batch import Batch
    from usarmjx.sim.scene import build_scene

    began = time.perf_counter()
    # What MJX compiles for a box against a box takes as long again as all the rest.
    room = _room() if engine == "c" else replace(_room(), shapes=())
    batch = Batch(build_scene(room, [ROBOT]), worlds=WORLDS, engine=engine)
    first = state = batch.reset()
    state = batch.drive(state, 0, {"Left": 5.0, "Right": 5.0})
    for _ in range(STEPS):
        state = batch.step(state)
    before, after = (np.asarray(batch.physics(one).qpos) for one in (first, state))
    moved = np.abs(after - before).max(-1)
    took = f"{time.perf_counter() - began:.1f} s"
    if not (np.isfinite(after).all() and (moved > TURNED).all()):
        text = f"driven wheels turned by {np.round(moved, 3).tolist()} rad"
        yield Finding(f"engine {engine}", "wrong", text, REINSTALL)
        return
    yield Finding(f"engine {engine}", "ok", f"{WORLDS} worlds made {STEPS} steps, {took} with compilation")
    if engine == "c":
        yield from _scan(batch, state)


def _room() -> "ArenaSpec":
    """Return a floor with a wall ahead of the robot, which takes little time to compile."""
    from usarmjx.models.spec.arena import ArenaSpec, StartPose
    from usarmjx.models.spec.shapes import Shape

    wall = Shape(kind="box", size=(0.1, 2.0, 0.5), at=(WALL_DISTANCE, 0.0, 0.5), surface="wall")
    start = StartPose(tag="Start", at=(0.0, 0.0, 0.2))
    return ArenaSpec(name="Room", shapes=(wall,), starts=(start,), extent=((-2.0, 4.0), (-2.0, 2.0)))


def _scan(batch: "Batch", state: "BatchState") -> Iterator[Finding]:
    """Cast the rays of a range scanner, of which the shortest ends at the wall or before."""
    _, readings = batch.observe(state)
    ranges = np.asarray(readings[0][batch.scene.groups[0].suite.index("RangeScanner")].value)
    nearest = ranges.min(-1)
    fine = bool(np.isfinite(ranges).all() and (nearest > 0).all() and (nearest < WALL_DISTANCE).all())
    text = f"{ranges.size} beams, the nearest wall {np.round(nearest, 2).tolist()} m away"
    yield Finding("rays", "ok" if fine else "wrong", text, "" if fine else REINSTALL)


def try_client() -> Iterator[Finding]:
    """Start a server, and let a client of it get a robot and its report."""
    from usarmjx.client.usarsim_client import UsarsimClient

    began = time.perf_counter()
    command = [sys.executable, "-m", "usarmjx", "serve", "--arena", ARENA, "--engine", "c", "--port", "0"]
    command += ["--host", HOST, "--no-wireless", "--no-images", "--no-view"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        watchdog = Timer(START_LIMIT, process.kill)
        watchdog.start()
        try:
            assert process.stdout is not None
            port = next((int(found[1]) for line in process.stdout if (found := LISTENING.search(line))), None)
            if port is None:
                complaint = (process.stderr.read() if process.stderr else "").strip().splitlines()
                text = f"a server does not start: {complaint[-1] if complaint else 'it says nothing'}"
                yield Finding("client", "wrong", text, "try `usarmjx serve`")
                return
            with UsarsimClient(HOST, port, timeout=REPORT_LIMIT) as client:
                _, at, turn = client.start_poses()[0]
                status = client.init(f"USARBot.{ROBOT}", "Patient", at, turn)
            took = f"{time.perf_counter() - began:.1f} s after its start"
            yield Finding("client", "ok", f"a client got its {ROBOT} and {status.kind} of it, {took}")
        finally:
            watchdog.cancel()
            process.kill()


SELF_TEST: tuple[Check, ...] = (try_c, try_jax, try_client)
