# Branches that return what they return; jax leaves it open.
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

_Result = TypeVar("_Result")

def cond(
    pred: Any, true_fun: Callable[..., _Result], false_fun: Callable[..., _Result], *operands: Any
) -> _Result: ...
def switch(index: Any, branches: Sequence[Callable[..., _Result]], *operands: Any) -> _Result: ...
def __getattr__(name: str) -> Any: ...
