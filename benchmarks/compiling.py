"""How long one waits for the first step: imports, the scene, tracing, XLA; cold, and with a filled cache.

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
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from usarmjx.base.errors import UsageError

STAGES = ("import_s", "scene_s", "batch_s", "trace_s", "compile_s", "first_step_s")
"""In their order; `trace_s` and `compile_s` are one compiled step's, null where the engine is not traced."""


def measure_start(words: dict[str, Any]) -> dict[str, float | None]:
    """Return how long each stage to the first whole step takes in this process [s]."""
    clock, times = time.perf_counter, dict[str, float | None]()
    began = clock()
    import jax

    from benchmarks.scenes import SceneCase, whole_step

    # What compiles in a moment is cached too: else a small scene would look as if nothing were.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    times["import_s"] = clock() - began
    case, began = SceneCase(**words), clock()
    scene = case.scene()
    times["scene_s"], began = clock() - began, clock()
    batch = case.batch(scene)
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


@dataclass(frozen=True, kw_only=True)
class CompileCase:
    """What to measure: the fields of `SceneCase`, and how often.

    Attributes:
        scene: Fields of `SceneCase`.
        repeats: Pairs of processes, cold and cached.
        limit: After which a process is ended [s].
    """

    scene: dict[str, Any]
    repeats: int = 1
    limit: float = 1800.0


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


def measure_compile(
    case: CompileCase, file: Path | None = None, note: str = "", baselines: str = "cpu"
) -> str:
    """Run a case, append its record to `file` as a JSON line, and return a summary for people.

    Args:
        case: What to measure.
        file: Of records.
        note: What a reader of the record must know.
        baselines: What is measured beside it, of `baselines.WORDS`.

    Raises:
        UsageError: A process failed; says why.
    """
    from benchmarks.baselines import check_word, physics_baselines
    from benchmarks.scenes import SceneCase, sizes
    from benchmarks.tools import append_record, record_header

    check_word(baselines)
    worlds = SceneCase(**case.scene)
    resolved = worlds.resolved()
    header = record_header("compile", host=resolved["engine"] == "c", note=note)
    found: dict[str, list[dict[str, float | None]]] = {"cold": [], "cached": []}
    for _ in range(case.repeats):
        with TemporaryDirectory(prefix="usarmjx-bench-") as cache:
            for runs in found.values():
                runs.append(_in_a_process(case, cache))
    stages = {
        temperature: {stage: _spread([run[stage] for run in runs]) for stage in STAGES}
        for temperature, runs in found.items()
    }
    scene = worlds.scene()
    record = {
        **header,
        "case": {**asdict(case)["scene"], **resolved, "repeats": case.repeats},
        "in_the_step": "commands, control, physics, sensors when due, resets: compiled as one function",
        "scene": sizes(scene),
        "rates": {},
        "baselines": physics_baselines(scene, worlds.worlds, 2, case.repeats, baselines),
        "stages": stages,
    }
    append_record(record, file)
    return _summary(record)


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
