"""The conformance tables are well formed, its tests exist and its counts are right."""

import ast
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "conformance"
STATUSES = ("yes", "partly", "not yet", "not applicable")
COLUMNS = ["manual", "item", "status", "where / test", "note"]
SECTIONS = range(3, 15)  # the manual's sections that describe something to build
NAMED_TEST = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")
SECTION_HEADING = re.compile(r"# Conformance, section (\d+): (.+)")
SECTION_NUMBER = re.compile(r"\d+(\.\d+)*")


@dataclass(frozen=True)
class Row:
    """One row of the pages.

    Attributes:
        chapter: Number of the section whose page the row stands on.
        line: Line number on the page.
        manual: Section of the manual, such as "9.3".
        item: What the manual describes there.
        status: One of STATUSES.
        where: Code and tests that show it.
        note: Source, correction or reason.
    """

    chapter: int
    line: int
    manual: str
    item: str
    status: str
    where: str
    note: str


def cells_of(line: str) -> list[str]:
    """Return the stripped cells of one table line."""
    return [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")]


def parse(text: str) -> list[Row]:
    """Return the rows of all tables on the page of a section, in order.

    Raises:
        ValueError: A table line there does not have five cells.
    """
    rows: list[Row] = []
    chapter = 0
    for number, line in enumerate(text.splitlines(), 1):
        if heading := SECTION_HEADING.fullmatch(line):
            chapter = int(heading[1])
        if not chapter or not line.startswith("|"):
            continue
        cells = cells_of(line)
        if cells == COLUMNS or set("".join(cells)) == {"-"}:
            continue
        if len(cells) != len(COLUMNS):
            raise ValueError(f"line {number}: {len(cells)} cells instead of {len(COLUMNS)}")
        rows.append(Row(chapter, number, *cells))
    return rows


@cache
def functions_in(path: Path) -> frozenset[str]:
    """Return the names of a file's module-level functions; none if there is no such file."""
    if not path.is_file():
        return frozenset()
    body = ast.parse(path.read_text(encoding="utf-8")).body
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    return frozenset(node.name for node in body if isinstance(node, kinds))


def faults_of(row: Row) -> list[str]:
    """Return what is wrong with one row, in words."""
    faults: list[str] = []
    if not SECTION_NUMBER.fullmatch(row.manual) or row.manual.split(".")[0] != str(row.chapter):
        faults.append(f"manual section {row.manual!r} stands under heading {row.chapter}")
    if not row.item:
        faults.append("the item is empty")
    if row.status not in STATUSES:
        faults.append(f"status {row.status!r} is none of {STATUSES}")
    tests = NAMED_TEST.findall(row.where)
    if row.status in ("yes", "partly") and not tests:
        faults.append(f"{row.status!r} names no test as `tests/file.py::test_name`")
    for file, name in tests:
        if not name.startswith("test_") or name not in functions_in(ROOT / file):
            faults.append(f"there is no test {file}::{name}")
    if row.status in ("partly", "not applicable") and not row.note:
        faults.append(f"{row.status!r} has no note")
    return faults


def repeated(rows: Sequence[Row]) -> list[str]:
    """Return the (section, item) pairs that appear more than once, case ignored."""
    counts = Counter((row.manual, row.item.lower()) for row in rows)
    return [f"{manual} {item}" for (manual, item), count in counts.items() if count > 1]


def counts_of(rows: Sequence[Row]) -> str:
    """Return the cells of a line of counts: one for each status, and the sum."""
    counts = Counter(row.status for row in rows)
    return " | ".join(str(number) for number in (*(counts[status] for status in STATUSES), len(rows)))


def summary(pages: Mapping[str, str]) -> str:
    """Return the table of counts that the first page has to show, a line for each page and one for all."""
    lines = [f"| section | {' | '.join(STATUSES)} | rows |", "|---|---|---|---|---|---|"]
    for name, text in pages.items():
        heading = SECTION_HEADING.match(text)
        assert heading, name
        lines.append(f"| [{heading[1]} {heading[2]}]({name}) | {counts_of(parse(text))} |")
    everything = [row for text in pages.values() for row in parse(text)]
    return "\n".join([*lines, f"| all | {counts_of(everything)} |"])


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    """The pages of the sections by name, in the order of the manual."""
    paths = sorted(FOLDER.glob("[0-9]*.md"), key=lambda path: int(path.stem.split("-")[0]))
    return {path.name: path.read_text(encoding="utf-8") for path in paths}


@pytest.fixture(scope="module")
def rows(pages: dict[str, str]) -> list[Row]:
    """All rows of all pages."""
    return [row for text in pages.values() for row in parse(text)]


def test_every_row_is_sound(rows: list[Row]) -> None:
    """Status, section, named tests and notes of every row are in order."""
    faults = [f"section {row.chapter}, line {row.line}: {fault}" for row in rows for fault in faults_of(row)]
    assert not faults, "\n".join(faults)


def test_no_row_appears_twice(rows: list[Row]) -> None:
    """A pair of section and item identifies a row."""
    assert repeated(rows) == []


def test_all_sections_have_rows_in_order(rows: list[Row]) -> None:
    """Sections 3 to 14 are all there, in the manual's order."""
    assert list(dict.fromkeys(row.chapter for row in rows)) == list(SECTIONS)


def test_counts_are_right(pages: dict[str, str]) -> None:
    """The counts on the first page match the tables of all others."""
    expected = summary(pages)
    assert expected in (FOLDER / "index.md").read_text(encoding="utf-8"), f"index.md should say:\n{expected}"


THIS_TEST = "`tests/test_conformance.py::test_a_fault_is_found`"


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"manual": "10.2"}, "stands under heading 9"),
        ({"manual": "9.x"}, "stands under heading 9"),
        ({"item": ""}, "item is empty"),
        ({"status": "done"}, "is none of"),
        ({"where": "somewhere"}, "names no test"),
        ({"where": "`tests/test_conformance.py::test_missing`"}, "there is no test"),
        ({"where": "`tests/test_missing.py::test_missing`"}, "there is no test"),
        ({"where": "`tests/test_conformance.py::parse`"}, "there is no test"),
        ({"status": "partly"}, "has no note"),
        ({"status": "not applicable"}, "has no note"),
        ({"status": "not yet", "where": ""}, ""),
    ],
)
def test_a_fault_is_found(changes: dict[str, str], fault: str) -> None:
    """The checks above can fail: one change to a sound row, one fault."""
    sound = {"manual": "9.3", "item": "STA", "status": "yes", "where": THIS_TEST, "note": ""}
    found = "; ".join(faults_of(Row(chapter=9, line=1, **(sound | changes))))
    assert (fault in found) if fault else found == ""


