"""The leaderboard of this checkout: its files are whole, its page is made of them, its entries play again."""

from pathlib import Path

import numpy as np
import pytest

from usarmjx.sweeps.spec import find_suite
from usarmjx.sweeps.standings import leaderboard_page, replay
from usarmjx.sweeps.suite import SUFFIX, load_suite, read_result, read_results, run_digest

ROOT = Path(__file__).resolve().parents[2]
FOLDER, PAGE = ROOT / "leaderboard", ROOT / "docs" / "leaderboard.md"
FILES = sorted(FOLDER.glob(f"*{SUFFIX}"))
TOLERANCE = 0.25
"""Share of replayed buildings whose score may differ: other versions and processors round otherwise."""


def test_the_page_is_made_of_the_files():
    """Write it anew with: usarmjx suite leaderboard."""
    assert PAGE.read_text(encoding="utf-8") == leaderboard_page(read_results([FOLDER]))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name.removesuffix(SUFFIX))
def test_an_entry_names_everything_that_plays_it_again(file):
    one = read_result(file)
    suite = load_suite(find_suite(one.suite))
    assert (one.suite_digest, one.split) == (suite.digest, "test")
    spec = suite.spec("test", one.method, [one.run])
    assert len(one.cells) == len(spec.cells)
    assert {cell.settings["episodes"] for cell in one.cells} == {suite.file.episodes.test}
    assert one.commit != "unknown"
    assert one.policies == {task: run_digest(one.run, task) for task in one.policies}


@pytest.mark.thorough
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name.removesuffix(SUFFIX))
def test_three_buildings_of_each_entry_play_again(file, monkeypatch):
    monkeypatch.chdir(ROOT)
    one = read_result(file)
    again = replay(one, load_suite(find_suite(one.suite)), 3)
    assert all(cell.same_buildings for cell in again)
    before, after = (np.concatenate([getattr(cell, name) for cell in again]) for name in ("before", "after"))
    differs = ~np.isclose(before, after, rtol=1e-3, atol=1e-3)
    assert differs.mean() <= TOLERANCE, (before, after)
