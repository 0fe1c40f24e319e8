"""How much memory worlds take: their state, by part, and what a compiled step needs beside it."""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.baselines import check_word, physics_baselines
from benchmarks.scenes import SceneCase, sizes, whole_step
from benchmarks.tools import append_record, record_header
from usarmjx.sim.batch import BatchState

KILOBYTE = 1024
"""Unit of the system's count of a process's memory [bytes]."""
BASELINE_REPEATS = 2


@dataclass(frozen=True, kw_only=True)
class MemoryCase:
    """What to measure.

    Attributes:
        scene: Worlds, of which the number is replaced.
        counts: Numbers of worlds.
        compile: Whether a step is compiled, to see what it needs; engines that are traced only.
    """

    scene: SceneCase
    counts: tuple[int, ...] = (1, 16)
    compile: bool = True


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
    batch = case.batch(case.scene())
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


def measure_memory(case: MemoryCase, file: Path | None = None, note: str = "", baselines: str = "cpu") -> str:
    """Run a case, append its record to `file` as a JSON line, and return a summary for people.

    Args:
        case: What to measure.
        file: Of records.
        note: What a reader of the record must know.
        baselines: What is measured of the scene's physics beside it, of `baselines.WORDS`.
    """
    check_word(baselines)
    resolved = case.scene.resolved()
    header = record_header("memory", host=resolved["engine"] == "c", note=note)
    rows = [
        _measure_one(replace(case.scene, worlds=count), compile_it=case.compile)
        for count in sorted(case.counts)
    ]
    scene = case.scene.scene()
    record = {
        **header,
        "case": {**asdict(case.scene), **resolved, "worlds": sorted(case.counts), "compile": case.compile},
        "in_the_step": "commands, control, physics, sensors when due, resets: compiled as one function",
        "scene": sizes(scene),
        "rates": {},
        "baselines": physics_baselines(scene, max(case.counts), 2, BASELINE_REPEATS, baselines),
        "rows": rows,
        "bytes_per_world": bytes_per_world(rows),
    }
    append_record(record, file)
    return _summary(record)


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
