"""A small sweep that several tests look at: 12 cells on C MuJoCo, played in one go."""

import os

import numpy as np
import pytest
import yaml

from tests.train.handmade import policy_file
from usarmjx.sweeps.run import run_sweep
from usarmjx.sweeps.spec import load_spec

SMALL = {
    "about": "Twelve cells of driving to a goal.",
    "worlds": 4,
    "common": {
        "task": "drive-to-goal",
        "engine": "c",
        "episodes": 2,
        "arena": {"kind": "maze", "size": [3, 3]},
        "split": "train",  # whose walls are in the way of most robots
        "fields": {"ranges": [], "repeat": 2, "episode_steps": 40},
        "physics": {"timestep": 0.01, "substeps": 5},
    },
    "product": {"arena.level": [0.1, 0.9], "seed": [0, 1, 2]},
}

# Ray reads it once in a process; heads that tests start have no token.
os.environ["RAY_AUTH_MODE"] = "disabled"


def write(folder, name="small", **changes):
    """Write the small sweep with other parts, and return its file."""
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump({**SMALL, **changes}))
    return file


def weak(path):
    """Write the handmade policy with other weights: it hardly turns."""
    arrays = dict(np.load(policy_file(path)))
    arrays["weights/0/head/kernel"] = arrays["weights/0/head/kernel"] * 0.3
    np.savez(path, **arrays)
    return path


@pytest.fixture(scope="package")
def rows(tmp_path_factory):
    """Two policies of one shape, on floors of different friction: what else the cells differ in."""
    folder = tmp_path_factory.mktemp("policies")
    files = policy_file(folder / "usual.npz"), weak(folder / "weak.npz")
    spans = [0.5, 1.5], 1.0
    return [{"policy": str(file), "vary.friction": span} for file, span in zip(files, spans, strict=True)]


@pytest.fixture(scope="package")
def whole(tmp_path_factory, rows):
    """The sweep as it is without anything in the way: its folder, what is in it, what was said."""
    folder, said = tmp_path_factory.mktemp("whole"), []
    found = run_sweep(load_spec(write(folder, list=rows)), folder / "out", say=said.append)
    return folder / "out", found, said
