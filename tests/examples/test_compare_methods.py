"""The example that compares three methods with five runs each: its file stands for them, and gives a PDF."""

import numpy as np

from tests.scripts import EXAMPLES, load
from usarmjx.sweeps.figures import plot_sweep
from usarmjx.sweeps.report import report
from usarmjx.sweeps.run import prepare
from usarmjx.sweeps.spec import load_spec
from usarmjx.sweeps.store import CellRecord, read_sweep, write_cell, write_sweep

METHODS = {"packaged": 0.9, "noise 0.2": 0.8, "noise 0.6": 0.4}


def test_three_methods_with_five_runs_become_a_pdf(tmp_path, monkeypatch):
    """Scores are made up; the design, the comparison and the figure are those of the file."""
    monkeypatch.chdir(tmp_path)
    files = load("compare_methods").write_runs(tmp_path / "runs")
    assert len({file.read_bytes() for file in files}) == 15
    file = EXAMPLES / "compare_methods.yaml"
    assert len(file.read_text().splitlines()) <= 20
    spec = load_spec(file, {"episodes": 4})
    prepared = prepare(spec, tmp_path)
    assert not prepared.broken
    assert (
        prepared.plan.as_text() == "45 cells in 1 batch of 45, 1 compilation: the cells differ in data only"
    )
    write_sweep(tmp_path, spec.name, spec.about, spec.axes, prepared.keys)
    draw = np.random.default_rng(0)
    for (key, settings), labels in zip(prepared.cells, prepared.buildings, strict=True):
        scores = tuple(METHODS[settings["method"]] + draw.normal(0.0, 0.05, 4))
        write_cell(
            tmp_path,
            CellRecord(
                key=key,
                settings=settings,
                scores=scores,
                steps=(9,) * 4,
                bad=(False,) * 4,
                split="test",
                buildings=labels,
            ),
        )
    found = read_sweep(tmp_path)
    assert "noise 0.6" in report(found)
    (figure,) = plot_sweep(found, tmp_path / "methods.pdf")
    assert figure.read_bytes().startswith(b"%PDF")
