"""Cost of a sweep, as a record of benchmarks: one line of the form that `usarmjx bench` writes."""

import math
import time
from typing import Any

from benchmarks.baselines import missing
from benchmarks.tools import record_header, spread_of
from usarmjx.base.errors import UsageError
from usarmjx.sweeps.analysis import overall_rows
from usarmjx.sweeps.run import SweepPlan
from usarmjx.sweeps.spec import as_text
from usarmjx.sweeps.store import CellRecord, StoredSweep
from usarmjx.sweeps.workers import Workers

ALONE = "not run by this command: a cell is a sweep of its own by --set, with a record of its own"


class SweepMeter:
    """A sink that keeps what is played now, and when the last of it came.

    Args:
        begun: When the sweep began, on the clock of performance counters [s].
    """

    def __init__(self, begun: float) -> None:
        self._begun = begun
        self.records: list[CellRecord] = []
        self.seconds = 0.0

    def __call__(self, record: CellRecord) -> None:
        """Take a cell that is finished or has failed."""
        self.records.append(record)
        self.seconds = time.perf_counter() - self._begun


def sweep_record(
    found: StoredSweep, plan: SweepPlan, meter: SweepMeter, workers: Workers, note: str = ""
) -> dict[str, Any]:
    """Return the record of a sweep that was just played.

    Args:
        found: Contents of its folder; scores are of all of it, times of what was played now.
        plan: Episodes played together.
        meter: Episodes played now.
        workers: Workers.
        note: Remarks for readers of the record.

    Raises:
        UsageError: Nothing was played now, so there is nothing that took time.
    """
    played = [record for record in meter.records if record.failed is None]
    if not played:
        raise UsageError("no record: no cell was played to its end by this command; take another --out")
    compiling = sum(record.compile_seconds for record in played)
    work = _work_of(played)
    rates = {name: count / meter.seconds for name, count in work.items() if count}
    units = {"cells": "cells/s", "episodes": "episodes/s", "agent_steps": "agent-steps/s"}
    engines = sorted({record.engine for record in played})
    return {
        **record_header("sweep", host=engines == ["c"], note=note),
        "case": {
            "sweep": found.name,
            "tasks": list(dict.fromkeys(record.settings["task"] for record in played)),
            "engines": engines,
            "axes": list(found.axes),
            "settings": _common(played),
            "run_on": workers.place,
            "workers": workers.count,
        },
        "scene": None,
        "rates": {
            name: {**spread_of(unit, [rates[name]]), "compile_s": compiling}
            for name, unit in units.items()
            if name in rates
        },
        "baselines": {"one_by_one": missing(ALONE)},
        **work,
        "known": len(found.records) - len(meter.records),
        "failed": len(meter.records) - len(played),
        "batches": plan.batches,
        "largest_batch": max((len(batch) for group in plan.groups for batch in group.batches), default=0),
        "compilations": len(plan.groups),
        "wall_s": meter.seconds,
        "compile_s": compiling,
        "scores": _scores(found),
    }


def _scores(found: StoredSweep) -> list[dict[str, Any]]:
    """Return the score of each task and policy, with its interval."""
    return [
        {
            "task": row.task,
            "policy": row.policy,
            "cells": row.cells,
            "score": row.mean.value,
            "low": _known(row.mean.low),
            "high": _known(row.mean.high),
            "method": row.mean.method,
        }
        for row in overall_rows(found)
    ]


def _common(played: list[CellRecord]) -> dict[str, str]:
    """Return the settings that all cells have alike, as text."""
    first = played[0].settings
    return {
        name: as_text(value)
        for name, value in first.items()
        if all(record.settings.get(name) == value for record in played)
    }


def _work_of(played: list[CellRecord]) -> dict[str, int | None]:
    """Return how much was played; agent steps up to the ends of episodes, None where a team is not known."""
    steps = [sum(record.steps) * record.agents for record in played]
    return {
        "cells": len(played),
        "episodes": sum(len(record.scores) for record in played),
        "bad_episodes": sum(map(sum, (record.bad for record in played))),
        "agent_steps": sum(steps) if all(record.agents for record in played) else None,
    }


def _known(end: float) -> float | None:
    """Return an end of an interval; None where a single score has none: JSON has no infinity."""
    return end if math.isfinite(end) else None


def record_line(record: dict[str, Any]) -> str:
    """Return what a record says, in a line."""
    many = f"{record['cells']} cell{'' if record['cells'] == 1 else 's'}"
    return (
        f"{many} in {record['wall_s']:.1f} s, {record['compile_s']:.1f} s of it to compile, "
        f"on {record['device']}"
    )
