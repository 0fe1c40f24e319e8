"""Speed of a step: bare physics and the whole step of the same model, in one run.

Bare is the engine alone under constant inputs (MJX's step mapped over the worlds, or `mj_step`); the
whole step adds random commands, control, bookkeeping, all sensors that are due, and resets of some worlds.
Rates count robots times physics steps. The share of the sensors is from the same step without them.
"""

import statistics
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from heapq import nlargest
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np

from benchmarks.baselines import MJX, baseline_lines, physics_baselines
from benchmarks.cases import AllBaselineOptions, BaselineOptions, StepCase
from benchmarks.scenes import (
    RESET_SHARE,
    SceneFigures,
    bare_step,
    batch_of,
    repeat_loop,
    resolved,
    scene_of,
    start_qpos,
    whole_step,
)
from benchmarks.tools import rate_of, run_case, time_repeats
from usarmjx.base.errors import EngineError
from usarmjx.engines.c.batch import c_model
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.scene import Scene

TOP = 25
"""Kernels that are told, those that take longest."""
NANOSECONDS = 1e6
"""In a millisecond."""
Span = tuple[str, float, float]
"""A name, when it began and how long it took [ns]."""


def profile_kernels(run: Callable[[Any], Any], state: Any) -> dict[str, Any]:  # noqa: ANN401
    """Call a function once more under the profiler, and return what ran for how long.

    On a GPU these are kernels and copies, on a CPU XLA's operations without those within them. Parts that
    Warp launches as a CUDA graph are listed kernel by kernel.

    Args:
        run: Earlier measurements, so that nothing is compiled now.
        state: Its arguments.

    Returns:
        All `calls` and their `ms`, the `span_ms` from the first's begin to the last's end, and the `top`:
        names with calls, ms and share of all.

    Raises:
        EngineError: The profiler saw nothing.
    """
    options = jax.profiler.ProfileOptions()
    options.python_tracer_level = 0
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder, profiler_options=options):
            jax.block_until_ready(run(state))
        files = list(Path(folder).rglob("*.xplane.pb"))
        if not files:
            raise EngineError("JAX's profiler left no trace")
        lines = [list(line) for line in _device_lines(str(files[0]))]
    return count_kernels(lines, nested=jax.default_backend() == "cpu")


def _device_lines(file: str) -> Iterator[Iterator[Span]]:
    """Yield the spans of each stream of a GPU; where there is none, XLA's of each thread of the CPU."""
    planes = list(jax.profiler.ProfileData.from_file(file).planes)
    on_gpu = [plane for plane in planes if "GPU" in plane.name]
    for plane in on_gpu or planes:
        for line in plane.lines:
            if not on_gpu or "Stream" in line.name:
                yield (
                    (event.name, event.start_ns, event.duration_ns)
                    for event in line.events
                    if on_gpu or "hlo_op" in dict(event.stats)
                )


def count_kernels(lines: Iterable[Iterable[Span]], nested: bool = True) -> dict[str, Any]:
    """Return what `profile_kernels` does, of the spans of each stream or thread.

    Args:
        lines: The spans.
        nested: Whether one within another is a part of it; kernels of a GPU that run at the same time are
            branches of a CUDA graph, each with a time of its own.

    Raises:
        EngineError: There are no spans.
    """
    took: defaultdict[str, float] = defaultdict(float)
    calls: Counter[str] = Counter()
    begin, end = float("inf"), 0.0
    for spans in lines:
        around: list[Span] = []
        for span in sorted(spans, key=lambda span: (span[1], -span[2])):
            name, start, duration = span
            while around and around[-1][1] + around[-1][2] <= start:
                around.pop()
            if around and nested:
                took[around[-1][0]] -= duration
            around.append(span)
            took[name] += duration
            calls[name] += 1
            begin, end = min(begin, start), max(end, start + duration)
    longest, total = nlargest(TOP, took, took.__getitem__), sum(took.values())
    if not total:
        raise EngineError("JAX's profiler saw no kernel")
    return {
        "calls": sum(calls.values()),
        "ms": total / NANOSECONDS,
        "span_ms": (end - begin) / NANOSECONDS,
        "top": [
            {"name": name, "calls": calls[name], "ms": took[name] / NANOSECONDS, "share": took[name] / total}
            for name in longest
        ],
    }


def kernel_lines(kernels: dict[str, Any]) -> list[str]:
    """Return the lines of a table for people."""
    head = f"{kernels['calls']:,} kernels took {kernels['ms']:,.1f} ms of {kernels['span_ms']:,.1f} ms:"
    rows = (
        f"{one['ms']:10.2f} ms {one['share']:6.1%} {one['calls']:8,} x {one['name'][:90]}"
        for one in kernels["top"]
    )
    return [head, *rows]


BASELINE_STEPS = 400
RATE = "robot-steps/s"
USUAL_GRAPH = "step"
ALL = AllBaselineOptions()


