"""Blocks of a page that are made of records, between markers; all other text stays as it is."""

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.peering.contest import device_of, devices_differ
from benchmarks.report import tables
from benchmarks.report.figures import DIGEST, FIGURES
from benchmarks.report.laws import laws_table
from benchmarks.report.records import BenchRecord, read_records
from benchmarks.report.tables import NOTHING, MarkdownRow, number, of, table
from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write


def peers_text(records: Sequence[BenchRecord]) -> str:
    """Return a table of rates and one of what they are rates of, for each run, newest first."""
    runs = of(records, "peers")[::-1]
    return "\n".join(_run_text(record) for record in runs) if runs else NOTHING


def _run_text(record: BenchRecord) -> str:
    load = record.data["hardware"]["load_average"]
    begin, end = (number(load[when]) for when in ("begin", "end"))
    note = f" {record.data['note']}." if record.data["note"] else ""
    differ = devices_differ(record.data["rows"])
    rates = table(
        (
            "simulator", "variant", "worlds x robots", "robot-steps/s", "a step is [s]",
            "simulated robot-s per s", "least to most", "load", *(["on"] if differ else []),
        ),
        (
            [
                row["who"],
                row["variant"],
                f"{row['worlds']} x {row['robots']}",
                *(
                    [
                        number(row["robot_steps_per_s"]),
                        number(row["period_s"]),
                        number(row["robot_seconds_per_s"]),
                        " to ".join(
                            number(row["speed"][end] * row["period_s"]) for end in ("least", "most")
                        ),
                        number(row["load_average"]),
                    ]
                    if "speed" in row
                    else [f"not measured: {row['missing']}", "-", "-", "-", "-"]
                ),
                *([device_of(row)] if differ else []),
            ]
            for row in record.data["rows"]
        ),
    )  # fmt: skip
    told = {(row["who"], row["variant"]): row for row in record.data["rows"]}
    steps = table(
        (
            "simulator",
            "a robot is",
            "in its step",
            "beams of a robot",
            "not in it",
            "run with",
            "its authors say",
        ),
        (
            [
                f"{who}, {variant}",
                row["robot"],
                row["has"],
                str(row["beams"] or "-"),
                row["lacks"],
                row["settings"],
                f"{row['authors']} ({row['citation']})" if row["authors"] else "-",
            ]
            for (who, variant), row in told.items()
        ),
    )
    run = f"{record.when}, commit {record.data['commit']}, {record.where}"
    head = f"{run}, load average {begin} to {end}.{note}\n"
    return "\n".join([head, rates, steps])


SHOWN = ("timestep", "solver", "iterations", "cone")
"""Settings by which a record is told from others."""


def settings_words(record: BenchRecord) -> str:
    """Return the settings of a record of `usarmjx bench physics` in a few words."""
    settings: Mapping[str, Any] = record.data["settings"]
    return ", ".join(f"{name} {settings[name]}" for name in SHOWN)


def _settings_records(records: Sequence[BenchRecord]) -> list[BenchRecord]:
    """Return the records of settings, not of engines; those of the first form are all of settings."""
    return [one for one in of(records, "physics") if one.data.get("case", {}).get("engine", "c") == "c"]


def physics_table(records: Sequence[BenchRecord]) -> str:
    """Count of numbers that are the reference's."""
    head = ("when", "commit", "on", "settings", "numbers within 10 % of the reference")
    rows = []
    for record in _settings_records(records):
        total = sum(len(numbers) for numbers in record.data["numbers"].values())
        within = f"{total - len(record.data['differing'])} of {total}"
        rows.append([record.when, record.data["commit"], record.where, settings_words(record), within])
    return table(head, rows)


def differences_text(records: Sequence[BenchRecord]) -> str:
    """Classes that behave otherwise under the settings, with both numbers."""
    newest = {json.dumps(one.data["settings"], sort_keys=True): one for one in _settings_records(records)}
    return "\n".join(map(_differences, newest.values())) or table((), ())


