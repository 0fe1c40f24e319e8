"""Accelerations of solver `block` beside C MuJoCo's Newton, converged to 1e-10, on the same constraint rows.

python -m benchmarks.islands --states 100000 --progress islands.jsonl --json benchmarks/results/islands.jsonl

Every robot class is in every packaged arena: two robots of it, and one of another class. A line of the file
of progress is a round of one class in one arena; a later run goes on where the file ends. The exit status is
1 if an acceleration is wrong by more than the bound.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from copy import copy
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, get_args

import numpy as np

from benchmarks.islands import rows
from benchmarks.islands.compare import errors, root_errors
from benchmarks.islands.optimum import Problem
from benchmarks.islands.states import StateMaker
from benchmarks.tools import append_record, record_header
from usarmjx.base.files import AppendedFile
from usarmjx.models import ARENAS, ROBOTS
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.scene import build_scene

Cone = Literal["elliptic", "pyramidal"]
BOUND = 1e-4
"""Most relative error of an acceleration."""
LENGTH = 8
"""States of a trajectory; a round has a trajectory of each kind."""
WORST = 12
"""States that a record lists."""
EDGES = np.arange(-8.0, 0.5, 0.5)
"""Of the histograms: decimal logarithms of errors."""
MEASURES = {"island": errors, "root": root_errors}
"""Errors of states by name."""


def histogram(values: np.ndarray) -> list[int]:
    """Return how many values are below the first edge, between each two edges, and above the last."""
    places = np.searchsorted(EDGES, np.log10(np.maximum(values, 1e-300)), side="right")
    return np.bincount(places, minlength=len(EDGES) + 1).tolist()


def causes(model: Any, data: Any, found: np.ndarray) -> dict[str, dict[str, float]]:  # noqa: ANN401
    """Return the parts of the error of a state.

    `solver`: to the optimum of the rows in single precision, which it was given; `rounding`: from there to
    the optimum of the rows as they are; `c`: from C MuJoCo's accelerations to that.
    """
    given, own = (Problem(model, data, single) for single in (True, False))
    of_given, of_own = given.optimum(found), own.optimum(data.qacc.copy())
    parts = {"solver": (found, of_given), "rounding": (of_given, of_own), "c": (data.qacc, of_own)}
    told: dict[str, dict[str, float]] = {}
    for name, (one, other) in parts.items():
        moved = copy(data)
        moved.qacc = other
        told[name] = {key: float(measure(model, [moved], one[None])[0]) for key, measure in MEASURES.items()}
    return told


def judge(model: Any, solved: dict[str, list[SimpleNamespace]]) -> dict[str, Any]:  # noqa: ANN401
    """Solve states by the solver, and return the entries of a line of progress.

    Args:
        model: A model that `rows.exact` changed.
        solved: States by kind, as `rows.keep` returned them.
    """
    every = [(kind, k, data) for kind, list_of in solved.items() for k, data in enumerate(list_of)]
    states = [data for _, _, data in every]
    done = rows.solved_alone(model, states)
    found = done.qacc.numpy().astype(float)
    wrong = {name: measure(model, states, found) for name, measure in MEASURES.items()}
    beyond = [
        {"kind": every[k][0], "state": every[k][1], **{name: float(wrong[name][k]) for name in wrong}}
        | causes(model, states[k], found[k])
        for k in np.flatnonzero(np.max(list(wrong.values()), axis=0) > BOUND)
    ]
    return {
        "states": {kind: len(list_of) for kind, list_of in solved.items()},
        "touching": sum(data.ncon > 0 for data in states),
        "rows": max(data.nefc for data in states),
        "iterations": int(done.solver_niter.numpy().max()),
        "worst": {name: float(value.max()) for name, value in wrong.items()},
        "histogram": {name: histogram(value) for name, value in wrong.items()},
        "beyond": beyond,
    }


def play(arena: str, robot: str, turn: int, length: int, cone: Cone = "elliptic") -> dict[str, Any]:
    """Return the line of progress of a round of a robot class in an arena.

    Args:
        arena: Name.
        robot: Name of the class.
        turn: Number of the round.
        length: States of a trajectory.
        cone: Friction cone.
    """
    classes, arenas = ROBOTS.names(), ARENAS.names()
    numbers = arenas.index(arena), classes.index(robot)
    other = classes[(sum(numbers) + 1 + turn) % len(classes)]
    scene = build_scene(arena, [robot, robot, other], Physics(cone=cone, solver="block"))
    model = rows.exact(scene.model)
    maker, rng = StateMaker(model, scene.arena, 3), np.random.default_rng([*numbers, turn])
    solved = {kind: [rows.keep(data) for data in maker.trajectory(kind, rng, length)] for kind in maker.kinds}
    told = {"arena": arena, "robot": robot, "other": other, "round": turn, "cone": cone}
    return told | {"loose": len(maker.loose)} | judge(model, solved)


def rounds(done: set[tuple[Any, ...]], cones: Sequence[Cone]) -> Iterator[tuple[str, str, int, Cone]]:
    """Yield what is to play, round by round, without what has been played."""
    turn = 0
    while True:
        for arena in ARENAS.names():
            for robot in ROBOTS.names():
                key = (arena, robot, turn, cones[turn % len(cones)])
                if key not in done:
                    yield key
        turn += 1


def summary(lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the entries of a record, given all lines of progress."""
    kinds = sorted({kind for line in lines for kind in line["states"]})
    worst = {name: max(lines, key=lambda line: line["worst"][name]) for name in MEASURES}
    return {
        "states": sum(sum(line["states"].values()) for line in lines),
        "by_kind": {kind: sum(line["states"].get(kind, 0) for line in lines) for kind in kinds},
        "touching": sum(line["touching"] for line in lines),
        "robots": len({line["robot"] for line in lines}),
        "arenas": len({line["arena"] for line in lines}),
        "pairs": len({(line["robot"], line["arena"]) for line in lines}),
        "most_rows": max(line["rows"] for line in lines),
        "most_iterations": max(line["iterations"] for line in lines),
        "worst": {
            name: {"error": line["worst"][name], "arena": line["arena"], "robot": line["robot"]}
            for name, line in worst.items()
        },
        "edges": EDGES.tolist(),
        "histogram": {
            name: np.sum([line["histogram"][name] for line in lines], 0).tolist() for name in MEASURES
        },
        "beyond": _beyond(lines),
    }


