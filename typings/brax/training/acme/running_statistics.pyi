# The running mean and deviation; brax leaves its fields without types.
from typing import Any

from flax import struct
from jax import Array

class RunningStatisticsState(struct.PyTreeNode):
    mean: Array
    std: Array
    count: Array

def init_state(nest: Array, std_eps: float = 0.0, mode: str = "welford") -> RunningStatisticsState: ...
def update(
    state: RunningStatisticsState,
    batch: Array,
    *,
    weights: Array | None = None,
    std_min_value: float = 1e-6,
    std_max_value: float = 1e6,
    pmap_axis_name: str | None = None,
    validate_shapes: bool = True,
) -> RunningStatisticsState: ...
def __getattr__(name: str) -> Any: ...
