"""Records of runs of `examples/marl`: all seeds, scores by episodes, time with the compilation."""

import json

import pytest

from benchmarks.marl import main, records_of
from usarmjx.base.errors import UsageError


@pytest.fixture
def runs(tmp_path):
    """Two seeds of four iterations of 100 steps; in the first no episode ends."""
    for seed in (0, 1):
        folder = tmp_path / f"ippo-{seed}"
        folder.mkdir()
        flags = {"task": "explore-v2", "num_worlds": 8, "seed": seed, "out": str(folder)}
        (folder / "run.json").write_text(json.dumps({"algorithm": "ippo", "flags": flags}))
        lines = [
            {"iteration": 1, "agent_steps": 100, "steps_per_s": 2.0, "episodes": 0, "score": None},
            {"iteration": 2, "agent_steps": 200, "steps_per_s": 50.0, "episodes": 1, "score": 4.0},
            {"iteration": 3, "agent_steps": 300, "steps_per_s": 100.0, "episodes": 1, "score": 6.0},
            {"iteration": 4, "agent_steps": 400, "steps_per_s": 100.0, "episodes": 3, "score": 8.0 + seed},
        ]
        (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return tmp_path


def test_a_record_has_all_seeds_of_an_algorithm(runs):
    (record,) = records_of(runs)
    assert record["case"] == {"algorithm": "ippo", "task": "explore-v2", "worlds": 8}
    assert [seed["seed"] for seed in record["seeds"]] == [0, 1]
    first = record["seeds"][0]
    assert first["seconds"] == 100 / 2 + 100 / 50 + 1 + 1
    assert first["score"] == 8.0  # of the last quarter: one iteration
    assert first["curve"] == [[200, 4.0, 52.0], [300, 6.0, 53.0], [400, 8.0, 54.0]]
    assert record["seeds"][1]["score"] == 9.0


def test_records_and_figure_are_written(runs, tmp_path, capsys):
    records, figure = tmp_path / "marl.jsonl", tmp_path / "curves.png"
    main([str(runs), "--json", str(records), "--plot", str(figure)])
    assert "scores [8.0, 9.0]" in capsys.readouterr().out
    assert json.loads(records.read_text())["benchmark"] == "marl"
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_a_folder_without_runs_is_refused(tmp_path):
    with pytest.raises(UsageError, match="has no runs"):
        records_of(tmp_path)


def test_a_run_without_an_ended_episode_is_refused(runs):
    lines = runs / "ippo-0" / "metrics.jsonl"
    lines.write_text(
        json.dumps({"iteration": 1, "agent_steps": 100, "steps_per_s": 1.0, "episodes": 0, "score": None})
    )
    with pytest.raises(UsageError, match="no episode has ended"):
        records_of(runs)
