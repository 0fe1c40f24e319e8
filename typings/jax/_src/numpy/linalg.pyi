# jax compiles these by a decorator that loses their types.
from collections.abc import Sequence
from typing import Any

from jax import Array
from jax.typing import ArrayLike

def norm(
    x: ArrayLike,
    ord: int | str | None = None,
    axis: int | Sequence[int] | None = None,
    keepdims: bool = False,
) -> Array: ...
def __getattr__(name: str) -> Any: ...
