# What this package uses of MJX. What its two implementations keep to themselves (`_impl`) is Any.
from typing import Any, Self

from jax import Array
from mujoco import MjModel

class _Node:
    def replace(self, **overrides: Any) -> Self: ...
    def tree_replace(self, params: dict[str, Any]) -> Self: ...

class Model(_Node):
    geom_pos: Array
    geom_quat: Array
    geom_size: Array
    geom_aabb: Array
    geom_rbound: Array
    geom_margin: Array
    _impl: Any

class Data(_Node):
    time: Array
    qpos: Array
    qvel: Array
    act: Array
    ctrl: Array
    xfrc_applied: Array
    qacc: Array
    qacc_warmstart: Array
    qfrc_smooth: Array
    qfrc_constraint: Array
    geom_xpos: Array
    userdata: Array
    _impl: Any

def put_model(m: MjModel, device: Any = None, impl: str | None = None) -> Model: ...
def make_data(
    m: MjModel | Model,
    device: Any = None,
    impl: str | None = None,
    naconmax: int | None = None,
    naccdmax: int | None = None,
    njmax: int | None = None,
) -> Data: ...
def step(m: Model, d: Data) -> Data: ...
def forward(m: Model, d: Data) -> Data: ...
def euler(m: Model, d: Data) -> Data: ...
def mul_m(m: Model, d: Data, vec: Array) -> Array: ...
