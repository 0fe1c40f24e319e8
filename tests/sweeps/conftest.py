"""A small sweep that several tests look at: 12 cells on C MuJoCo, played in one go."""

import pytest
import yaml

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
        "fields": {"ranges": [], "repeat": 2, "episode_steps": 40},
        "physics": {"timestep": 0.01, "substeps": 5},
    },
    "product": {
        "arena.level": [0.1, 0.9],
        "seed": [0, 1, 2],
        "vary.friction": [[0.5, 1.5], 1.0],
    },
}


def write(folder, name="small", **changes):
    """Write the small sweep with other parts, and return its file."""
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump({**SMALL, **changes}))
    return file


@pytest.fixture(scope="package")
def whole(tmp_path_factory):
    """The sweep as it is without anything in the way: its folder, what is in it, what was said."""
    folder, said = tmp_path_factory.mktemp("whole"), []
    found = run_sweep(load_spec(write(folder)), folder / "out", say=said.append)
    return folder / "out", found, said
