"""Forward pass of networks over sets, written once for NumPy and for graphs of ONNX.

The twin for training is `learning.networks`. This module imports neither JAX nor anything that needs it.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from usarmjx.train.envs.layout import ObservationLayout, Span

HEADS = 4
"""Heads of attention, of layers whose width they divide; else one."""
FILTERS = (16, 32)
"""Filters of the layers over a picture; each halves its sides."""
MASKED = -1e9
"""Score of attention to what is not there."""
KINDS = ("mlp", "set", "cnn")
"""Kinds of networks, as `Config.network` has them."""

Weights = Mapping[str, Any]


def heads_of(width: int) -> int:
    """Return the number of heads of attention of a width."""
    return HEADS if width % HEADS == 0 else 1


def elu(x: np.ndarray) -> np.ndarray:
    """Return the exponential linear unit of each number."""
    # `where` computes both branches: expm1 of a large x would overflow.
    return np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))


class Operations(Protocol):
    """Operations on arrays, or on names of arrays in a graph."""

    def slice(self, x: Any, axis: int, first: int, end: int) -> Any:  # noqa: ANN401
        """Return the part from `first` to before `end` of an axis, which is negative: -1 is the last."""
        ...

    def shape(self, x: Any, replaced: int, tail: Sequence[int]) -> Any:  # noqa: ANN401
        """Return an array with the last `replaced` axes reshaped to the sizes `tail`."""
        ...

    def product(self, x: Any, y: Any) -> Any:  # noqa: ANN401
        """Return the product of matrices."""
        ...

    def constant(self, value: Any) -> Any:  # noqa: ANN401
        """Return constants."""
        ...

    def plus(self, x: Any, y: Any) -> Any:  # noqa: ANN401
        """Return a sum."""
        ...

    def elu(self, x: Any) -> Any:  # noqa: ANN401
        """Return the exponential linear unit of each number."""
        ...

    def turned(self, x: Any) -> Any:  # noqa: ANN401
        """Return an array (rows, a, b) as (rows, b, a)."""
        ...

    def softmax(self, x: Any) -> Any:  # noqa: ANN401
        """Return the softmax along the last axis."""
        ...

    def hidden(self, there: Any) -> Any:  # noqa: ANN401
        """Return 0 where a number is above a half, else `MASKED`."""
        ...

    def joined(self, parts: Sequence[Any], axis: int) -> Any:  # noqa: ANN401
        """Return the concatenation along an axis, which is negative: -1 is the last."""
        ...

    def halved(self, x: Any, layer: Weights) -> Any:  # noqa: ANN401
        """Return a convolution (rows, i, j, n) of 3 by 3 with stride 2 and a border of 1."""
        ...

    def channels_last(self, x: Any) -> Any:  # noqa: ANN401
        """Return an array (rows, levels, i, j, n) as (rows, i, j, levels, n)."""
        ...


def _dense(ops: Operations, layer: Weights, x: Any) -> Any:  # noqa: ANN401
    product = ops.product(x, ops.constant(layer["kernel"]))
    return ops.plus(product, ops.constant(layer["bias"])) if "bias" in layer else product


def _part(ops: Operations, x: Any, span: Span) -> Any:  # noqa: ANN401
    return ops.slice(x, -1, span.first, span.end)


def set_outputs(ops: Operations, weights: Weights, layers: int, layout: ObservationLayout, x: Any) -> Any:  # noqa: ANN401
    """Return a number for each choice, then those of a vector (rows, choices + numbers).

    Args:
        ops: The operations.
        weights: Weights of the network, by layer.
        layers: Number of layers: the first, and a round of attention for each other one.
        layout: Parts of the observations.
        x: Normalised observations (rows, n).
    """
    own = _dense(ops, weights["own"], _part(ops, x, layout.own_span))
    if "view" in weights:
        own = ops.plus(own, _dense(ops, weights["view"], _view(ops, weights, layout, x)))
    width = weights["own"]["kernel"].shape[1]
    others, choices = (ops.shape(_part(ops, x, span), 1, span[1:]) for span in layout.sets)
    # Gathered while the graph is built: the kinds of the choices are the layout's, not the observation's.
    kinds = ops.constant(weights["kinds"][np.array(layout.kinds)])
    rows = [
        ops.shape(own, 1, (1, width)),
        _dense(ops, weights["others"], others),
        ops.plus(_dense(ops, weights["choices"], choices), kinds),
    ]
    tokens = ops.elu(ops.joined(rows, -2))
    hidden = _hidden(ops, layout, x, others)
    for i in range(1, layers):
        tokens = ops.elu(
            ops.plus(_dense(ops, weights[f"layer_{i}"], tokens), _gathered(ops, weights, i, tokens, hidden))
        )
    # Tokens are the robot itself, the others, and the choices; only the last are rated.
    first = 1 + layout.others[0]
    chosen = ops.slice(tokens, -2, first, layout.tokens)
    rated = ops.shape(_dense(ops, weights["head"], chosen), 2, (layout.choices[0],))
    if "vector" not in weights:
        return rated
    vector = _dense(ops, weights["vector"], ops.slice(tokens, -2, 0, 1))
    numbers = weights["vector"]["kernel"].shape[1]
    return ops.joined([rated, ops.shape(vector, 2, (numbers,))], -1)


def _hidden(ops: Operations, layout: ObservationLayout, x: Any, others: Any) -> Any:  # noqa: ANN401
    """Return the addend of attention scores for each token (rows, 1, tokens): 0, or `MASKED`."""
    mask = _part(ops, x, layout.mask_span)
    there = ops.shape(ops.slice(others, -1, 0, 1), 2, (layout.others[0],))
    # By a product with 0, as a graph knows the number of rows only when it runs.
    own = ops.product(ops.slice(mask, -1, 0, 1), ops.constant([[0.0]]))  # never hidden
    return ops.shape(ops.joined([own, ops.hidden(there), ops.hidden(mask)], -1), 1, (1, layout.tokens))


def _gathered(ops: Operations, weights: Weights, i: int, x: Any, hidden: Any) -> Any:  # noqa: ANN401
    query, key, value = (_dense(ops, weights[f"{name}_{i}"], x) for name in ("query", "key", "value"))
    width = weights[f"query_{i}"]["kernel"].shape[1]
    heads = heads_of(width)
    each, found = width // heads, list[Any]()
    # The square root as a matrix: `Operations` has no product of numbers.
    scale = ops.constant(np.eye(each) / math.sqrt(each))
    for head in range(heads):
        q, k, v = (ops.slice(one, -1, head * each, (head + 1) * each) for one in (query, key, value))
        scores = ops.plus(ops.product(ops.product(q, scale), ops.turned(k)), hidden)
        found.append(ops.product(ops.softmax(scores), v))
    common = _dense(ops, weights[f"common_{i}"], ops.slice(x, -2, 0, 1))
    return ops.plus(ops.joined(found, -1), common)


def _view(ops: Operations, weights: Weights, layout: ObservationLayout, x: Any) -> Any:  # noqa: ANN401
    levels, width, channels = layout.picture
    picture = ops.shape(_part(ops, x, layout.picture_span), 1, (levels, width, width, channels))
    # Levels become channels: the convolution sees all zooms of one place at once.
    picture = ops.shape(ops.channels_last(picture), 4, (width, width, levels * channels))
    for i in range(len(FILTERS)):
        picture = ops.elu(ops.halved(picture, weights[f"conv_{i}"]))
        # Size after a stride of 2 with a border of 1: half, rounded up.
        width = (width + 1) // 2
    return ops.shape(picture, 3, (width * width * FILTERS[-1],))


class NumpyOperations:
    """The operations on arrays."""

    def slice(self, x: np.ndarray, axis: int, first: int, end: int) -> np.ndarray:
        """See `Operations`."""
        return x[(..., slice(first, end), *[slice(None)] * (-1 - axis))]

    def shape(self, x: np.ndarray, replaced: int, tail: Sequence[int]) -> np.ndarray:
        """See `Operations`."""
        return x.reshape(*x.shape[: x.ndim - replaced], *tail)

    def product(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See `Operations`."""
        return x @ y

    def constant(self, value: Any) -> np.ndarray:  # noqa: ANN401 - whatever NumPy takes
        """See `Operations`."""
        return np.asarray(value, np.float32)

    def plus(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See `Operations`."""
        return x + y

    def elu(self, x: np.ndarray) -> np.ndarray:
        """See `Operations`."""
        return elu(x)

    def turned(self, x: np.ndarray) -> np.ndarray:
        """See `Operations`."""
        return np.swapaxes(x, -1, -2)

    def softmax(self, x: np.ndarray) -> np.ndarray:
        """See `Operations`."""
        # Less the largest, or exp overflows; the result is the same.
        share = np.exp(x - x.max(-1, keepdims=True))
        return share / share.sum(-1, keepdims=True)

    def hidden(self, there: np.ndarray) -> np.ndarray:
        """See `Operations`."""
        return np.where(there > 0.5, np.float32(0.0), np.float32(MASKED))

    def joined(self, parts: Sequence[np.ndarray], axis: int) -> np.ndarray:
        """See `Operations`."""
        return np.concatenate(parts, axis)

    def halved(self, x: np.ndarray, layer: Weights) -> np.ndarray:
        """See `Operations`."""
        kernel, (rows, columns) = layer["kernel"], x.shape[-3:-1]
        # A convolution as a sum of nine matrix products: NumPy has none over two axes.
        padded = np.pad(x, [*[(0, 0)] * (x.ndim - 3), (1, 1), (1, 1), (0, 0)])
        parts = [
            padded[..., i : i + rows : 2, j : j + columns : 2, :] @ kernel[i, j]
            for i in range(3)
            for j in range(3)
        ]
        return np.sum(parts, 0) + layer["bias"]

    def channels_last(self, x: np.ndarray) -> np.ndarray:
        """See `Operations`."""
        return np.moveaxis(x, -4, -2)


def set_shapes(
    layout: ObservationLayout, widths: Sequence[int], kind: str, numbers: int = 0
) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of a network, by its name.

    Args:
        layout: Parts of the observations.
        widths: Width of the first layer, then of each round.
        kind: One of `KINDS`, but `mlp`.
        numbers: Outputs behind those of the choices.
    """
    width, wanted = widths[0], dict[str, tuple[int, ...]]()
    for name, inputs in (("own", layout.own), ("others", layout.others[1]), ("choices", layout.choices[1])):
        wanted |= {f"{name}/kernel": (inputs, width), f"{name}/bias": (width,)}
    wanted["kinds"] = (max(layout.kinds) + 1, width)
    if kind == "cnn":
        levels, side, channels = layout.picture
        inputs = levels * channels
        for i, filters in enumerate(FILTERS):
            wanted |= {f"conv_{i}/kernel": (3, 3, inputs, filters), f"conv_{i}/bias": (filters,)}
            inputs, side = filters, (side + 1) // 2
        wanted["view/kernel"] = (side * side * inputs, width)
    for i, size in enumerate(widths[1:], start=1):
        wanted |= {f"layer_{i}/kernel": (width, size), f"layer_{i}/bias": (size,)}
        wanted |= {f"{name}_{i}/kernel": (width, size) for name in ("query", "key", "value", "common")}
        width = size
    if numbers:
        wanted |= {"vector/kernel": (width, numbers), "vector/bias": (numbers,)}
    return {**wanted, "head/kernel": (width, 1), "head/bias": (1,)}
