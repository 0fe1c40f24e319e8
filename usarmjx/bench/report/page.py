"""Blocks of a page that are made of records, between markers; all other text stays as it is."""

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from PIL import Image

from usarmjx.base.errors import UsageError
from usarmjx.base.files import write_beside
from usarmjx.bench.report import tables
from usarmjx.bench.report.figures import DIGEST, FIGURES
from usarmjx.bench.report.laws import laws_table
from usarmjx.bench.report.peer_tables import peers_text
from usarmjx.bench.report.physics_tables import differences_text, physics_table
from usarmjx.bench.report.records import BenchRecord, read_records

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
    with write_beside(page) as fresh:
        fresh.write_text(text, encoding="utf-8")
    drawn = [name for name in FIGURES if not is_drawn(page.parent / name, records)]
    for name in drawn:
        FIGURES[name](records, page.parent / name, digest_of(records))
    return (
        f"{page}: {len(BLOCK.findall(text))} blocks of {len(records)} records, "
        f"{'changed' if text != before else 'as they were'}; drawn: {', '.join(drawn) or 'nothing'}"
    )
