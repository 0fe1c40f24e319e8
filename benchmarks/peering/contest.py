"""Ours and others in turn, on one machine in one run: robots x steps and simulated time per second."""

import os
import signal
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import jax
import mujoco

from benchmarks.cases import ContestCase, PeerFolders, RecordOptions, SceneCase
from benchmarks.peering.ours import WORKLOADS, Workload
from benchmarks.peering.peers import (
    ON_HOST,
    SCRIPT,
    ContestantError,
    Peer,
    ask_process,
    ensure_environment,
    read_peers,
)
from benchmarks.scenes import scene_of, start_qpos
from benchmarks.tools import append_record, rate_of, record_header, rewrite_record, spare_memory
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.engines import choose_engine
from usarmjx.engines.c.batch import c_model

NO_RECORD = RecordOptions()
OURS = "usarmjx"
"""Who we are in a record's rows."""
UNFINISHED, INTERRUPTED = (f"{what}: later rows are missing" for what in ("not finished", "interrupted"))


class GrowingRecord:
    """A record that gets rows, and is written anew with each: what ends the run leaves those that there are.

    Args:
        header: Its first entries, of `tools.record_header`.
        case: The measured case.
        file: Of records; None: it is in none. A target that is no file, such as a pipe, gets it at
            the end.

    Attributes:
        rows: Measurements so far.
    """

    def __init__(self, header: Mapping[str, Any], case: Mapping[str, Any], file: Path | None) -> None:
        self.rows: list[dict[str, Any]] = []
        self._header, self._case, self._file = header, case, file
        self._rewritten = file is not None and (file.is_file() or not file.exists())
        self._line = b""

    def add(self, row: dict[str, Any]) -> None:
        """Add a row.

        Raises:
            WriteError: The file has the rows before.
        """
        self.rows.append(row)
        if self._file is not None and self._rewritten:
            self._line = rewrite_record(self._record(UNFINISHED), self._file, self._line)

    def finish(self, note: str = "") -> dict[str, Any]:
        """Write it for the last time and return it.

        Args:
            note: Remarks beside the header.

        Raises:
            WriteError: The file has it as it was after the last row.
        """
        record = self._record(note)
        if self._file is not None and self._rewritten:
            self._line = rewrite_record(record, self._file, self._line)
        else:
            append_record(record, self._file)
        return record

    def _record(self, note: str) -> dict[str, Any]:
        return {
            **self._header,
            "note": "; ".join(filter(None, [self._header["note"], note])),
            "case": self._case,
            "scene": None,
            "rates": {
                f"{row['who']}, {row['variant']}, {row['worlds']} x {row['robots']}": row["speed"]
                for row in self.rows
                if "speed" in row
            },
            "baselines": {
                "mujoco_rollout": {"missing": "among the rows"},
                "bare_mjx": {"missing": "among the rows: the part `bare` of engine jax or warp"},
            },
            "in_the_step": "told in each row",
            "rows": self.rows,
        }


def device_of(row: Mapping[str, Any]) -> str:
    """Return what a row was measured on, `host` for any processor; a dash where nothing ran."""
    device = row.get("device", "-")
    return "host" if device in ON_HOST else device


