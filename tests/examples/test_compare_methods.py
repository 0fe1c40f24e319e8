"""The example that compares three methods with five runs each: its file stands for them, and gives a PDF."""

import numpy as np

from tests.scripts import EXAMPLES
from usarmjx import POLICIES
from usarmjx.sweeps.figures import plot_sweep
from usarmjx.sweeps.report import report
from usarmjx.sweeps.run import prepare
from usarmjx.sweeps.spec import load_spec
from usarmjx.sweeps.store import CellRecord, read_sweep, write_cell, write_sweep

METHODS = {"gamma 0.98": 0.8, "gamma 0.5": 0.4, "imitation first": 0.9}
RUNS = {"long": 0.1, "short": 0.2, "imitation": 0.3}
"""Noise on the packaged policy's weights, which stands for a training in the folders of the file's runs."""


def write_runs(folder):
    """Write five policies for each method, and return their files."""
    with np.load(POLICIES.get("drive-to-goal")) as file:
        arrays = dict(file)
    files = []
    for number, (name, noise) in enumerate(RUNS.items()):
        for run in range(5):
            draw = np.random.default_rng(5 * number + run)
            place = folder / name / f"seed-{run}"
            place.mkdir(parents=True)
            files.append(place / "policy.npz")
            made = {
                key: (one * (1.0 + noise * draw.standard_normal(one.shape))).astype(one.dtype)
                for key, one in arrays.items()
                if key.startswith("weights/")
            }
            np.savez(files[-1], **{**arrays, **made})
    return files


def test_three_methods_with_five_runs_become_a_pdf(tmp_path, monkeypatch):
    """Scores are made up; the design, the comparison and the figure are those of the file."""
    monkeypatch.chdir(tmp_path)
    files = write_runs(tmp_path / "runs")
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
    assert "imitation first" in report(found)
    (figure,) = plot_sweep(found, tmp_path / "methods.pdf")
    assert figure.read_bytes().startswith(b"%PDF")
