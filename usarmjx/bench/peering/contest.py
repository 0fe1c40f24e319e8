"""Ours and others in turn, on one machine in one run: robots x steps and simulated time per second."""

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import jax
import mujoco

from usarmjx.base.errors import UsageError
from usarmjx.bench.peering.ours import WORKLOADS, Workload
from usarmjx.bench.peering.peers import (
    SCRIPT,
    ContestantError,
    Peer,
    ask_process,
    ensure_environment,
    read_peers,
)
from usarmjx.bench.scenes import SceneCase, start_qpos
from usarmjx.bench.tools import append_record, rate_of, record_header
from usarmjx.engines import choose_engine
from usarmjx.engines.c import c_model

ROBOTS_OF_OURS = {
    "planar": "a footprint that rolls and slides on floors and ramps, in contact with walls and others",
    "": "a body on four wheels in MuJoCo, in contact with walls, loose objects and others",
}
OURS = "usarmjx"


@dataclass(frozen=True, kw_only=True)
class ContestCase:
    """What to measure.

    Attributes:
        sizes: Worlds and robots in each.
        peers: Folders of the peers; none: all there are.
        engines: Of ours.
        steps: Of a repeat.
        repeats: How many.
        seed: Of all random numbers.
        arena: Of ours and of MuJoCo's.
        limit: After which a process is ended [s].
    """

    sizes: tuple[tuple[int, int], ...] = ((64, 4),)
    peers: tuple[str, ...] = ()
    engines: tuple[str, ...] = ("auto", "planar")
    steps: int = 20
    repeats: int = 3
    seed: int = 0
    arena: str = "yellow"
    limit: float = 900.0