def _differences(record: BenchRecord) -> str:
    data, origin = record.data, f"{record.when}, commit {record.data['commit']}"
    apart = {name for name, _ in data["differing"]}
    same = ", ".join(name for name in data["numbers"] if name not in apart)
    head = ("class", "manoeuvre", "reference", "here")
    return (
        f"{settings_words(record)} ({origin}): differences of more than 10 %.\n\n"
        f"{table(head, _difference_rows(data))}\nNothing of {same or 'no class'}.\n"
    )


def _difference_rows(data: Mapping[str, Any]) -> Iterator[MarkdownRow]:
    for name, manoeuvre in data["differing"]:
        unit = data["units"][manoeuvre]
        told = (
            "went bad" if value is None else f"{number(value)} {unit}"
            for value in data["numbers"][name][manoeuvre]
        )
        yield [name, manoeuvre, *told]


BEGIN, END = "<!-- usarmjx bench report: {} -->", "<!-- end: {} -->"
BLOCK = re.compile(r"<!-- usarmjx bench report: ([a-z]+) -->\n(.*?)<!-- end: \1 -->", re.DOTALL)
MARKER = re.compile(r"<!-- (?:usarmjx bench report|end): ([a-z]+) -->")
BLOCKS: Mapping[str, Callable[[Sequence[BenchRecord]], str]] = {
    "step": tables.step_table,
    "parts": tables.parts_table,
    "laws": laws_table,
    "rays": tables.rays_table,
    "radio": tables.radio_table,
    "camera": tables.camera_table,
    "train": tables.train_table,
    "serve": tables.serve_table,
    "viewer": tables.viewer_table,
    "physics": physics_table,
    "differences": differences_text,
    "compile": tables.compile_table,
    "memory": tables.memory_table,
    "sweep": tables.sweep_table,
    "history": tables.history_table,
    "peers": peers_text,
}
"""What may stand between markers, by name."""


def fill_page(text: str, records: Sequence[BenchRecord]) -> str:
    """Return a page with its blocks written anew.

    Raises:
        UsageError: A block that there is not, or a marker without its other half.
    """
    names = [match[1] for match in BLOCK.finditer(text)]
    if unknown := [name for name in names if name not in BLOCKS]:
        raise UsageError(f"no block is called {unknown[0]!r}; known: {', '.join(BLOCKS)}")
    if odd := [
        name for name in {*MARKER.findall(text)} if 2 * names.count(name) != MARKER.findall(text).count(name)
    ]:
        raise UsageError(f"the markers of block {odd[0]!r} do not match")

    def fill(match: re.Match[str]) -> str:
        name = match[1]
        return f"{BEGIN.format(name)}\n\n{BLOCKS[name](records)}\n{END.format(name)}"

    return BLOCK.sub(fill, text)


def digest_of(records: Sequence[BenchRecord]) -> str:
    """Return a fingerprint of what figures are drawn from."""
    drawn = [json.dumps(record.data, sort_keys=True) for record in records]
    return hashlib.sha256("\n".join(drawn).encode()).hexdigest()[:16]


def is_drawn(file: Path, records: Sequence[BenchRecord]) -> bool:
    """Whether a figure is one of these records."""
    if not file.exists():
        return False
    with Image.open(file) as image:
        return image.info.get(DIGEST) == digest_of(records)


def write_page(results: Path, page: Path) -> str:
    """Write a page's blocks anew, and the figures beside it; say what was done.

    Args:
        results: Folder of records.
        page: The page.

    Raises:
        UsageError: No records, no page, or markers that do not match.
        WriteError: It cannot be written.
    """
    records = read_records(results)
    if not page.exists():
        raise UsageError(f"{page}: no such page")
    before = page.read_text(encoding="utf-8")
    text = fill_page(before, records)
    with atomic_write(page) as fresh:
        fresh.write_text(text, encoding="utf-8")
    drawn = [name for name in FIGURES if not is_drawn(page.parent / name, records)]
    for name in drawn:
        FIGURES[name](records, page.parent / name, digest_of(records))
    return (
        f"{page}: {len(BLOCK.findall(text))} blocks of {len(records)} records, "
        f"{'changed' if text != before else 'as they were'}; drawn: {', '.join(drawn) or 'nothing'}"
    )
