"""Wait for the first step: imports, the scene, tracing, XLA; cold, and with a filled cache.

Each is a process of its own, as a user's would be: the first with an empty folder for compilations, the
second with what the first left there.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.cases import BaselineOptions, CompileCase
from usarmjx.base.errors import UsageError

USUAL = BaselineOptions()
STAGES = ("import_s", "scene_s", "batch_s", "trace_s", "compile_s", "first_step_s")
"""In their order; `trace_s` and `compile_s` are one compiled step's, null where the engine is not traced."""


def measure_start(words: dict[str, Any]) -> dict[str, float | None]:
    """Return how long each stage to the first whole step takes in this process [s]."""
    clock, times = time.perf_counter, dict[str, float | None]()
    began = clock()
    import jax

    from benchmarks.cases import SceneCase
    from benchmarks.scenes import batch_of, scene_of, whole_step

    # What compiles in a moment is cached too: else a small scene would look as if nothing were.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    times["import_s"] = clock() - began
    case, began = SceneCase(**words), clock()
    scene = scene_of(case)
    times["scene_s"], began = clock() - began, clock()
    batch = batch_of(case, scene)
    state = jax.block_until_ready(batch.reset())
    times["batch_s"], began = clock() - began, clock()
    step = whole_step(batch, jax.random.key(0))
    times["trace_s"] = times["compile_s"] = None
    if batch.engine.traceable:
        lowered = jax.jit(step).lower(jax.numpy.int32(0), state)
        times["trace_s"], began = clock() - began, clock()
        compiled: Any = lowered.compile()
        times["compile_s"], began = clock() - began, clock()
        jax.block_until_ready(compiled(jax.numpy.int32(0), state))
    else:
        jax.block_until_ready(step(jax.numpy.int32(0), state))
    times["first_step_s"] = clock() - began
    return times


def _in_a_process(case: CompileCase, cache: str) -> dict[str, float | None]:
    settings = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache}
    command = [sys.executable, "-m", "benchmarks.compiling", json.dumps(case.scene)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, env=settings, timeout=case.limit)
    except subprocess.TimeoutExpired:
        raise UsageError(f"a process was not done after {case.limit:g} s") from None
    if done.returncode:
        raise UsageError(done.stderr.strip().splitlines()[-1])
    return json.loads(done.stdout.strip().splitlines()[-1])


def _spread(values: Sequence[float | None]) -> dict[str, Any] | None:
    """Return the median of a stage's times, and all; None where the engine has no such stage."""
    known = [value for value in values if value is not None]
    return {"median": statistics.median(known), "values": known} if known else None


def measure_compile(case: CompileCase, options: BaselineOptions = USUAL) -> str:
    """Measure a case, append its record, and return a summary for people.

    Raises:
        UsageError: A process failed; says why.
    """
    from benchmarks.scenes import resolved
    from benchmarks.tools import run_case

    host = resolved(case)["engine"] == "c"
    return run_case("compile", options, lambda: _measure(case, options.baselines), _summary, host=host)


def _measure(case: CompileCase, baselines: str) -> dict[str, Any]:
    """Return the record of a case, without its header."""
    from benchmarks.baselines import physics_baselines
    from benchmarks.scenes import resolved, scene_of, sizes

    found: dict[str, list[dict[str, float | None]]] = {"cold": [], "cached": []}
    for _ in range(case.repeats):
        with TemporaryDirectory(prefix="usarmjx-bench-") as cache:
            for runs in found.values():
                runs.append(_in_a_process(case, cache))
    stages = {
        temperature: {stage: _spread([run[stage] for run in runs]) for stage in STAGES}
        for temperature, runs in found.items()
    }
    scene = scene_of(case)
    recorded = case.as_record()
    del recorded["limit"]
    return {
        "case": {**recorded, **resolved(case)},
        "in_the_step": "commands, control, physics, sensors when due, resets: compiled as one function",
        "scene": sizes(scene),
        "rates": {},
        "baselines": physics_baselines(scene, case.worlds, 2, case.repeats, baselines),
        "stages": stages,
    }


def _summary(record: dict[str, Any]) -> str:
    case = record["case"]
    lines = [
        f"{case['worlds']} worlds x {case['roster']}, engine {case['engine']} on {record['device']}",
        f"{'':14} {'cold':>8} {'cached':>8}  [s]",
    ]
    for stage in STAGES:
        cells = [record["stages"][temperature][stage] for temperature in ("cold", "cached")]
        shown = " ".join(f"{'-' if cell is None else format(cell['median'], '.2f'):>8}" for cell in cells)
        lines.append(f"{stage.removesuffix('_s').replace('_', ' '):14} {shown}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write("\n" + json.dumps(measure_start(json.loads(sys.argv[1]))) + "\n")