def parse_sizes(texts: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return sizes that are written as `4096x16`, worlds and robots.

    Raises:
        UsageError: One is not of that form.
    """
    found = []
    for text in texts:
        worlds, cross, robots = text.partition("x")
        if not (cross and worlds.isdecimal() and robots.isdecimal() and int(worlds) and int(robots)):
            raise UsageError(f"--size: {text!r} is not WORLDSxROBOTS, as 4096x16")
        found.append((int(worlds), int(robots)))
    return tuple(found)


def measure_peers(
    case: ContestCase,
    folder: Path,
    environments: Path,
    *,
    install: bool = True,
    file: Path | None = None,
    note: str = "",
    say: Callable[[str], None] = lambda text: None,
) -> str:
    """Run all in turn, append a record to `file` as a JSON line, and return a summary for people.

    Args:
        case: What to measure.
        folder: Of the peers' folders.
        environments: Where each peer has its environment, or gets one.
        install: Whether it may get one.
        file: Of records.
        note: What a reader of the record must know.
        say: Hears what is measured now.

    Raises:
        UsageError: No such peer, or no source tree.
        UnknownNameError: No such engine.
    """
    peers = read_peers(folder, case.peers)
    engines = tuple(dict.fromkeys(choose_engine(engine, "batch") for engine in case.engines))
    header = record_header("peers", note=note)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="usarmjx-peers-") as scratch:
        turns = tuple(_contestants(case, peers, engines, folder, environments, install, Path(scratch)))
        try:
            for (worlds, robots), (row, words) in product(case.sizes, turns):
                say(f"{row['who']}, {row['variant']}: {worlds} x {robots}")
                rows.append({**row, "worlds": worlds, "robots": robots, **_run(case, words, worlds, robots)})
        except KeyboardInterrupt:  # hours of work may be done: what is measured is kept
            header["note"] = "; ".join(
                filter(None, [header["note"], "interrupted: what came later is not here"])
            )
    if not rows:
        raise UsageError("interrupted before anything was measured")
    record = {
        **header,
        "case": {**asdict(case), "engines": engines},
        "scene": None,
        "rates": {
            f"{row['who']}, {row['variant']}, {row['worlds']} x {row['robots']}": row["speed"]
            for row in rows
            if "speed" in row
        },
        "baselines": {
            "mujoco_rollout": {"missing": "among the rows"},
            "bare_mjx": {"missing": "among the rows: the part `bare` of engine jax or warp"},
        },
        "in_the_step": "told in each row",
        "rows": rows,
    }
    append_record(record, file)
    return summary(record)


Words = Callable[[int, int], list[str]]
"""The command line that measures so many worlds of so many robots."""


def _contestants(
    case: ContestCase,
    peers: Sequence[Peer],
    engines: Sequence[str],
    folder: Path,
    environments: Path,
    install: bool,
    scratch: Path,
) -> Iterator[tuple[dict[str, Any], Words]]:
    """Yield who is measured: what a record says of them, and their command line."""
    gpu = jax.devices()[0].platform == "gpu"
    for peer in peers:
        for variant in peer.variants:
            row = {"who": peer.name, "variant": variant, **peer.about(variant)}
            yield row, _peer_words(case, peer, variant, environments, install, gpu and not peer.host, scratch)
    for engine in engines:
        for name, part in WORKLOADS.items():
            if engine in (part.engines or (engine,)):
                ini = folder.parent / part.ini if part.ini else None
                yield _ours_row(engine, name, part), _ours_words(case, engine, name, ini)


def _ours_row(engine: str, name: str, part: Workload) -> dict[str, Any]:
    return {
        "who": OURS,
        "variant": f"{engine}, {name}",
        "robot": ROBOTS_OF_OURS.get(engine, ROBOTS_OF_OURS[""]),
        "has": part.has,
        "lacks": part.lacks,
        "settings": f"{part.physics} settings of the physics; random commands that are drawn in the step",
        "beams": part.beams,
        "authors": "",
        "citation": "",
    }


def _sizes(case: ContestCase, worlds: int, robots: int) -> list[str]:
    numbers: Mapping[str, int] = {
        "worlds": worlds, "robots": robots, "steps": case.steps, "repeats": case.repeats, "seed": case.seed,
    }  # fmt: skip
    return [word for name, number in numbers.items() for word in (f"--{name}", str(number))]


def _ours_words(case: ContestCase, engine: str, part: str, ini: Path | None) -> Words:
    def words(worlds: int, robots: int) -> list[str]:
        chosen = ["--engine", engine, "--part", part, "--arena", case.arena]
        if ini is not None:
            chosen += ["--ini", str(ini)]
        return ["-m", "usarmjx.bench.peering.ours", *chosen, *_sizes(case, worlds, robots)]

    return words


def _peer_words(
    case: ContestCase, peer: Peer, variant: str, environments: Path, install: bool, gpu: bool, scratch: Path
) -> Words:
    def words(worlds: int, robots: int) -> list[str]:
        python = ensure_environment(peer, environments, install=install)
        chosen = ["--variant", variant, "--device", "gpu" if gpu else "cpu"]
        if peer.host:
            chosen += ["--model", str(_save_model(case.arena, robots, scratch))]
        return [str(python), str(peer.folder / SCRIPT), *chosen, *_sizes(case, worlds, robots)]

    return words


def _save_model(arena: str, robots: int, folder: Path) -> Path:
    """Write our scene as a MuJoCo model whose robots are at their start poses; return the file."""
    file = folder / f"{robots}.mjb"
    if not file.exists():
        scene = SceneCase(worlds=1, roster=f"P2AT:{robots}", arena=arena, engine="c").scene()
        model = c_model(scene.model)
        model.qpos0[:] = start_qpos(scene)
        mujoco.mj_saveModel(model, str(file))
    return file


def _run(case: ContestCase, words: Words, worlds: int, robots: int) -> dict[str, Any]:
    """Return a contestant's figures, or why there are none."""
    try:
        found = ask_process(words(worlds, robots), case.limit)
    except ContestantError as error:
        return {"missing": str(error)}
    work = worlds * robots * found["steps"]
    speed = rate_of("robot-steps/s", work, found["first_s"], found["times_s"])
    load = round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None
    return {
        "speed": speed,
        "robot_steps_per_s": speed["rate"],
        "period_s": found["period_s"],
        "robot_seconds_per_s": speed["rate"] * found["period_s"],
        "device": found["device"],
        "versions": found["versions"],
        "load_average": load,
    }


def summary(record: Mapping[str, Any]) -> str:
    """Return the rows as a table for people."""
    lines = [
        f"on {record['device']}, {record['hardware']['cores']} cores",
        f"{'':44} {'worlds x robots':>15} {'robot-steps/s':>15} {'simulated s/s':>14}",
    ]
    for row in record["rows"]:
        who, size = f"{row['who']}, {row['variant']}", f"{row['worlds']} x {row['robots']}"
        figures = row.get("missing") or (
            f"{row['robot_steps_per_s']:15,.0f} {row['robot_seconds_per_s']:14,.0f}"
        )
        lines.append(f"{who:44} {size:>15} {figures}")
    return "\n".join(lines)
