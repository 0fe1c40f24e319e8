"""A day of simulated time, and beside the old world a fresh one in the same state.

A robot drives, stops, and drives back all day, and its sensors are read whenever they are due. Then a world
that has just begun, whose clock shows minutes, gets the old world's state: from there both must read the same
bits.
`python -m benchmarks.days --help` lists the options; the exit status is 1 if anything differs.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.tools import append_record, record_header, spread_of
from usarmjx.engines.planar.responses import find_response, override_response
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots.pioneer import ENCODER_AXIS, P2DX
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.robot import Mount, RobotSpec, manual_keys
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.base import NOISE_SETTINGS, SENSORS
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.scene import build_scene

HOUR = 3600.0
KINDS = ("IMU", "INS", "Odometry", "Encoder", "GroundTruth", "Sonar", "Battery")
LIFE = 1e6
"""Life of the battery: it must last for days [s]."""
SPEEDS = ((3.0, 3.0), (0.0, 0.0), (-2.0, 2.0), (0.0, 0.0), (-3.0, -3.0), (0.0, 0.0), (2.0, -2.0), (0.0, 0.0))
"""Speeds of the left and right wheels, one after the other, over and over [rad/s]."""
HELD = 2.0
"""Time for which each of them holds [s]."""
CLOCKS = frozenset({"step", "battery_start", "due"})
"""Arrays of a world that hold numbers of control steps."""
YOUNG = 10
"""Cycles of commands on the clock of the fresh world."""
WALL = Shape(kind="box", size=(0.1, 4.0, 1.0), at=(3.0, 0.0, 1.0), surface="wall")
YARD = ArenaSpec(
    name="yard", starts=(StartPose(tag="S", at=(0.0, 0.0, 0.188)),), extent=((-4, 4), (-4, 4)), shapes=(WALL,)
)


def silent(kind: str) -> Mount:
    """Return a sensor of the P2DX without random errors, which depend on the number of the control step."""
    known = manual_keys(SENSORS.get(kind).settings_class)
    wheel = kind == "Encoder"
    return Mount(
        kind=kind,
        name=kind,
        parent=P2DX.wheels[0].name if wheel else "HARD",
        at=(0.1, 0.0, -0.1),
        direction=ENCODER_AXIS if wheel else (0.0, 0.0, 0.0),
        options=tuple((key, 0.0) for name, key in known.items() if name in NOISE_SETTINGS),
    )


def _robot() -> RobotSpec:
    made = replace(P2DX, cameras=(), sensors=tuple(map(silent, KINDS)), battery_life=LIFE)
    response = find_response(P2DX)
    assert response is not None  # the package has it
    override_response(made, response)
    return made


@dataclass
class Day:
    """A world that is driven around.

    Args:
        engine: Its name.
        physics: Settings of the physics.
    """

    engine: str
    physics: Physics

    def __post_init__(self) -> None:
        """Build the world and compile what a cycle of commands needs."""
        self.batch = Batch(build_scene(YARD, [_robot()], self.physics), worlds=1, engine=self.engine)
        self.hold = round(HELD / self.physics.period)
        self._speeds = jnp.asarray(SPEEDS, jnp.float32)
        self._cycle: Callable[[BatchState], BatchState] = self._python_cycle
        if self.batch.engine.traceable:
            self._cycle = jax.jit(self._traced_cycle)

    @property
    def steps(self) -> int:
        """Control steps of a cycle."""
        return self.hold * len(SPEEDS)

    def _commanded(self, state: BatchState, number: Any) -> BatchState:  # noqa: ANN401 - int or traced
        left, right = self._speeds[number]
        return self.batch.drive(state, 0, {"Left": left, "Right": right})

    def _step(self, state: BatchState) -> tuple[BatchState, Any]:
        return self.batch.observe(self.batch.step(state))

    def _traced_cycle(self, state: BatchState) -> BatchState:
        def hold(number: Any, state: BatchState) -> BatchState:  # noqa: ANN401
            state = self._commanded(state, number)
            return jax.lax.fori_loop(0, self.hold, lambda _, s: self._step(s)[0], state)

        return jax.lax.fori_loop(0, len(SPEEDS), hold, state)

    def _python_cycle(self, state: BatchState) -> BatchState:
        for number in range(len(SPEEDS)):
            state = self._commanded(state, number)
            for _ in range(self.hold):
                state, _ = self._step(state)
        return state

    def run(self, state: BatchState, cycles: int, say: Callable[[str], None]) -> tuple[BatchState, float]:
        """Return the world after some cycles of commands, and the time that they took [s]."""
        began = last = time.perf_counter()
        for number in range(cycles):
            state = self._cycle(state)
            if (now := time.perf_counter()) - last > 30:
                jax.block_until_ready(state.worlds.step)
                rate = (number + 1) * self.steps * self.physics.period / (now - began)
                say(f"{(number + 1) * self.steps * self.physics.period / HOUR:.2f} h, {rate:.0f} x real time")
                last = now
        jax.block_until_ready(state.worlds.step)
        return state, time.perf_counter() - began

    def readings(self, state: BatchState) -> list[Any]:
        """Return the poses and all readings in a cycle of commands."""
        found = []
        for number in range(len(SPEEDS)):
            state = self._commanded(state, number)
            for _ in range(self.hold):
                state, now = self._step(state)
                physics = self.batch.physics(state)
                found.append(jax.device_get((physics.qpos, physics.qvel, now)))
        return found


def set_back(worlds: Any, steps: int) -> tuple[Any, list[str]]:  # noqa: ANN401 - a PyTree
    """Return worlds whose clocks show earlier control steps, and the names of these clocks."""
    leaves, form = jax.tree_util.tree_flatten_with_path(worlds)
    found, made = [], []
    for path, leaf in leaves:
        name = getattr(path[-1], "name", "")
        if name in CLOCKS:
            found.append(jax.tree_util.keystr(path))
            leaf = leaf - np.asarray(steps, leaf.dtype)
        made.append(leaf)
    return jax.tree_util.tree_unflatten(form, made), found


def differences(one: Sequence[Any], other: Sequence[Any]) -> list[str]:
    """Return where two runs' readings differ in any bit."""
    found = []
    for step, (a, b) in enumerate(zip(one, other, strict=True)):
        pairs = zip(
            jax.tree_util.tree_leaves_with_path(a), jax.tree_util.tree_leaves_with_path(b), strict=True
        )
        for (path, x), (_, y) in pairs:
            if np.asarray(x).tobytes() != np.asarray(y).tobytes():
                found.append(f"step {step}: {jax.tree_util.keystr(path)}")
    return found


