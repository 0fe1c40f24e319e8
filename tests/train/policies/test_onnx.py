"""Policies as ONNX models: ONNX Runtime acts as NumPy does."""

import json
from typing import Any

import numpy as np
import onnxruntime
import pytest
from numpy.testing import assert_allclose

from usarmjx.base.errors import UsageError
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.export import export_run
from usarmjx.train.policies.policy_file import NumpyPolicy

TOLERANCE = 1e-5
"""Of an action, from -1 to 1: both compute in single precision, and sum in another order."""
ROBOTS, STEPS = 7, 3


@pytest.mark.parametrize("task", ["drive-to-goal", "victim-search-v2"])
def test_onnx_runtime_acts_as_numpy_does(task, tmp_path):
    """Also on observations that are not finite or far out, and with memory over some steps."""
    export_run(task, tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    policy, draw = NumpyPolicy(POLICIES.get(task)), np.random.default_rng(0)
    about = json.loads(session.get_modelmeta().custom_metadata_map["about"])
    assert (about["task"], about["groups"]) == (policy.task, policy.groups)
    carries = [policy.initial_carry(index, ROBOTS) for index in range(len(policy.groups))]
    fed = {f"{group['name']}.carry": carry for group, carry in zip(policy.groups, carries, strict=True)}
    fed = fed if policy.memory else {}
    for _ in range(STEPS):
        seen = [draw.normal(size=(ROBOTS, group["obs_size"])).astype(np.float32) for group in policy.groups]
        seen[0][0, 0], seen[0][1, 0], seen[0][2, 0] = np.nan, np.inf, 1e6
        fed |= {f"{group['name']}.obs": obs for group, obs in zip(policy.groups, seen, strict=True)}
        names = [one.name for one in session.get_outputs()]
        found: dict[str, Any] = dict(zip(names, session.run(None, fed), strict=True))
        for index, group in enumerate(policy.groups):
            action, carries[index] = policy.act(index, seen[index], carries[index])
            assert_allclose(found[f"{group['name']}.action"], action, atol=TOLERANCE)
            if policy.memory:
                fed[f"{group['name']}.carry"] = found[f"{group['name']}.next_carry"]
                assert_allclose(fed[f"{group['name']}.carry"], carries[index], atol=TOLERANCE)


def test_other_suffixes_are_refused(tmp_path):
    with pytest.raises(UsageError, match=r"a policy is written as \.npz or \.onnx, not as \.pt"):
        export_run("drive-to-goal", tmp_path / "policy.pt")
