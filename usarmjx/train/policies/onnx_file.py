"""Policies as ONNX models, for ONNX Runtime and what else reads them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from usarmjx.base.errors import extra
from usarmjx.base.files import atomic_write
from usarmjx.train.policies.policy_file import INVALID
from usarmjx.train.policies.set_forward import MASKED, Weights, set_outputs

if TYPE_CHECKING:
    from usarmjx.train.policies.policy_file import NumpyPolicy

with extra("onnx"):
    from onnx import TensorProto, checker, helper, numpy_helper

OPSET, IR = 17, 9
"""Versions of ONNX' operators and of its file format, which readers of 2023 know."""


class _Graph:
    """Nodes and constants of a model while it is built.

    Attributes:
        nodes: The operations.
        constants: The arrays.
        inputs: Names and widths of what the model reads.
        outputs: Names and widths of what it returns.
    """

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.inputs: list[tuple[str, int]] = []
        self.outputs: list[tuple[str, int]] = []

    def constant(self, value: Any) -> str:  # noqa: ANN401 - whatever NumPy takes
        """Return the name of an array of 32-bit floats."""
        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, np.float32), name))
        return name

    def add(self, kind: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:  # noqa: ANN401
        """Return the name of what an operation makes, or the names of several."""
        names = [f"{kind.lower()}_{len(self.nodes)}_{index}" for index in range(outputs)]
        self.nodes.append(helper.make_node(kind, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def dense(self, layer: Any, x: str) -> str:  # noqa: ANN401 - a tree of weights
        """Return a layer's outputs."""
        product = self.add("MatMul", x, self.constant(layer["kernel"]))
        return self.add("Add", product, self.constant(layer["bias"]))

    def result(self, name: str, width: int, value: str) -> None:
        """Return a value from the model under a name."""
        # Outputs need names of their own, which `add` does not give.
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        self.outputs.append((name, width))


class _GraphOperations:
    """Operations on arrays of a graph by their names, see `set_forward.Operations`."""

    def __init__(self, graph: _Graph) -> None:
        self.graph = graph

    def _whole(self, *values: int) -> str:
        return self.graph.add("Constant", value_ints=list(values))

    def slice(self, x: str, axis: int, first: int, end: int) -> str:
        return self.graph.add("Slice", x, self._whole(first), self._whole(end), self._whole(axis))

    def shape(self, x: str, replaced: int, tail: Sequence[int]) -> str:
        del replaced  # one axis stands before them, over robots
        return self.graph.add("Reshape", x, self._whole(-1, *tail))

    def product(self, x: str, y: str) -> str:
        return self.graph.add("MatMul", x, y)

    def constant(self, value: Any) -> str:  # noqa: ANN401 - whatever NumPy takes
        return self.graph.constant(value)

    def plus(self, x: str, y: str) -> str:
        return self.graph.add("Add", x, y)

    def elu(self, x: str) -> str:
        return self.graph.add("Elu", x)

    def turned(self, x: str) -> str:
        return self.graph.add("Transpose", x, perm=[0, 2, 1])

    def softmax(self, x: str) -> str:
        return self.graph.add("Softmax", x, axis=-1)

    def hidden(self, there: str) -> str:
        above = self.graph.add("Greater", there, self.graph.constant(0.5))
        return self.graph.add("Where", above, self.graph.constant(0.0), self.graph.constant(MASKED))

    def joined(self, parts: Sequence[str], axis: int) -> str:
        return self.graph.add("Concat", *parts, axis=axis)

    def halved(self, x: str, layer: Weights) -> str:
        # ONNX convolves with channels first, Flax with channels last.
        first = self.graph.add("Transpose", x, perm=[0, 3, 1, 2])
        kernel = self.graph.constant(np.transpose(layer["kernel"], (3, 2, 0, 1)))
        found = self.graph.add(
            "Conv", first, kernel, self.graph.constant(layer["bias"]), strides=[2, 2], pads=[1, 1, 1, 1]
        )
        return self.graph.add("Transpose", found, perm=[0, 2, 3, 1])

    def channels_last(self, x: str) -> str:
        return self.graph.add("Transpose", x, perm=[0, 2, 3, 1, 4])


def _add_memory(graph: _Graph, weights: Any, x: str, carry: str) -> str:  # noqa: ANN401 - a tree of weights
    """Return the carry after a GRU, as `policy_file.forward` computes it."""
    reset, update, new = graph.add("Split", graph.dense(weights["gates"], x), outputs=3, axis=-1)
    recurrent = graph.add("MatMul", carry, graph.constant(weights["recurrent"]))
    own_reset, own_update, own_new = graph.add("Split", recurrent, outputs=3, axis=-1)
    update = graph.add("Sigmoid", graph.add("Add", update, own_update))
    reset = graph.add("Sigmoid", graph.add("Add", reset, own_reset))
    # As in `networks.recur`: the reset gate scales the product with its bias, not the carry before it.
    biased = graph.add("Add", own_new, graph.constant(weights["recurrent_bias"]))
    new = graph.add("Tanh", graph.add("Add", new, graph.add("Mul", reset, biased)))
    kept = graph.add("Mul", update, carry)
    return graph.add("Add", graph.add("Mul", graph.add("Sub", graph.constant(1.0), update), new), kept)


def _part(graph: _Graph, x: str, first: int, end: int) -> str:
    """Return the numbers from `first` to before `end`."""
    return _GraphOperations(graph).slice(x, -1, first, end)


def _most_probable(graph: _Graph, x: str, seen: str, sizes: tuple[int, int, int]) -> str:
    """Return the most probable action of parameters of choices, and of a vector if it has a size.

    Args:
        graph: The graph.
        x: The parameters.
        seen: Raw observations, as in `policy_file._choice`.
        sizes: Numbers of an observation, choices, and numbers of the vector.
    """
    width, choices, numbers = sizes
    rated = _part(graph, x, 0, choices) if numbers else x
    there = graph.add("Greater", _part(graph, seen, width - choices, width), graph.constant(0.5))
    rated = graph.add("Where", there, rated, graph.constant(INVALID))
    # 1 for the first of the greatest, as NumPy's argmax chooses.
    chosen = graph.add("Hardmax", rated, axis=-1)
    if not numbers:
        return chosen
    vector = graph.add("Tanh", _part(graph, x, choices, choices + numbers))
    return graph.add("Concat", chosen, vector, axis=-1)


def _add_group(graph: _Graph, policy: "NumpyPolicy", index: int) -> None:
    """Add the network of a group: its most probable actions from its observations."""
    group, weights = policy.groups[index], policy.weights[index]
    name, width = group["name"], group["obs_size"]
    seen, mean = f"{name}.obs", graph.constant(policy.mean[index])
    graph.inputs.append((seen, width))
    # ONNX has no test for finite numbers.
    lost = graph.add("Or", graph.add("IsNaN", seen), graph.add("IsInf", seen))
    # A number that is not finite counts as the mean: 0 once it is normalised.
    x = graph.add("Sub", graph.add("Where", lost, mean, seen), mean)
    x = graph.add("Div", x, graph.constant(policy.std[index]))
    x = graph.add("Clip", x, graph.constant(-policy.max_normalised), graph.constant(policy.max_normalised))
    layout = policy.layouts[index]
    for layer in range(policy.layers if layout is None else 0):
        x = graph.add("Elu", graph.dense(weights[f"layer_{layer}"], x))
    if policy.memory:
        graph.inputs.append((f"{name}.carry", policy.memory))
        x = _add_memory(graph, weights, x, f"{name}.carry")
        graph.result(f"{name}.next_carry", policy.memory, x)
    if group.get("discrete"):
        if layout is None:
            x = graph.dense(weights["head"], x)
        else:
            x = set_outputs(_GraphOperations(graph), weights, policy.layers, layout, x)
        numbers = policy.vectors[index].size
        sizes = width, group["action_size"] - numbers, numbers
        graph.result(f"{name}.action", group["action_size"], _most_probable(graph, x, seen, sizes))
        return
    # The other half are deviations, which the most probable action does not need.
    means, _ = graph.add("Split", graph.dense(weights["head"], x), outputs=2, axis=-1)
    graph.result(f"{name}.action", group["action_size"], graph.add("Tanh", means))


def write_onnx(policy: "NumpyPolicy", file: Path) -> None:
    """Write a policy as an ONNX model, whose metadata `about` has what the policy is for.

    For each group of robots it reads `CLASS.obs` (robots, obs_size) and returns the most probable actions,
    `CLASS.action` (robots, action_size). With memory it also reads `CLASS.carry` (robots, memory), zeros at
    first, and returns `CLASS.next_carry`.

    Raises:
        WriteError: The file cannot be written.
    """
    graph = _Graph()
    for index in range(len(policy.groups)):
        _add_group(graph, policy, index)

    def described(values: list[tuple[str, int]]) -> list[Any]:
        kind = TensorProto.FLOAT
        return [helper.make_tensor_value_info(name, kind, ["robots", width]) for name, width in values]

    inputs, outputs = described(graph.inputs), described(graph.outputs)
    whole = helper.make_graph(graph.nodes, policy.task, inputs, outputs, graph.constants)
    model = helper.make_model(whole, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    about = {"task": policy.task, "period": policy.period, "groups": policy.groups, "memory": policy.memory}
    helper.set_model_props(model, {"about": json.dumps(about)})
    # Before the file is replaced: a model that does not load is no use to anyone.
    checker.check_model(model)  # pyright: ignore[reportUnknownMemberType]
    with atomic_write(file) as fresh:
        fresh.write_bytes(model.SerializeToString())
