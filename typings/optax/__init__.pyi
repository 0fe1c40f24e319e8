# The optimiser's parts that training uses; optax comes with types that pyright finds no stubs for.
from typing import Any, NamedTuple, Protocol

from optax import tree as tree

class _Init(Protocol):
    def __call__(self, params: Any) -> Any: ...

class _Update(Protocol):
    def __call__(self, updates: Any, state: Any, params: Any = None) -> tuple[Any, Any]: ...

class GradientTransformation(NamedTuple):
    init: _Init
    update: _Update

def chain(*args: GradientTransformation) -> GradientTransformation: ...
def clip_by_global_norm(max_norm: float) -> GradientTransformation: ...
def scale_by_adam(
    b1: float = 0.9, b2: float = 0.999, eps: float = 1e-8, eps_root: float = 0.0
) -> GradientTransformation: ...
def __getattr__(name: str) -> Any: ...
