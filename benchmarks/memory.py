"""Memory of worlds: their state, by part, and what a compiled step needs beside it."""

import sys
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from benchmarks.baselines import physics_baselines
from benchmarks.cases import BaselineOptions, MemoryCase, SceneCase
from benchmarks.scenes import batch_of, resolved, scene_of, sizes, whole_step
from benchmarks.tools import run_case
from usarmjx.sim.batch import BatchState

KILOBYTE = 1024
"""Unit of the system's count of a process's memory [bytes]."""
BASELINE_REPEATS = 2
USUAL = BaselineOptions()


def size_of(tree: Any) -> int:  # noqa: ANN401 - any PyTree
    """Return the bytes of a tree's arrays."""
    return sum(
        int(np.prod(leaf.shape)) * leaf.dtype.itemsize
        for leaf in jax.tree.leaves(tree)
        if hasattr(leaf, "dtype")
    )


def parts_of(state: BatchState) -> dict[str, int]:
    """Return the bytes of the parts of a batch's state."""
    worlds = state.worlds
    named = {
        "physics": state.physics,
        "sensors' memory": [group.memory for group in worlds.groups],
        "commands": [(group.command, group.command_history) for group in worlds.groups],
        "radio": (worlds.links, worlds.mail),
        "arenas": (worlds.arena_state, state.arenas),
    }
    found = {name: size_of(part) for name, part in named.items()}
    return {**found, "other": size_of(state) - sum(found.values())}


def _compiled(step: Any, state: BatchState) -> dict[str, int] | None:  # noqa: ANN401 - a traced function
    """Return what a compiled step needs, as XLA says [bytes]; None where it does not say."""
    needs = jax.jit(step).lower(jax.numpy.int32(0), state).compile().memory_analysis()
    if needs is None:
        return None
    names = ("temp", "argument", "output", "generated_code")
    return {f"{name}_bytes": int(getattr(needs, f"{name}_size_in_bytes")) for name in names}


def _host_peak() -> int | None:
    """Return the most memory that this process has had [bytes]; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    import resource

    return KILOBYTE * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _measure_one(case: SceneCase, *, compile_it: bool) -> dict[str, Any]:
    batch = batch_of(case, scene_of(case))
    state = jax.block_until_ready(batch.reset())
    parts = parts_of(state)
    step = whole_step(batch, jax.random.key(0))
    told = jax.devices()[0].memory_stats() if jax.devices()[0].platform != "cpu" else None
    return {
        "worlds": case.worlds,
        "state_bytes": sum(parts.values()),
        "parts": parts,
        "compiled": _compiled(step, state) if compile_it and batch.engine.traceable else None,
        "device_peak_bytes": None if told is None else told.get("peak_bytes_in_use"),
        "host_peak_bytes": _host_peak(),
    }


def measure_memory(case: MemoryCase, options: BaselineOptions = USUAL) -> str:
    """Measure a case, append its record, and return a summary for people; baselines are of the physics."""
    host = resolved(case)["engine"] == "c"
    return run_case("memory", options, lambda: _measure(case, options.baselines), _summary, host=host)


def _measure(case: MemoryCase, baselines: str) -> dict[str, Any]:
    """Return the record of a case, without its header."""
    counts = sorted(case.counts)
    rows = [_measure_one(case.scene_case(count), compile_it=case.compile) for count in counts]
    scene, recorded = scene_of(case), case.scene_case(1).as_record()
    return {
        "case": {**recorded, **resolved(case), "worlds": counts, "compile": case.compile},
        "in_the_step": "commands, control, physics, sensors when due, resets: compiled as one function",
        "scene": sizes(scene),
        "rates": {},
        "baselines": physics_baselines(scene, counts[-1], 2, BASELINE_REPEATS, baselines),
        "rows": rows,
        "bytes_per_world": bytes_per_world(rows),
    }


def bytes_per_world(rows: Sequence[dict[str, Any]]) -> float:
    """Return what another world adds to the state; of a single number of worlds, their share."""
    first, last = rows[0], rows[-1]
    if first["worlds"] == last["worlds"]:
        return last["state_bytes"] / last["worlds"]
    return (last["state_bytes"] - first["state_bytes"]) / (last["worlds"] - first["worlds"])


def _summary(record: dict[str, Any]) -> str:
    case = record["case"]
    lines = [f"{case['roster']} in {case['arena']}, engine {case['engine']} on {record['device']}"]
    for row in record["rows"]:
        parts = ", ".join(f"{name} {size:,}" for name, size in row["parts"].items() if size)
        needs = row["compiled"]
        temp = "" if needs is None else f"; a step needs {needs['temp_bytes']:,} more"
        lines.append(f"{row['worlds']:6} worlds  {row['state_bytes']:14,} bytes ({parts}){temp}")
    lines.append(f"a world more  {record['bytes_per_world']:14,.0f} bytes")
    return "\n".join(lines)
