"""`usarmjx.evaluate`: the rows are the episodes that `evaluate_episodes` plays, and the mean is theirs."""

import numpy as np
import pandas as pd
import pytest

import usarmjx
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.train.evaluation.evaluate import evaluate_episodes
from usarmjx.train.policies.sources import baseline

SHORT = {"ranges": (), "pose": "GroundTruth", "episode_steps": 5}


def test_the_rows_are_the_episodes_of_each_seed():
    table = usarmjx.evaluate(task="drive-to-goal", engine="c", worlds=2, episodes=4, seeds=2, settings=SHORT)
    assert isinstance(table, pd.DataFrame)
    pairs = [f"{name}={value or ''}" for name, value in SHORT.items()]
    env, policy, _ = baseline("drive-to-goal").env(pairs, worlds=2, engine="c")
    found = evaluate_episodes(env, policy, 4, (0, 1))
    assert table["score"].tolist() == np.concatenate([run.scores for run in found.episodes]).tolist()
    assert table["steps"].tolist() == [5] * 8
    assert table["seed"].tolist() == [0] * 4 + [1] * 4
    assert set(map(tuple, table[["world", "episode"]].values)) == {(0, 0), (0, 1), (1, 0), (1, 1)}
    assert set(table["building"]) == {-1}
    assert table.attrs["score"]["mean"] == found.score.value == table["score"].mean()
    assert set(table["policy"]) == set(table["task"]) == {"drive-to-goal"}


def test_a_packaged_policy_has_its_name_and_no_path():
    table = usarmjx.evaluate("drive-to-goal", engine="c", worlds=2, episodes=2, settings={"episode_steps": 5})
    assert set(table["policy"]) == {"drive-to-goal"}


def test_what_is_no_policy_is_refused():
    with pytest.raises(UsageError, match="name a policy, or a task for its baseline"):
        usarmjx.evaluate()
    with pytest.raises(UnknownNameError, match="nowhere is no folder of a run"):
        usarmjx.evaluate("nowhere")
    with pytest.raises(UsageError, match="none of the split test"):
        usarmjx.evaluate(task="drive-to-goal", split="test", engine="c")
