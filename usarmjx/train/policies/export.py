"""A policy as one small file, and its inference in plain NumPy: what a robot's client needs, and no more.

The file is NumPy's `.npz`: `about` is JSON (format, task, period, groups, layers), the other arrays are
`mean/0`, `std/0` and the weights of group 0 (`weights/0/layer_0/kernel`), and so on, in single precision or
the weights in half. This module imports neither JAX nor anything that needs it.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import write_beside
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.held import FORMAT, check_about, check_shapes, read_arrays

if TYPE_CHECKING:
    from usarmjx.train.learning.networks import LearnedPolicy, PolicyParams
    from usarmjx.train.learning.record import RunRecord

MAX_NORMALISED = 10.0  # as in `statistics`
MIN_STD = 0.01  # as in `networks`

Vector = np.ndarray
ParamTree = Mapping[str, Any]


def _sigmoid(x: Vector) -> Vector:
    return 0.5 * (1.0 + np.tanh(0.5 * x))


def _elu(x: Vector) -> Vector:
    return np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))


def _dense(layer: ParamTree, x: Vector) -> Vector:
    return x @ layer["kernel"] + layer["bias"]


def forward(weights: ParamTree, layers: int, x: Vector, carry: Vector) -> tuple[Vector, Vector]:
    """Return what a policy's network says (..., outputs), and the carry after it (..., memory).

    Args:
        weights: Of the network, by layer.
        layers: Number of hidden layers.
        x: Normalised observations (..., n).
        carry: That before it (..., memory).
    """
    for i in range(layers):
        x = _elu(_dense(weights[f"layer_{i}"], x))
    if "gates" in weights:
        reset, update, new = np.split(_dense(weights["gates"], x), 3, axis=-1)
        own_reset, own_update, own_new = np.split(carry @ weights["recurrent"], 3, axis=-1)
        update = _sigmoid(update + own_update)
        new = np.tanh(new + _sigmoid(reset + own_reset) * (own_new + weights["recurrent_bias"]))
        x = carry = (1.0 - update) * new + update * carry
    return _dense(weights["head"], x), carry


class NumpyPolicy:
    """A policy from a file.

    Args:
        file: Written by `save_policy`.

    Attributes:
        task: Name of the task that it was trained for.
        period: Simulated time between two actions [s].
        groups: Of each group `name`, `agents`, `obs_size`, `action_size`.
        memory: Units of memory of each robot; 0: none.
        overrides: Fields of the task that were set otherwise in training, as typed.
        layers: Number of hidden layers.
        weights: Per group a tree of weights.
        mean: Of the observations in training, per group (obs_size,).
        std: Their deviation, per group (obs_size,).

    Raises:
        UsageError: The file is no policy, or is broken.
    """

    def __init__(self, file: str | Path) -> None:
        about, arrays = read_arrays(Path(file))
        try:
            if about["format"] != FORMAT:
                raise UsageError(f"{file} was written by another version of usarmjx")
            check_about(about)
            check_shapes(about, arrays)
            self.task, self.period = about["task"], about["period"]
            self.overrides: dict[str, str] = about["overrides"]
            self.groups: list[dict[str, Any]] = about["groups"]
            self.memory, self.layers = about["memory"], about["layers"]
            self.mean = [arrays[f"mean/{g}"] for g in range(len(self.groups))]
            self.std = [arrays[f"std/{g}"] for g in range(len(self.groups))]
            self.weights = [_tree(arrays, f"weights/{g}/") for g in range(len(self.groups))]
        except (KeyError, ValueError, TypeError) as error:
            raise UsageError(f"{file} is no policy of usarmjx: {error}") from error

    def group(self, name: str) -> int:
        """Return the number of the group of a robot class, case ignored.

        Raises:
            UsageError: The policy has none; lists those it has.
        """
        known = [one["name"] for one in self.groups]
        for index, one in enumerate(known):
            if one.lower() == name.lower():
                return index
        raise UsageError(f"this policy is not for {name}; it is for: {', '.join(known)}")

    def initial_carry(self, group: int, *shape: int) -> Vector:
        """Return the carry of a group's robots at first (*shape, memory)."""
        return np.zeros((*shape, self.memory), np.float32)

    def act(
        self, group: int, obs: Vector, carry: Vector, draw: np.random.Generator | None = None
    ) -> tuple[Vector, Vector]:
        """Return actions of a group's robots, and the carry after them.

        Args:
            group: Number of the group.
            obs: What they observe (..., obs_size).
            carry: That before them (..., memory).
            draw: Where random numbers come from; None: the most probable actions are taken.

        Raises:
            UsageError: Observations of another size.
        """
        obs, mean, std = np.asarray(obs, np.float32), self.mean[group], self.std[group]
        if obs.shape[-1:] != mean.shape:
            raise UsageError(f"observations have {obs.shape[-1:]} numbers, this policy needs {mean.shape}")
        seen = np.clip((np.where(np.isfinite(obs), obs, mean) - mean) / std, -MAX_NORMALISED, MAX_NORMALISED)
        logits, carry = forward(self.weights[group], self.layers, seen, carry)
        loc, scale = np.split(logits, 2, axis=-1)
        if draw is not None:
            deviation = np.logaddexp(scale, 0.0) + MIN_STD
            loc = loc + deviation * draw.standard_normal(loc.shape, np.float32)
        return np.tanh(loc), carry


