"""docs/evidence/speed.md is what `usarmjx bench report` makes of the records; laws and tables are right."""

import json
import math

import pytest
from typer.testing import CliRunner

import dev
from benchmarks.report.figures import FIGURES, compared
from benchmarks.report.laws import laws_of, laws_table
from benchmarks.report.page import BLOCKS, differences_text, fill_page, is_drawn, physics_table
from benchmarks.report.records import BenchRecord, read_records
from benchmarks.report.tables import history_table, number, parts_table
from tests.benchmarks.records import faults
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app

RESULTS, PAGE = dev.ROOT / "benchmarks" / "results", dev.ROOT / "docs" / "evidence" / "speed.md"
STEP = {
    "benchmark": "step", "when": "2026-01-01T00:00:00+00:00", "device": "D", "commit": "c0", "versions": {},
    "case": {"worlds": 4, "robots": 2, "robot": "P2AT", "arena": "yellow", "engine": "c", "steps": 10},
    "robot_steps_per_s": 100.0, "bare_robot_steps_per_s": 200.0, "timestep": 0.005,
    "whole_times_s": [1.0, 1.0], "blind_times_s": [0.75], "bare_times_s": [0.5],
}  # fmt: skip


def step(commit="c0", worlds=4, seconds=1.0, rate=100.0):
    data = {**STEP, "commit": commit, "whole_times_s": [seconds], "robot_steps_per_s": rate}
    return BenchRecord("step.jsonl", {**data, "case": {**STEP["case"], "worlds": worlds}})


@pytest.fixture(scope="module")
def records():
    return read_records(RESULTS)


def test_the_page_is_what_the_command_makes(records):
    """After new records: `usarmjx bench report`."""
    text = PAGE.read_text(encoding="utf-8")
    assert fill_page(text, records) == text
    for name in BLOCKS:
        assert text.count(f"<!-- usarmjx bench report: {name} -->") == 1, name


@pytest.mark.parametrize("name", FIGURES)
def test_the_figures_are_of_these_records(name, records):
    assert is_drawn(PAGE.parent / name, records)
    assert not is_drawn(PAGE.parent / name, records[1:])
    assert f"({name})" in PAGE.read_text(encoding="utf-8")


def test_runs_of_peers_are_drawn_that_compare_and_that_no_later_one_covers():
    def run(when, who, sizes, device="G"):
        rows = [{"who": w, "worlds": n, "robots": 4, "speed": {}} for w in who for n in sizes]
        lost = {"who": "usarmjx", "worlds": 9, "robots": 4}
        data = {
            "benchmark": "peers",
            "when": f"{when}T00:00",
            "device": device,
            "commit": "",
            "rows": [*rows, lost],
        }
        return BenchRecord("peers.jsonl", data)

    both = "usarmjx", "VMAS"
    runs = [
        run("2026-01-01", both, [1, 2]),
        run("2026-01-02", both, [1]),
        run("2026-01-03", both, [1]),
        run("2026-01-04", ["VMAS"], [1, 2]),
        run("2026-01-05", both, [1, 2], device="H"),
    ]
    found = compared(runs)
    assert [name for name, _ in found] == [f"G, 2026-01-0{day} 00:00" for day in (1, 3)] + [
        "H, 2026-01-05 00:00"
    ]
    assert [len(rows) for _, rows in found] == [4, 2, 4], "not what was not measured"


def test_every_record_is_read_and_those_of_today_fit_the_schema(records):
    lines = sum(len(file.read_text().splitlines()) for file in RESULTS.glob("*.jsonl"))
    assert len(records) == lines
    of_today = [record for record in records if "form" in record.data]
    assert of_today
    assert {record.when: found for record in of_today if (found := faults(record.data))} == {}