def test_a_repeated_row_is_found() -> None:
    """Repeats are found whatever their case."""
    line = "| 9.3 | STA | yes | | |"
    assert repeated(parse(f"# Conformance, section 9: Messages\n{line}\n{line.replace('STA', 'sta')}")) == [
        "9.3 sta"
    ]


def test_a_row_with_a_missing_cell_is_refused() -> None:
    """A broken table line is an error, not a skipped row."""
    with pytest.raises(ValueError, match="line 2: 4 cells"):
        parse("# Conformance, section 9: Messages\n| 9.3 | STA | yes | |")


def test_the_table_of_the_later_versions_is_sound_and_counted():
    """Its rows name tests that exist, and the counts above it are right."""
    text = (ROOT / "docs" / "conformance-udk.md").read_text(encoding="utf-8")
    lines = [cells_of(line) for line in text.splitlines() if line.startswith("|")]
    rows = lines[lines.index(["part", *COLUMNS[1:]]) + 2 :]
    counts = Counter(row[2] for row in rows)
    assert lines[0] == [*STATUSES, "rows"]
    assert lines[2] == [str(number) for number in (*(counts[status] for status in STATUSES), len(rows))]
    for _, item, status, where, note in rows:
        tests = NAMED_TEST.findall(where)
        assert status in STATUSES, item
        assert bool(tests) == (status in ("yes", "partly")), item
        assert all(name in functions_in(ROOT / file) for file, name in tests), item
        assert note or status != "partly", item
    assert len({(row[0], row[1]) for row in rows}) == len(rows)


LATER_WORDS = (
    *(
        "INIT",
        "GETSTARTPOSES",
        "CONTROL",
        "TEST",
        "DRIVE",
        "GETGEO",
        "GETCONF",
        "SET",
        "MISPKG",
        "ACT",
        "MOVE",
    ),
    *("NFO", "STA", "ASTA", "MISSTA", "SEN", "GEO", "CONF", "RES", "EFF", "DIE"),
    *("Accel", "AcceleroMeter", "Acoustic", "AltitudeSensor", "Battery", "TouchArray", "Encoder", "GPS"),
    *("GroundTruth", "SICK", "HokuyoURG04LX", "IMU", "INS", "IR2", "IRScanner", "KinectDepth", "LineLaser"),
    *("MagneticCompass", "MissionTime", "ObjectSensor", "Odometry", "RangeSensorArray", "RangeScanner"),
    *("RotatingPointCloudScanner", "Tachometer", "Camera", "Gripper", "Actuator", "Joint"),
    *("AbsMove", "RelMove", "Create", "Kill", "KillAll", "GetSTA", "Conveyor", "Rotate", "AddWP", "ClearWP"),
    *("SetWP", "USARTruth", "ComServer", "ComServerInterface", "UPIS", "MultiView"),
)
"""Heads of BotConnection.uc, of what the classes send, and types of USARSensor, USARActuator and CONTROL."""


def test_each_command_message_and_type_of_the_later_versions_has_a_row():
    text = (ROOT / "docs" / "conformance-udk.md").read_text(encoding="utf-8")
    cells = [cell for line in text.splitlines() if line.startswith("|") for cell in cells_of(line)[:2]]
    words = {word for cell in cells for word in re.findall(r"\w+", cell)}
    assert [word for word in LATER_WORDS if word not in words] == []
