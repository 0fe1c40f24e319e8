"""A policy as a folder: a card, its configuration, and weights that are read back to the bit."""

import json

import numpy as np
import pytest
import yaml

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.export import export_run
from usarmjx.train.policies.policy_file import read_arrays
from usarmjx.train.policies.sources import load_policy

TASK = "drive-to-goal"


def test_a_folder_has_a_card_a_configuration_and_the_weights(tmp_path):
    folder = tmp_path / "goal.policy"
    export_run(TASK, folder)
    assert sorted(path.name for path in folder.iterdir()) == ["README.md", "config.json", "policy.npz"]
    about, arrays = read_arrays(POLICIES.get(TASK))
    kept, same = read_arrays(folder / "policy.npz")
    assert kept == about
    assert all(np.array_equal(same[name], array) for name, array in arrays.items())
    assert json.loads((folder / "config.json").read_text()) == {"library": "usarmjx", **about}
    _, front, text = (folder / "README.md").read_text().split("---\n", 2)
    assert yaml.safe_load(front)["library_name"] == "usarmjx"
    assert f"# Policy for {TASK}" in text
    assert "| P2AT | 20 | 2 |" in text


def test_a_folder_of_any_name_is_a_policy(tmp_path):
    export_run(TASK, tmp_path / "goal.policy")
    moved = (tmp_path / "goal.policy").rename(tmp_path / "from a hub")
    found = load_policy(str(moved))
    assert (found.task, found.name) == (TASK, str(moved))
    assert found.learned is not None


def test_a_file_is_no_place_for_a_folder(tmp_path):
    (tmp_path / "goal.policy").touch()
    with pytest.raises(UsageError, match="is a file"):
        export_run(TASK, tmp_path / "goal.policy")


def test_the_closest_packaged_policy_is_named():
    with pytest.raises(UnknownNameError, match="did you mean 'explore-v3'"):
        load_policy("expore")