def test_a_page_keeps_its_own_text_and_a_second_time_changes_nothing(tmp_path):
    results, page = tmp_path / "results", tmp_path / "page.md"
    results.mkdir()
    (results / "step.jsonl").write_text(json.dumps(STEP) + "\n")
    own = "# Title\n\nBy hand.\n\n<!-- usarmjx bench report: parts -->\nold\n<!-- end: parts -->\n\nAfter.\n"
    page.write_text(own)
    words = ["bench", "report", "--results", str(results), "--page", str(page)]
    first = CliRunner().invoke(app, words)
    assert first.exit_code == 0, first.output
    assert (
        "1 blocks of 1 records, changed; drawn: performance-laws.png, performance-peers.png" in first.output
    )
    text = page.read_text()
    assert text.startswith("# Title\n\nBy hand.\n\n<!--")
    assert text.endswith("-->\n\nAfter.\n")
    assert "old" not in text
    assert "| 100 | 50% | 25% | 25% |" in text
    assert "as they were; drawn: nothing" in CliRunner().invoke(app, words).output
    assert page.read_text() == text


def test_parts_of_a_step_add_up():
    assert "| 100 | 50% | 25% | 25% |" in parts_table([step()])


def test_settings_are_told_by_what_differs_in_their_newest_record():
    """With a number that went bad, and who does nothing otherwise; older ones of these settings are left."""
    settings = {"timestep": 0.01, "solver": "CG", "iterations": 8, "cone": "elliptic"}
    old = {
        **STEP, "benchmark": "physics", "settings": settings, "units": {"climb": "m", "push": "m"},
        "numbers": {"Hummer": {"climb": [0.25, 0.2], "push": [4.0, None]}, "P2AT": {"climb": [0.1, 0.1]}},
        "differing": [["Hummer", "climb"], ["Hummer", "push"], ["P2AT", "climb"]],
    }  # fmt: skip
    new = {**old, "when": "2026-01-02T00:00:00+00:00", "commit": "c1", "differing": old["differing"][:2]}
    other = {**new, "settings": {**settings, "iterations": 4}, "differing": []}
    text = differences_text([BenchRecord("p.jsonl", data) for data in (old, new, other)])
    assert "| Hummer | climb | 0.25 m | 0.2 m |" in text
    assert "| Hummer | push | 4 m | went bad |" in text
    assert "Nothing of P2AT." in text
    assert "iterations 4, cone elliptic (2026-01-02 00:00, commit c1)" in text
    assert "Nothing of Hummer, P2AT." in text
    assert "c0" not in text
    assert "| 1 of 3 |" in physics_table([BenchRecord("p.jsonl", new)])


def test_a_law_is_the_power_by_which_the_cost_grows():
    (law,) = laws_of([step(worlds=2, seconds=1.0), step(worlds=4, seconds=4.0), step(worlds=8, seconds=16.0)])
    assert (law.axis, law.sizes, law.costs) == ("worlds", (2, 4, 8), (100.0, 400.0, 1600.0))
    assert law.exponent == pytest.approx(2.0)
    assert laws_of([step(worlds=2), step(worlds=2)]) == []
    (two,) = laws_of([step(worlds=2, seconds=1.0), step(worlds=4, seconds=4.0)])
    assert math.isnan(two.exponent), "a line through two points is no law"
    assert "two sizes |" in laws_table([step(worlds=2, seconds=1.0), step(worlds=4, seconds=4.0)])


def test_the_history_of_a_case_is_told_by_commit():
    text = history_table([step("a1", rate=100.0), step("b2", rate=150.0), step("c3", worlds=8)])
    assert "100 (a1), 150 (b2) | 1.50 |" in text
    assert "c3" not in text


def test_numbers_have_three_digits_that_count():
    assert [number(x) for x in (None, 0.12345, 12.345, 123456.0)] == ["-", "0.123", "12.3", "123,456"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<!-- usarmjx bench report: love -->\n<!-- end: love -->", "no block is called 'love'; known: step"),
        ("<!-- usarmjx bench report: step -->\n", "markers of block 'step' do not match"),
    ],
)
def test_markers_that_are_wrong_are_told(text, message):
    with pytest.raises(UsageError, match=message):
        fill_page(text, [])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "a.jsonl, line 1: "),
        ('{"benchmark": "step"}', "line 1: has no 'when'"),
        (json.dumps({**STEP, "form": 3}), "line 1: form 3, which is newer than 2"),
    ],
)
def test_lines_that_are_no_records_are_told(line, message, tmp_path):
    (tmp_path / "a.jsonl").write_text(line + "\n")
    with pytest.raises(UsageError, match=message):
        read_records(tmp_path)
    with pytest.raises(UsageError, match="has no records"):
        read_records(tmp_path / "nowhere")
