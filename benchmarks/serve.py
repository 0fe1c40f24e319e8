"""A client's view of `usarmjx serve`: waiting, gaps, and what robots cost, over TCP.

Servers are processes that the public command line starts, so that those of other source trees can be measured
in the same run, in turn with ours. Cold is with an empty compilation cache, cached is the same once more.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.baselines import hall_baselines
from benchmarks.cases import CLASS_ARENA, BaselineOptions, ServeCase
from benchmarks.serving.clients import Bounds, Missing, attempt, gather, measure_inits, ratios, rows, show
from benchmarks.serving.load import make_hall, measure_gaps, measure_load, measure_pictures
from benchmarks.serving.process import OWN_TREE, ServerProcess, SourceTree
from benchmarks.tools import run_case, spread_of
from usarmjx.base.errors import UsageError
from usarmjx.models.files.load import find_arena, save_arena

USUAL = BaselineOptions()
USUAL_SEATS = 16
"""Robots that a server takes if nobody asks for more."""
MEANING = {
    "listening_s": "from the start of the process",
    "first_sta_s": "from the connection, INIT at once",
    "beyond_due_s": "the longest gap between two reports of a P2AT (in init: of the first class) that "
    "watches, less the 0.2 s that are due",
    "cpu_per_simulated_s": "of the whole process; robots are P2AT and P2DX in turn with all their sensors, "
    "and drive by turning on the spot",
    "jitter": "of the time between two reports of a robot, less the difference of their own times",
    "joint_shows_s, motion_shows_s": "from a command to the first MISSTA or odometry that shows it",
    "first_view_s": "the first picture that is not black",
}
"""What a record's figures are."""


def bounds_of(case: ServeCase) -> Bounds:
    """Return how long to measure and to wait."""
    return Bounds(case.seconds, case.windows, case.limit)


def measure_serve(
    case: ServeCase,
    checkouts: Sequence[Path] = (),
    options: BaselineOptions = USUAL,
    say: Callable[[str], None] = lambda text: None,
) -> str:
    """Measure a case, append its record, and return a summary for people.

    Args:
        case: Cases to measure.
        checkouts: Source trees whose servers are measured too.
        options: Of the record.
        say: Hears what is measured now.

    Raises:
        UsageError: A checkout has no server, or there is no such part.
        UnknownNameError: No such arena.
    """

    def measure() -> dict[str, Any]:
        return _measure(case, checkouts, options.baselines, say)

    return run_case("serve", options, measure, _summary, host=True)


def _measure(
    case: ServeCase, checkouts: Sequence[Path], baselines: str, say: Callable[[str], None]
) -> dict[str, Any]:
    """Return the record of a case, without its header."""
    if unknown := [part for part in case.parts if part not in PARTS]:
        raise UsageError(f"no part is called {unknown[0]!r}; known: {', '.join(PARTS)}")
    trees = [SourceTree(OWN_TREE), *(SourceTree(folder.resolve()) for folder in checkouts)]
    for tree in trees:
        tree.prepare()
    began = os.getloadavg()
    found = _run(case, trees, say)
    servers = [
        {"commit": tree.commit, "figures": figures, "of_ours": ratios(found[0], figures) if number else None}
        for number, (tree, figures) in enumerate(zip(trees, found, strict=True))
    ]
    return {
        "case": case.as_record(),
        "scene": {"robots": max(case.robots)} if "load" in case.parts else None,
        "rates": _rates(found[0]),
        "baselines": hall_baselines("P2AT", max(case.robots), case.windows, baselines),
        "cores": os.cpu_count(),
        "load_average": {"begin": began, "end": os.getloadavg()},
        "meaning": MEANING,
        "servers": servers,
    }