def _tree(arrays: Mapping[str, Vector], start: str) -> dict[str, Any]:
    """Return the arrays whose names begin so, nested by the parts of their names."""
    found: dict[str, Any] = {}
    for name, array in arrays.items():
        if name.startswith(start):
            *path, last = name.removeprefix(start).split("/")
            branch = found
            for part in path:
                branch = branch.setdefault(part, {})
            branch[last] = array
    return found


def _flat(tree: ParamTree, start: str) -> dict[str, Vector]:
    found: dict[str, Vector] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            found |= _flat(cast(ParamTree, value), f"{start}{name}/")
        else:
            found[f"{start}{name}"] = np.asarray(value)
    return found


def save_policy(
    file: str | Path,
    policy: "LearnedPolicy",
    params: "PolicyParams",
    record: "RunRecord",
    half: bool = False,
) -> None:
    """Write a policy to a file, which `NumpyPolicy` reads.

    Args:
        file: To write.
        policy: Its network.
        params: Weights and statistics.
        record: What it was trained for.
        half: Write weights as numbers of 16 bits, rounded by up to 2^-11 of themselves.

    Raises:
        WriteError: The file cannot be written.
    """
    about = {
        "format": FORMAT,
        "task": record.task,
        "overrides": record.overrides,
        "period": record.period,
        "groups": [vars(group) for group in policy.groups],
        "layers": len(policy.layers),
        "memory": policy.memory,
    }
    arrays: dict[str, Any] = {"about": np.array(json.dumps(about))}
    for g in range(len(policy.groups)):
        arrays[f"mean/{g}"], arrays[f"std/{g}"] = np.asarray(params.mean[g]), np.asarray(params.std[g])
        arrays |= _flat(params.weights[g]["params"], f"weights/{g}/")
    _write_arrays(file, arrays, half)


def _write_arrays(file: str | Path, arrays: Mapping[str, Vector], half: bool) -> None:
    """Write what a policy's file has, weights as numbers of 16 bits if wanted."""
    kept = {
        name: arrays[name].astype(np.float16) if half and name.startswith("weights/") else arrays[name]
        for name in sorted(arrays)
    }
    with write_beside(Path(file)) as fresh, fresh.open("wb") as out:
        np.savez_compressed(out, **cast(Any, kept))


def export_run(run: str | Path, file: str | Path, which: str = "best", half: bool = False) -> None:
    """Write the policy of a run, or a packaged one, to a file.

    Args:
        run: Folder of the run; or, where there is none of that name, the task of a packaged policy.
        file: To write.
        which: Checkpoint: `best`, `last`, or the number of an iteration.
        half: See `save_policy`.

    Raises:
        UsageError: No run, no such checkpoint, a broken one, or a file that cannot be written.
    """
    if str(run) in POLICIES and not Path(run).exists():
        about, arrays = read_arrays(POLICIES.get(str(run)))
        _write_arrays(file, {"about": np.array(json.dumps(about)), **arrays}, half)
        return
    from usarmjx.train.learning.checkpoint import load_policy  # which the extra `train` is for

    save_policy(file, *load_policy(Path(run), which), half=half)
