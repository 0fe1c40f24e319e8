"""A policy as a small file or a folder with a card, and its inference in plain NumPy for a robot's client.

The file is NumPy's `.npz`: `about` is JSON (format, task, period, groups, layers), the other arrays are
`mean/0`, `std/0` and the weights of group 0 (`weights/0/layer_0/kernel`), and so on, in single precision or
the weights in half. This module imports neither JAX nor anything that needs it.

In a folder, as model hubs keep policies, `README.md` is the card: YAML that hubs index, then text.
`config.json` has the facts of the file for other programs. `policy.npz` is the file; it alone is read back.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from usarmjx.base.errors import UsageError, WriteError, quoted
from usarmjx.base.files import atomic_write
from usarmjx.base.npz_file import NpzLimits, read_npz
from usarmjx.base.settings.files import is_mapping
from usarmjx.base.settings.json_file import parse_json
from usarmjx.train.envs.layout import (
    NO_VECTOR,
    ActionVector,
    ObservationLayout,
    layout_from_record,
    layout_record,
    vector_from_record,
)
from usarmjx.train.policies.set_forward import KINDS, NumpyOperations, elu, set_outputs, set_shapes
from usarmjx.train.task_names import recorded_name

if TYPE_CHECKING:
    from usarmjx.train.envs.state import AgentGroup
    from usarmjx.train.learning.config import RunRecord
    from usarmjx.train.learning.networks import LearnedPolicy, PolicyParams


FORMAT = 1
MOST_BYTES = 64_000_000
"""Most bytes of a policy's arrays, unpacked."""
USUAL_BYTES, MOST_RATIO = 8_000_000, 100
"""Bytes that arrays may take however small their file is, and their largest ratio to the file beyond."""
MOST_ARRAYS = 1000
ABOUT = "about"
"""Name of the array with the facts, a text of JSON."""
SUFFIX = ".policy"
"""Suffix of a folder to write; one that is read may have any name."""
CARD, CONFIG, WEIGHTS = "README.md", "config.json", "policy.npz"


def read_arrays(file: Path) -> tuple[Any, dict[str, np.ndarray]]:
    """Return the facts under `about` in a policy's file, with the task's full name, and its other arrays.

    No array is read before all headers agree with the file, and with the limits.

    Raises:
        UsageError: The file is too large, or no policy.
    """
    limits = NpzLimits("policy", MOST_BYTES, USUAL_BYTES, MOST_RATIO, MOST_ARRAYS)
    try:
        found = read_npz(file, limits, lambda name: "U" if name == ABOUT else "f")
        about = parse_json(str(found.pop(ABOUT)), f"{file} is no policy of usarmjx: {ABOUT}", UsageError)
        if is_mapping(about) and isinstance(task := about.get("task"), str):
            # Earlier releases wrote bare names, for version 1 of a task.
            about = {**about, "task": recorded_name(task)}
        # Weights may be kept in 16 bits; all arithmetic is in 32.
        return about, {name: array.astype(np.float32) for name, array in found.items()}
    except UsageError:
        raise
    except KeyError:
        raise UsageError(f"{file} is no policy of usarmjx: it has no `about`") from None
    except Exception as error:  # zipfile and NumPy raise whatever they run into
        raise UsageError(f"{file} is no policy of usarmjx: {quoted(error)}") from error