def _rates(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return how much simulated time our server makes of a second of processor time, by load."""
    rates: dict[str, Any] = {}
    for name, figure in rows({"load": figures.get("load", {})} if "load" in figures else {}):
        if name.endswith("cpu_per_simulated_s") and figure["median"]:
            values = [1 / value for value in figure["values"] if value > 0]
            rates[name.removesuffix(" cpu_per_simulated_s")] = spread_of("simulated s/CPU s", values)
    return rates


def _run(case: ServeCase, trees: Sequence[SourceTree], say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Return the gathered figures of each tree; they take turns."""
    found: list[dict[str, Any]] = [{} for _ in trees]
    for part in case.parts:
        repeats = 1 if part == "load" else case.repeats
        runs: list[list[Any]] = [[] for _ in trees]
        for repeat in range(repeats):
            for tree, own in zip(trees, runs, strict=True):
                say(f"measuring {part}, {repeat + 1} of {repeats}, commit {tree.commit}")
                own.append(attempt(partial(PARTS[part], case, tree)))
        for figures, own in zip(found, runs, strict=True):
            figures[part] = gather(own)
    return found


def _cold_and_cached(
    case: ServeCase,
    tree: SourceTree,
    arena: str,
    measure: Callable[[ServerProcess], Any],
    options: Sequence[str] = (),
) -> dict[str, Any]:
    """Return what is measured with a server that has never run before, and with one that has."""
    figures: dict[str, Any] = {}
    seats = tree.seats(max(USUAL_SEATS, case.joining + 1))
    with TemporaryDirectory(prefix="usarmjx-bench-") as cache:
        for temperature in ("cold", "cached"):
            words = ["--arena", arena, "--engine", case.engine, *seats, *options]
            with ServerProcess(tree, Path(cache), words) as server:
                figures[temperature] = attempt(partial(measure, server))
    return figures


def _start(case: ServeCase, tree: SourceTree) -> dict[str, Any]:
    servers: list[ServerProcess] = []
    _cold_and_cached(case, tree, case.arena, servers.append)
    killed = Missing("it had to be killed")
    return {
        temperature: {
            "listening_s": server.started_s,
            "sigint_to_end_s": killed if server.stopped_s is None else server.stopped_s,
        }
        for temperature, server in zip(("cold", "cached"), servers, strict=True)
    }


def _init(case: ServeCase, tree: SourceTree) -> dict[str, Any]:
    measure = partial(measure_inits, kinds=case.classes, bounds=bounds_of(case))
    return _cold_and_cached(case, tree, CLASS_ARENA, measure)


def _gaps(case: ServeCase, tree: SourceTree) -> dict[str, Any]:
    measure = partial(measure_gaps, joining=case.joining, bounds=bounds_of(case))
    return _cold_and_cached(case, tree, case.arena, measure)


def _pictures(case: ServeCase, tree: SourceTree) -> dict[str, Any]:
    measure = partial(measure_pictures, bounds=bounds_of(case))
    return _cold_and_cached(case, tree, case.arena, measure, ["--image-format", "raw"])


def _load(case: ServeCase, tree: SourceTree) -> dict[str, Any]:
    """Return what each number of robots costs; all servers share a compilation cache."""
    figures: dict[str, Any] = {}
    room = len(find_arena(case.arena).starts)
    with TemporaryDirectory(prefix="usarmjx-bench-") as folder:
        for robots in case.robots:
            hall = Path(folder) / "hall.yaml"
            arena = case.arena if robots <= room else str(save_arena(make_hall(robots), hall))
            seats = tree.seats(max(USUAL_SEATS, robots))
            server = ServerProcess(tree, Path(folder), ["--arena", arena, "--engine", case.engine, *seats])
            figures[f"{robots} robots"] = attempt(partial(_load_of, server, robots, bounds_of(case)))
    return figures


def _load_of(server: ServerProcess, robots: int, bounds: Bounds) -> dict[str, Any]:
    with server:
        return measure_load(server, robots, bounds)


PARTS: Mapping[str, Callable[[ServeCase, SourceTree], dict[str, Any]]] = {
    "start": _start,
    "init": _init,
    "gaps": _gaps,
    "load": _load,
    "pictures": _pictures,
}
"""What can be measured."""


def _summary(record: Mapping[str, Any]) -> str:
    """Return the medians as a table, one column for each server, with the ratios to ours."""
    servers = record["servers"]
    columns = [dict(rows(server["figures"])) for server in servers]
    names = dict.fromkeys(name for column in columns for name in column)
    began, ended = (record["load_average"][when][0] for when in ("begin", "end"))
    lines = [
        f"on {record['device']}, {record['cores']} cores, load average {began:.1f} to {ended:.1f}; "
        "medians (least-most)",
        " | ".join([f"{'':52}", *(f"{server['commit']:24}" for server in servers), "of ours"]),
    ]
    for name in names:
        cells = [f"{show(column[name]) if name in column else '-':24}" for column in columns]
        of_ours = [server["of_ours"].get(name) for server in servers[1:]]
        lines.append(" | ".join([f"{name:52}", *cells, *("-" if r is None else f"{r:.2f}" for r in of_ours)]))
    for server, column in zip(servers, columns, strict=True):
        for name, figure in column.items():
            lines += [f"{server['commit']}, {name}: {reason}" for reason in figure.get("missing", ())]
    return "\n".join(line.rstrip() for line in lines)