def _one_core(scene: Scene, speeds: np.ndarray) -> float:
    """Robot-steps per second of plain `mj_step` on one CPU core, one world."""
    model = c_model(scene.model)
    data = mujoco.MjData(model)
    data.qpos[:] = start_qpos(scene)
    data.ctrl[: speeds.size] = speeds
    mujoco.mj_step(model, data, nstep=BASELINE_STEPS // 4)
    began = time.perf_counter()
    mujoco.mj_step(model, data, nstep=BASELINE_STEPS)
    return BASELINE_STEPS * scene.num_robots / (time.perf_counter() - began)


def in_the_step(*, radio: bool) -> str:
    """Return what a whole step does."""
    return (
        "contacts, random commands, control, all sensors of the robots when due, "
        f"resets of {RESET_SHARE:.0%} of worlds every control step; "
        + ("all links of the radio every control step, no rendering" if radio else "no radio, no rendering")
    )


def measure_step(case: StepCase, options: BaselineOptions = ALL) -> str:
    """Measure a case, append its record, and return a summary for people.

    Raises:
        EngineError: A contact buffer overflowed, so the figures would be wrong.
    """
    host = resolved(case)["engine"] == "c"
    return run_case("step", options, lambda: _measure(case, options.baselines), _summary, host=host)


def _measure(case: StepCase, baselines: str) -> dict[str, Any]:
    """Return the record of a case, without its header."""
    engine = resolved(case)["engine"]
    scene = scene_of(case)
    batch = batch_of(case, scene)
    if case.graph != USUAL_GRAPH:
        batch.engine.select_graphs(case.graph)
    rates, state, seen, kernels = _rates(case, batch)
    bare, whole, blind = (rates[name] for name in ("bare", "whole", "blind"))
    rays = sum(len(group.slots) * sum(group.suite.ray_counts) for group in scene.groups)
    record = {
        "case": {**case.as_record(), **resolved(case, batch)},
        "robots_per_world": scene.num_robots,
        "arena_geoms": len(scene.fixed_geoms.kind) + len(scene.moved_geom_table.kind),
        "loose_objects": len(scene.arena.loose),
        "timestep": scene.physics.timestep,
        "in_the_step": in_the_step(radio=case.radio),
        "rays_when_all_are_due": rays * case.worlds,
        "scene": seen.result(state),
        "rates": rates,
        "baselines": physics_baselines(
            scene,
            case.worlds,
            case.steps,
            case.repeats,
            baselines,
            {**bare, "engine": engine} if engine in MJX else None,
        ),
        "bare_robot_steps_per_s": bare["rate"],
        "robot_steps_per_s": whole["rate"],
        "robots_in_real_time": whole["rate"] * scene.physics.timestep,
        "whole_to_bare": whole["rate"] / bare["rate"],
        "sensors": {
            group.robot.name: [sensor.kind for sensor in group.suite.sensors] for group in scene.groups
        },
        "sensors_share": 1 - statistics.median(blind["times_s"]) / statistics.median(whole["times_s"]),
        "bare_times_s": bare["times_s"],
        "whole_times_s": whole["times_s"],
        "blind_times_s": blind["times_s"],
        "compile_s": {"bare": bare["compile_s"], "whole": whole["compile_s"]},
        "cpu_mujoco_robot_steps_per_s": _one_core(scene, np.full(scene.model.nu, 1.0)),
        "faults": jax.tree.map(lambda count: int(count.sum()), vars(state.worlds.faults)),
    }
    if kernels is not None:
        record["kernels"] = kernels
    return record


def _rates(
    case: StepCase, batch: Batch
) -> tuple[dict[str, Any], BatchState, SceneFigures, dict[str, Any] | None]:
    """Return the rates of the bare, the whole and the blind step, the last state, what was met, kernels."""
    key, seen = jax.random.key(case.seed + 1), SceneFigures(batch)
    state = batch.reset()
    work = case.worlds * batch.scene.num_robots * batch.scene.physics.substeps * case.steps
    run = partial(time_repeats, repeats=case.repeats)
    body, given = bare_step(batch, key, state)
    bare = run(repeat_loop(batch, body, case.steps, given), state.physics)
    whole_loop = repeat_loop(batch, whole_step(batch, key), case.steps)
    whole = run(whole_loop, state, look=seen.look)
    kernels = profile_kernels(whole_loop, whole[2]) if case.profile else None
    blind = run(repeat_loop(batch, whole_step(batch, key, sensing=False), case.steps), whole[2])
    batch.check_overflow(blind[2])
    found = {"bare": bare, "whole": whole, "blind": blind}
    rates = {name: rate_of(RATE, work, first, times) for name, (first, times, _) in found.items()}
    return rates, blind[2], seen, kernels


def _summary(record: dict[str, Any]) -> str:
    case = record["case"]
    return "\n".join(
        [
            f"{case['worlds']} worlds x {case['roster']}, engine {case['engine']} on {record['device']}",
            f"bare physics  {record['bare_robot_steps_per_s']:12,.0f} robot-steps/s",
            f"whole step    {record['robot_steps_per_s']:12,.0f} robot-steps/s  ({record['in_the_step']})",
            f"in real time  {record['robots_in_real_time']:12,.0f} robots",
            f"ratio         {record['whole_to_bare']:12.2f}",
            f"sensors       {record['sensors_share']:12.1%} of the whole step",
            f"mj_step       {record['cpu_mujoco_robot_steps_per_s']:12,.0f} robot-steps/s, bare, one core",
            *baseline_lines(record),
            f"compile [s]   bare {record['compile_s']['bare']:.1f}, whole {record['compile_s']['whole']:.1f}",
            f"faults        {record['faults']}",
            *(kernel_lines(record["kernels"]) if "kernels" in record else ()),
        ]
    )