def check_about(about: Any) -> None:  # noqa: ANN401 - whatever the file has
    """Check that a policy's file has all facts that a policy needs.

    Raises:
        ValueError: Something is missing, or of another kind; names it.
    """
    _check("about", about, dict, about)
    for key, kind in (("task", str), ("overrides", dict), ("period", int | float), ("groups", list)):
        _check(key, about, kind)
    for key in ("layers", "memory"):
        _check_whole(key, about)
    if not (0 < about["period"] < math.inf and about["groups"] and about["layers"]):
        raise ValueError("its period is above 0, and it has groups and layers")
    if about.get("network", "mlp") not in KINDS:
        raise ValueError(f"its network is {str(about['network'])[:40]}, expected {', '.join(KINDS)}")
    _check_texts("overrides", [*about["overrides"], *about["overrides"].values()])
    for group in about["groups"]:
        _check("group", group, dict, group)
        # Exactly these: `load_exported` passes them to AgentGroup as they are.
        if group.keys() - {"discrete", "layout", "vector"} != {"name", "agents", "obs_size", "action_size"}:
            raise ValueError(
                f"a group has {', '.join(sorted(group))[:100]}, expected name, agents, obs_size, action_size"
            )
        _check("name", group, str)
        _check("agents", group, list)
        _check_texts("agents", group["agents"])
        _check_whole("obs_size", group)
        _check_whole("action_size", group)
        if not isinstance(group.get("discrete", False), bool):
            raise ValueError("its discrete is true or false")
        if _vector(group).size and not group.get("discrete"):
            raise ValueError("its actions have a vector behind choices, but no choices")
        if about.get("network", "mlp") != "mlp":
            _check_layout(about, group)


def _vector(group: Mapping[str, Any]) -> ActionVector:
    """Return the numbers behind the choices of a group's actions."""
    return vector_from_record(group["vector"], group["action_size"]) if "vector" in group else NO_VECTOR


def _check_layout(about: Mapping[str, Any], group: Mapping[str, Any]) -> None:
    layout = layout_from_record(group.get("layout"))
    if problem := layout.misfit(group["obs_size"], group["action_size"] - _vector(group).size):
        raise ValueError(problem)
    if about["memory"] or not group.get("discrete"):
        raise ValueError(f"a network of kind {about['network']} has no memory, and chooses")
    if about["network"] == "cnn" and not layout.picture_size.size:
        raise ValueError("its network looks at a picture, but its layout has none")


def _check(key: str, held: Mapping[str, Any], kind: Any, value: Any = None) -> None:  # noqa: ANN401
    found = held[key] if value is None else value
    # A bool is an int in Python.
    if not isinstance(found, kind) or isinstance(found, bool):
        raise ValueError(f"its {key} is a {type(found).__name__}")


def _check_whole(key: str, held: Mapping[str, Any]) -> None:
    _check(key, held, int)
    # The upper limit keeps a forged size from asking for memory without end.
    if not 0 <= held[key] <= MOST_BYTES:
        raise ValueError(f"its {key} is {held[key]}")


def _check_texts(key: str, found: Sequence[Any]) -> None:
    if not all(isinstance(one, str) for one in found):
        raise ValueError(f"its {key} are texts")


