"""Fifteen policies for `compare_methods.yaml`, made in a second: three methods with five runs each.

    python examples/compare_methods.py
    usarmjx sweep examples/compare_methods.yaml --out sweeps/methods --figure methods.pdf
    usarmjx sweep report sweeps/methods

In place of trainings, each run has the weights of the packaged policy with noise of its own.
Runs of `usarmjx train TASK --seed N --out runs/...` are named in the file the same way.
"""

from pathlib import Path
from typing import Any

import numpy as np

from usarmjx import POLICIES

METHODS = {"packaged": 0.02, "small": 0.2, "large": 0.6}
"""Standard deviation of the factor of each weight, by the beginning of the names of files."""
RUNS = 5


def disturbed(arrays: dict[str, np.ndarray], noise: float, seed: int) -> dict[str, Any]:
    """Return the arrays of a policy with noise on its weights."""
    draw = np.random.default_rng(seed)
    return {
        name: (one * (1.0 + noise * draw.standard_normal(one.shape))).astype(one.dtype)
        if name.startswith("weights/")
        else one
        for name, one in arrays.items()
    }


def write_runs(folder: Path, task: str = "drive-to-goal") -> list[Path]:
    """Write the policies of all methods, and return their files."""
    with np.load(POLICIES.get(task)) as file:
        arrays = dict(file)
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    for number, (name, noise) in enumerate(METHODS.items()):
        for run in range(RUNS):
            files.append(folder / f"{name}-{run}.npz")
            np.savez(files[-1], **disturbed(arrays, noise, RUNS * number + run))
    return files


if __name__ == "__main__":
    for written in write_runs(Path("runs")):
        print(f"wrote {written}")
