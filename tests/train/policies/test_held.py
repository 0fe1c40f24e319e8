"""Policy files are looked at before they are unpacked: what would be large or does not fit is refused."""

import io
import json
import zipfile

import numpy as np
import pytest

from tests.train.handmade import policy_file as written_policy
from usarmjx.base import npz_file
from usarmjx.base.errors import UsageError
from usarmjx.train.policies import policy_file
from usarmjx.train.policies.policy_file import NumpyPolicy


def refused(file, says):
    with pytest.raises(UsageError, match=says) as caught:
        NumpyPolicy(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def rewritten(file, **changes):
    """The handmade policy with other arrays; None: without it."""
    with np.load(written_policy(file)) as found:
        arrays = {**found, **{name.replace("__", "/"): value for name, value in changes.items()}}
    np.savez(file, **{name: array for name, array in arrays.items() if array is not None})
    return file


def test_a_small_file_that_becomes_large_is_not_unpacked(tmp_path, monkeypatch):
    file = tmp_path / "a.npz"
    np.savez_compressed(file, about=np.array("{}"), large=np.zeros(16_000_001, np.float32))
    monkeypatch.setattr(npz_file.npy, "read_array", None)
    size = file.stat().st_size
    assert size < 100_000
    refused(file, rf"has {size} bytes and becomes 64\d+; at most 8000000")
    monkeypatch.setattr(policy_file, "MOST_RATIO", 1e9)
    refused(file, "at most 64000000")


def test_a_shape_that_the_file_does_not_fill_is_not_allocated(tmp_path, monkeypatch):
    """Its header says a terabyte, its member holds a few bytes."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f4", "fortran_order": False, "shape": (1 << 38,)}
    )
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as out:
        out.writestr("x.npy", header.getvalue() + bytes(16))
    monkeypatch.setattr(npz_file.npy, "read_array", None)
    refused(tmp_path / "a.npz", r"array 'x' of shape \(274877906944,\) takes \d+ bytes, it has 144")


def test_a_name_of_thousands_of_characters_is_quoted_in_short(tmp_path):
    file = written_policy(tmp_path / "a.npz")
    data = bytearray(file.read_bytes())
    data[26:28] = (4000).to_bytes(2, "little")  # the length of the first member's name
    file.write_bytes(data)
    with pytest.raises(UsageError, match="is no policy of usarmjx: File name in directory") as caught:
        NumpyPolicy(file)
    assert len(str(caught.value)) < 400 + len(str(file))


ABOUT = {
    "task": "t",
    "overrides": {},
    "period": 0.2,
    "groups": [{"name": "P2AT", "agents": ["P2AT0"], "obs_size": 4, "action_size": 2}],
    "layers": 1,
    "memory": 0,
    "format": 1,
}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"layers": 10**12}, "its layers is 1000000000000"),
        ({"layers": 2}, "layer_1/bias"),
        ({"layers": "1"}, "its layers is a str"),
        ({"layers": True}, "its layers is a bool"),
        ({"memory": -1}, "its memory is -1"),
        ({"memory": 10**7}, "gates"),
        ({"period": float("nan")}, "its period is above 0"),
        ({"groups": []}, "it has groups"),
        ({"groups": [3]}, "its group is a int"),
        ({"groups": [{"name": "P2AT"}]}, "a group has name, expected name, agents, obs_size, action_size"),
        ({"groups": [{**ABOUT["groups"][0], "agents": [1]}]}, "its agents are texts"),
        ({"groups": [{**ABOUT["groups"][0], "obs_size": 5}]}, r"'mean/0' has the shape \(4,\), not \(5,\)"),
        ({"groups": [{**ABOUT["groups"][0], "action_size": 3}]}, r"head/kernel' has the shape"),
        ({"overrides": {"a": 1}}, "its overrides are texts"),
        ({"format": 2}, "written by another version"),
    ],
)
def test_what_a_policy_says_of_itself_must_fit(change, says, tmp_path):
    refused(rewritten(tmp_path / "a.npz", about=np.array(json.dumps({**ABOUT, **change}))), says)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"about": None}, "it has no `about`"),
        ({"about": np.array("[" * 100_000)}, "is no policy"),
        ({"about": np.zeros(3)}, "is of type float64"),
        ({"mean__0": None}, "mean/0"),
        ({"mean__0": np.full(4, np.nan, np.float32)}, "'mean/0' has numbers that are not finite"),
        ({"weights__0__head__kernel": np.zeros((2, 5), np.float32)}, r"shape \(2, 5\), not \(2, 4\)"),
        ({"weights__0__gates__kernel": np.zeros((2, 5), np.float32)}, "belongs to no layer"),
        ({"mean__0": np.array(["x"] * 4)}, "is of type <U1; expected floating-point numbers"),
        ({"mean__0": np.array([{}] * 4, object)}, "is of type object"),
        ({f"x{i}": np.zeros(1, np.float32) for i in range(1001)}, "a policy has at most 1000"),
    ],
)
def test_arrays_that_do_not_fit_are_named(changes, says, tmp_path):
    refused(rewritten(tmp_path / "a.npz", **changes), says)