def _beyond(lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return how many states are beyond the bound, the parts of their errors, and the worst of them."""
    keys = ("arena", "robot", "other", "round")
    found = [{key: line[key] for key in keys} | one for line in lines for one in line["beyond"]]
    found.sort(key=lambda one: -one["island"])
    parts = {
        part: {name: max((one[part][name] for one in found), default=0.0) for name in MEASURES}
        for part in ("solver", "rounding", "c")
    }
    return {
        "states": len(found),
        "by_measure": {name: sum(one[name] > BOUND for one in found) for name in MEASURES},
        "solver_beyond": {name: sum(one["solver"][name] > BOUND for one in found) for name in MEASURES},
        "most": parts,
        "worst": found[:WORST],
    }


def main(argv: Sequence[str]) -> int:
    """Play rounds until there are enough states or the time is up, and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.islands", description=(__doc__ or "").split("\n", maxsplit=1)[0]
    )
    parser.add_argument("--states", type=int, default=100_000, help="states after which to end")
    parser.add_argument("--seconds", type=float, default=1200.0, help="time after which to end [s]")
    parser.add_argument("--length", type=int, default=LENGTH, help="states of a trajectory")
    parser.add_argument(
        "--cones", nargs="+", default=["elliptic"], choices=get_args(Cone), help="friction cones, by round"
    )
    parser.add_argument("--progress", type=Path, required=True, help="file of progress, made or gone on with")
    parser.add_argument("--json", type=Path, help="append the record to this file")
    parser.add_argument("--note", default="", help="remark in the record")
    options = parser.parse_args(argv)
    header, began = record_header("islands", host=True, note=options.note), time.perf_counter()
    lines = []
    if options.progress.exists():
        lines = [json.loads(line) for line in options.progress.read_text(encoding="utf-8").splitlines()]
    file = AppendedFile(options.progress)
    count = sum(sum(line["states"].values()) for line in lines)
    done = {(line["arena"], line["robot"], line["round"], line["cone"]) for line in lines}
    for arena, robot, turn, cone in rounds(done, options.cones):
        if count >= options.states or time.perf_counter() - began > options.seconds:
            break
        line = play(arena, robot, turn, options.length, cone)
        file.append(json.dumps(line).encode() + b"\n")
        lines.append(line)
        count += sum(line["states"].values())
        if line["beyond"]:
            print(f"{arena} {robot}: {len(line['beyond'])} beyond, {line['worst']}", flush=True)
    file.close()
    beyond = 0
    for cone in options.cones:
        mine = [line for line in lines if line["cone"] == cone]
        beyond += report(mine, options, header) if mine else 0
    return int(bool(beyond))


def report(lines: Sequence[dict[str, Any]], options: argparse.Namespace, header: dict[str, Any]) -> int:
    """Append the record of a cone to the file, and return the number of states beyond the bound."""
    told, cone = summary(lines), lines[0]["cone"]
    case = {"bound": BOUND, "cone": cone, "kinds": list(told["by_kind"]), "length": options.length}
    baselines = {"c": {"what": "C MuJoCo's Newton solver, tolerance 1e-10, on the same rows"}}
    record = {**header, "case": case, "scene": None, "rates": {}, "baselines": baselines, **told}
    append_record(record, options.json)
    print(
        f"{cone}: {told['states']} states of {told['pairs']} pairs, {told['touching']} in contact; "
        f"worst {told['worst']}; {told['beyond']['states']} beyond {BOUND}"
    )
    return told["beyond"]["states"]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