def check_shapes(about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Check that a policy's arrays fit together, so that it can act.

    Raises:
        ValueError: An array has another shape than it must have; names it.
        KeyError: It is not there.
    """
    kind = about.get("network", "mlp")
    for g, group in enumerate(about["groups"]):
        width = group["obs_size"]
        wanted = {f"mean/{g}": (width,), f"std/{g}": (width,)}
        start = f"weights/{g}/"
        if kind == "mlp":
            shapes = _layer_shapes(about, group, arrays, start)
        else:
            first = ["own", *(f"layer_{i}" for i in range(1, about["layers"]))]
            widths = [arrays[f"{start}{name}/bias"].size for name in first]
            layout = layout_from_record(group["layout"])
            shapes = set_shapes(layout, widths, kind, 2 * _vector(group).size)
        wanted |= {start + name: shape for name, shape in shapes.items()}
        for name, shape in wanted.items():
            if arrays[name].shape != shape:
                raise ValueError(f"array {name!r} has the shape {arrays[name].shape}, not {shape}")
            if not np.isfinite(arrays[name]).all():
                raise ValueError(f"array {name!r} has numbers that are not finite")
        extra = [name for name in arrays if name.startswith(start) and name not in wanted]
        if extra:
            raise ValueError(f"array {extra[0][:60]!r} belongs to no layer")


def _layer_shapes(
    about: Mapping[str, Any], group: Mapping[str, Any], arrays: Mapping[str, np.ndarray], start: str
) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of layers over all numbers, by its name behind `start`."""
    wanted, width, memory = dict[str, tuple[int, ...]](), group["obs_size"], about["memory"]
    for i in range(about["layers"]):
        out = arrays[f"{start}layer_{i}/bias"].size
        wanted |= {f"layer_{i}/kernel": (width, out), f"layer_{i}/bias": (out,)}
        width = out
    if memory:
        wanted |= {"gates/kernel": (width, 3 * memory), "gates/bias": (3 * memory,)}
        wanted |= {"recurrent": (memory, 3 * memory), "recurrent_bias": (memory,)}
        width = memory
    # A continuous head returns a mean and a deviation for each action, and so does that of a vector.
    numbers = _vector(group).size if group.get("discrete") else group["action_size"]
    out = group["action_size"] + numbers
    return {**wanted, "head/kernel": (width, out), "head/bias": (out,)}


MAX_NORMALISED = 10.0  # as in `networks`
MIN_STD = 0.01  # as in `networks`
INVALID = -1e9  # as in `choices`
Vector = np.ndarray
ParamTree = Mapping[str, Any]


def _sigmoid(x: Vector) -> Vector:
    # By tanh, because exp(-x) overflows for large negative x.
    return 0.5 * (1.0 + np.tanh(0.5 * x))


def _dense(layer: ParamTree, x: Vector) -> Vector:
    return x @ layer["kernel"] + layer["bias"]


def forward(weights: ParamTree, layers: int, x: Vector, carry: Vector) -> tuple[Vector, Vector]:
    """Return the outputs of a policy's network (..., outputs), and the carry after it (..., memory).

    Args:
        weights: Weights of the network, by layer.
        layers: Number of hidden layers.
        x: Normalised observations (..., n).
        carry: That before it (..., memory).
    """
    for i in range(layers):
        x = elu(_dense(weights[f"layer_{i}"], x))
    if "gates" in weights:
        reset, update, new = np.split(_dense(weights["gates"], x), 3, axis=-1)
        own_reset, own_update, own_new = np.split(carry @ weights["recurrent"], 3, axis=-1)
        update = _sigmoid(update + own_update)
        # The reset gate acts after the product, with a bias inside: the GRU of Flax and cuDNN, not of the
        # paper.
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
        groups: For each group `name`, `agents`, `obs_size`, `action_size`.
        memory: Units of memory of each robot; 0: none.
        overrides: Overridden fields of the task in training, as typed.
        layers: Number of hidden layers.
        network: Kind of the networks, one of `KINDS`.
        layouts: Per group the parts of observations that its network reads; None: all numbers alike.
        vectors: Per group the numbers of an action behind those of its choices.
        weights: Per group a tree of weights.
        mean: Mean of the observations in training, per group (obs_size,).
        std: Their deviation, per group (obs_size,).

    Raises:
        UsageError: The file is no policy, or is broken.
    """

    def __init__(self, file: str | Path) -> None:
        about, arrays = read_arrays(Path(file))
        try:
            # First: another version's facts would look like faults.
            if about["format"] != FORMAT:
                raise UsageError(f"{file} was written by another version of usarmjx")
            check_about(about)
            check_shapes(about, arrays)
            self.task, self.period = about["task"], about["period"]
            self.overrides: dict[str, str] = about["overrides"]
            self.groups: list[dict[str, Any]] = about["groups"]
            self.memory, self.layers = about["memory"], about["layers"]
            self.network: str = about.get("network", "mlp")
            self.layouts: list[ObservationLayout | None] = [
                None if self.network == "mlp" else layout_from_record(group["layout"])
                for group in self.groups
            ]
            self.vectors = [_vector(group) for group in self.groups]
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

    @property
    def max_normalised(self) -> float:
        """Largest magnitude of a normalised observation."""
        return MAX_NORMALISED

    def initial_carry(self, group: int, *shape: int) -> Vector:
        """Return the carry of a group's robots at first (*shape, memory)."""
        return np.zeros((*shape, self.memory), np.float32)

    def act(
        self, group: int, obs: Vector, carry: Vector, draw: np.random.Generator | None = None
    ) -> tuple[Vector, Vector]:
        """Return actions of a group's robots, and the carry after them.

        Args:
            group: Number of the group.
            obs: Their observations (..., obs_size).
            carry: That before them (..., memory).
            draw: Generator of random numbers; None: the most probable actions are taken.

        Raises:
            UsageError: Observations of another size.
        """
        obs, mean, std = np.asarray(obs, np.float32), self.mean[group], self.std[group]
        if obs.shape[-1:] != mean.shape:
            raise UsageError(f"observations have {obs.shape[-1:]} numbers, this policy needs {mean.shape}")
        # Numbers that are not finite count as the mean, 0 after normalisation, as in training.
        seen = np.clip((np.where(np.isfinite(obs), obs, mean) - mean) / std, -MAX_NORMALISED, MAX_NORMALISED)
        if (layout := self.layouts[group]) is None:
            logits, carry = forward(self.weights[group], self.layers, seen, carry)
        else:
            logits = set_outputs(NumpyOperations(), self.weights[group], self.layers, layout, seen)
        if not self.groups[group].get("discrete"):
            return _squashed(logits, draw), carry
        choices = logits.shape[-1] - 2 * self.vectors[group].size
        choice = _choice(logits[..., :choices], obs, draw)
        return np.concatenate([choice, _squashed(logits[..., choices:], draw)], -1), carry


def _squashed(parameters: Vector, draw: np.random.Generator | None) -> Vector:
    """Return numbers from -1 to 1 (..., n), of means and deviations before they are squashed (..., 2 n)."""
    loc, scale = np.split(parameters, 2, axis=-1)
    if draw is not None:
        # Softplus without an overflow.
        deviation = np.logaddexp(scale, 0.0) + MIN_STD
        loc = loc + deviation * draw.standard_normal(loc.shape, np.float32)
    return np.tanh(loc)


def _choice(logits: Vector, obs: Vector, draw: np.random.Generator | None) -> Vector:
    """Return 1 at the choice and 0 elsewhere (..., choices), of those that observations say are there."""
    # Raw observations: normalised ones are no longer 0 and 1.
    there = obs[..., -logits.shape[-1] :] > 0.5
    if draw is not None:  # the greatest of these is a sample (Gumbel's)
        logits = logits + draw.gumbel(size=logits.shape)
    best = np.where(there, logits, INVALID).argmax(-1)
    return np.eye(logits.shape[-1], dtype=np.float32)[best]


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
        record: Record of its training.
        half: Write weights as numbers of 16 bits, rounded by up to 2^-11 of themselves.

    Raises:
        WriteError: The file cannot be written.
    """
    about = {
        "format": FORMAT,
        "task": record.task,
        "overrides": record.overrides,
        "period": record.period,
        "groups": [group_record(group, policy.layout(g)) for g, group in enumerate(policy.groups)],
        "layers": len(policy.layers),
        "memory": policy.memory,
        **({} if policy.kind == "mlp" else {"network": policy.kind}),
    }
    arrays: dict[str, Any] = {"about": np.array(json.dumps(about))}
    for g in range(len(policy.groups)):
        # The file has what divides, so that readers need not know how it comes from the statistics.
        scale = policy.scale(g, params.mean[g], params.std[g])
        arrays[f"mean/{g}"], arrays[f"std/{g}"] = map(np.asarray, scale)
        arrays |= _flat(params.weights[g]["params"], f"weights/{g}/")
    write_arrays(file, arrays, half)


def group_record(group: "AgentGroup", layout: ObservationLayout | None = None) -> dict[str, Any]:
    """Return what a file has of a group: `discrete` and `vector` only where it has them, for older readers.

    Args:
        group: The group.
        layout: The layout that its network reads; None: none, and the file has none.
    """
    found = {name: value for name, value in vars(group).items() if name != "layout"}
    found = {name: value for name, value in found.items() if name != "discrete" or value}
    if group.vector == NO_VECTOR:
        del found["vector"]
    return found if layout is None else {**found, "layout": layout_record(layout)}


def write_arrays(file: str | Path, arrays: Mapping[str, Vector], half: bool) -> None:
    """Write what a policy's file has, weights as numbers of 16 bits if wanted."""
    kept = {
        name: arrays[name].astype(np.float16) if half and name.startswith("weights/") else arrays[name]
        for name in sorted(arrays)
    }
    with atomic_write(Path(file)) as fresh, fresh.open("wb") as out:
        np.savez_compressed(out, **cast(Any, kept))


def weights_in(folder: Path) -> Path | None:
    """Return the file of the policy that a folder holds; None: it is no such folder."""
    file = folder / WEIGHTS
    return file if file.is_file() else None


def check_place(folder: Path) -> None:
    """Refuse a place for a policy's folder that is a file.

    Raises:
        UsageError: It is one.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; a policy's folder goes elsewhere")


def write_folder(file: Path, folder: Path) -> None:
    """Write a policy's file as a folder.

    Args:
        file: The policy.
        folder: To write; files of these names in it are replaced.

    Raises:
        UsageError: The place is a file, or the policy is broken.
        WriteError: The folder or a file in it cannot be written.
    """
    check_place(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(f"cannot write {folder}: {error.strerror}") from error
    # Read before any file of the folder is written: what is no policy leaves none there.
    about, arrays = read_arrays(file)
    with atomic_write(folder / WEIGHTS) as fresh:
        fresh.write_bytes(file.read_bytes())
    _write(folder / CONFIG, json.dumps({"library": "usarmjx", **about}, indent=2) + "\n")
    _write(folder / CARD, card_of(NumpyPolicy(file), arrays))


def card_of(policy: NumpyPolicy, arrays: dict[str, np.ndarray]) -> str:
    """Return the card of a policy as Markdown with YAML in front."""
    count = sum(array.size for name, array in arrays.items() if name.startswith("weights/"))
    groups = [
        f"| {group['name']} | {group['obs_size']} | {group['action_size']} |" for group in policy.groups
    ]
    settings = [f"- `{name}={value}`" for name, value in policy.overrides.items()]
    lines = [
        "---",
        "library_name: usarmjx",
        "pipeline_tag: reinforcement-learning",
        f"tags: [reinforcement-learning, robotics, usarmjx, {json.dumps(policy.task)}]",
        "---",
        "",
        f"# Policy for {policy.task}",
        "",
        f"A policy of usarmjx for the task `{policy.task}`: {policy.layers} hidden layers, memory of"
        f" {policy.memory} units, {count:,} weights, an action each {policy.period:g} s.",
        "",
        "| robot | numbers in observation | in action |",
        "|---|---|---|",
        *groups,
        "",
        *(["Settings of the task in training:", "", *settings, ""] if settings else []),
        "```console",
        "$ usarmjx eval FOLDER",
        "$ usarmjx play FOLDER --out policy.gif",
        "```",
        "",
        f"`usarmjx.train.NumpyPolicy('{WEIGHTS}')` runs it with NumPy alone.",
    ]
    return "\n".join(lines) + "\n"


def _write(file: Path, text: str) -> None:
    with atomic_write(file) as fresh:
        fresh.write_text(text, encoding="utf-8")


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of the files in a folder."""
    return sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))