def compare(day: Day, old: BatchState, fresh: BatchState) -> dict[str, Any]:
    """Give a fresh world the state of an old one, and compare what both read in the next cycle of commands.

    Args:
        day: The worlds.
        old: After a whole number of cycles.
        fresh: After a reset.

    Returns:
        Entries of a record: steps on both clocks, the clocks by name, readings compared, and what differs.
    """
    age = int(np.asarray(old.worlds.step)[0])
    worlds, clocks = set_back(old.worlds, age - YOUNG * day.steps)
    young = fresh.replace(physics=old.physics, worlds=worlds)
    first, second = day.readings(old), day.readings(young)
    news = {
        kind: sum(int(np.asarray(one[2][0][i].fresh).sum()) for one in first) for i, kind in enumerate(KINDS)
    }
    return {
        "old_step": age,
        "fresh_step": int(np.asarray(young.worlds.step)[0]),
        "clocks": clocks,
        "measurements": news,
        "way_m": float(np.ptp(np.array([one[0][0, 0] for one in first]))),
        "differ": differences(first, second),
    }


def measure(engine: str, physics: Physics, hours: float, say: Callable[[str], None]) -> dict[str, Any]:
    """Simulate hours on an engine and return the record's entries."""
    day = Day(engine, physics)
    cycles = max(1, round(hours * HOUR / (day.steps * physics.period)))
    state, first = day.run(day.batch.reset(0), 1, say)
    state, took = day.run(state, cycles, say)
    simulated = cycles * day.steps * physics.period
    found = compare(day, state, day.batch.reset(0))
    rate = spread_of("simulated s/s", [simulated / took])
    return {
        "case": {
            "engine": engine,
            "hours": simulated / HOUR,
            "timestep": physics.timestep,
            "substeps": physics.substeps,
            "robot": "P2DX",
            "sensors": list(KINDS),
        },
        "scene": None,
        "rates": {"world": rate | {"compile_s": first}},
        "baselines": {"fresh": {"what": "a world that has just begun, in the same state"}},
        **found,
    }


def main(argv: Sequence[str]) -> int:
    """Simulate, compare, and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.days", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--engine", default="planar", help="c, planar, jax or warp")
    parser.add_argument("--hours", type=float, default=24.0, help="simulated time [h]")
    parser.add_argument("--timestep", type=float, default=0.05, help="of the physics [s]")
    parser.add_argument("--substeps", type=int, default=1, help="physics steps per control step")
    parser.add_argument("--json", type=Path, help="append the record to this file")
    parser.add_argument("--note", default="", help="remark in the record")
    options = parser.parse_args(argv)
    physics = replace(Physics(), timestep=options.timestep, substeps=options.substeps)
    header = record_header("days", host=options.engine == "c", note=options.note)
    record = {**header, **measure(options.engine, physics, options.hours, lambda s: print(s, flush=True))}
    append_record(record, options.json)
    rate = record["rates"]["world"]["rate"]
    print(
        f"{options.engine}: {record['case']['hours']:.2f} h simulated, {rate:.0f} x real time; "
        f"clocks {record['old_step']} and {record['fresh_step']}, measurements {record['measurements']}, "
        f"way {record['way_m']:.2f} m; {len(record['differ'])} differences {record['differ'][:3]}"
    )
    return int(bool(record["differ"]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