def devices_differ(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether rows were measured on several devices."""
    return len({device_of(row) for row in rows if "device" in row}) > 1


def outcome(row: Mapping[str, Any]) -> str:
    """Return a row's rate and device for people, or why there is none."""
    return row.get("missing") or f"{row['robot_steps_per_s']:,.0f} robot-steps/s on {row['device']}"


def summary(record: Mapping[str, Any]) -> str:
    """Return the rows as a table for people."""
    lines = [
        f"on {record['device']}, {record['hardware']['cores']} cores",
        f"{'':44} {'worlds x robots':>15} {'robot-steps/s':>15} {'simulated s/s':>14}",
    ]
    differ = devices_differ(record["rows"])
    for row in record["rows"]:
        who, size = f"{row['who']}, {row['variant']}", f"{row['worlds']} x {row['robots']}"
        where = f"  {device_of(row)}" if differ else ""
        figures = row.get("missing") or (
            f"{row['robot_steps_per_s']:15,.0f} {row['robot_seconds_per_s']:14,.0f}{where}"
        )
        lines.append(f"{who:44} {size:>15} {figures}")
    return "\n".join(lines)


ROBOTS_OF_OURS = {
    "planar": "a footprint that rolls and slides on floors and ramps, in contact with walls and others",
    "": "a body on four wheels in MuJoCo, in contact with walls, loose objects and others",
}


def measure_peers(
    case: ContestCase,
    folders: PeerFolders,
    options: RecordOptions = NO_RECORD,
    say: Callable[[str], None] = lambda text: None,
) -> str:
    """Run all in turn, append a record as a JSON line, and return a summary for people.

    The record is written anew after each row, so that it has those that there are whatever ends the run.
    SIGTERM ends it as Ctrl-C does.

    Args:
        case: Cases to measure.
        folders: Of the peers and of their environments.
        options: Of the record.
        say: Hears what is measured now.

    Raises:
        UsageError: No such peer, or no source tree.
        UnknownNameError: No such engine or variant.
        WriteError: The file cannot be written; it has the rows before.
    """
    peers = read_peers(folders.folder, case.peers)
    spare_memory()
    engines = tuple(dict.fromkeys(choose_engine(engine, "batch") for engine in case.engines))
    settings = {**case.as_record(), "engines": engines}
    record = GrowingRecord(record_header("peers", note=options.note), settings, options.json)
    end = ""
    with tempfile.TemporaryDirectory(prefix="usarmjx-peers-") as scratch, _sigterm_as_interrupt():
        turns = _turns(case, peers, engines, folders, Path(scratch))
        chosen = _chosen(tuple(turns), case.variants)
        try:
            for (worlds, robots), turn in product(case.sizes, chosen):
                say(f"{turn.row['who']}, {turn.row['variant']}: {worlds} x {robots}")
                found = _run(case, turn, worlds, robots)
                record.add({**turn.row, "worlds": worlds, "robots": robots, **found})
                say(f"  {outcome(found)}")
        except KeyboardInterrupt:  # hours of work may be done: what is measured is kept
            end = INTERRUPTED
    if not record.rows:
        raise UsageError("interrupted before anything was measured")
    return summary(record.finish(end))


@contextmanager
def _sigterm_as_interrupt() -> Generator[None]:
    """Let SIGTERM raise KeyboardInterrupt, so that the process that measures is ended too."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


Words = Callable[[int, int], list[str]]
"""The command line that measures so many worlds of so many robots."""


@dataclass(frozen=True)
class Turn:
    """Cases measured at one go.

    Attributes:
        variant: Name by which variants are chosen.
        row: Description in a record.
        gpu: Whether it must run on a GPU; else it must not.
        words: Its command line.
    """

    variant: str
    row: Mapping[str, Any]
    gpu: bool
    words: Words


def _chosen(turns: Sequence[Turn], variants: Sequence[str]) -> Sequence[Turn]:
    """Return the turns of these variants; of none: all.

    Raises:
        UnknownNameError: None has such a variant.
    """
    known = dict.fromkeys(turn.variant for turn in turns)
    if unknown := [name for name in variants if name not in known]:
        raise UnknownNameError(
            f"no variant is called {unknown[0]!r}; known of these peers and engines: "
            + ", ".join(repr(name) for name in known)
        )
    return [turn for turn in turns if turn.variant in (variants or known)]


def _turns(
    case: ContestCase,
    peers: Sequence[Peer],
    engines: Sequence[str],
    folders: PeerFolders,
    scratch: Path,
) -> Iterator[Turn]:
    """Yield all that can be measured."""
    gpu = jax.devices()[0].platform == "gpu"
    for peer in peers:
        here = gpu and not peer.host
        for variant in peer.variants:
            row = {"who": peer.name, "variant": variant, **peer.about(variant)}
            words = _peer_words(case, peer, variant, folders, here, scratch)
            yield Turn(variant, row, here, words)
    for engine in engines:
        for name, part in WORKLOADS.items():
            if engine in (part.engines or (engine,)):
                ini = folders.folder.parent / part.ini if part.ini else None
                words = _ours_words(case, engine, name, ini)
                yield Turn(name, _ours_row(engine, name, part), gpu and engine != "c", words)


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
        return ["-m", "benchmarks.peering.ours", *chosen, *_sizes(case, worlds, robots)]

    return words


def _peer_words(
    case: ContestCase, peer: Peer, variant: str, folders: PeerFolders, gpu: bool, scratch: Path
) -> Words:
    def words(worlds: int, robots: int) -> list[str]:
        python = ensure_environment(peer, folders.environments, install=folders.install)
        chosen = ["--variant", variant, "--device", "gpu" if gpu else "cpu"]
        if peer.host:
            chosen += ["--model", str(_save_model(case.arena, robots, scratch))]
        return [str(python), str(peer.folder / SCRIPT), *chosen, *_sizes(case, worlds, robots)]

    return words


def _save_model(arena: str, robots: int, folder: Path) -> Path:
    """Write our scene as a MuJoCo model whose robots are at their start poses; return the file."""
    file = folder / f"{robots}.mjb"
    if not file.exists():
        scene = scene_of(SceneCase(worlds=1, roster=f"P2AT:{robots}", arena=arena, engine="c"))
        model = c_model(scene.model)
        model.qpos0[:] = start_qpos(scene)
        mujoco.mj_saveModel(model, str(file))
    return file


def _run(case: ContestCase, turn: Turn, worlds: int, robots: int) -> dict[str, Any]:
    """Return a contestant's figures, or why there are none."""
    try:
        found = ask_process(turn.words(worlds, robots), case.limit)
    except ContestantError as error:
        return {"missing": str(error)}
    if (found["device"] in ON_HOST) == turn.gpu:
        wanted = "a GPU" if turn.gpu else "the processor"
        return {"missing": f"asked for {wanted}, ran on {found['device']}", "device": found["device"]}
    work = worlds * robots * found["steps"]
    speed = rate_of("robot-steps/s", work, found["first_s"], found["times_s"], found["warm_up"])
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
