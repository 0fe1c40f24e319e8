# Branches that return what they return; jax leaves it open.
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from typing_extensions import TypeVarTuple, Unpack

_Operands = TypeVarTuple("_Operands")
_Result = TypeVar("_Result")

def cond(
    pred: Any,
    true_fun: Callable[[Unpack[_Operands]], _Result],
    false_fun: Callable[[Unpack[_Operands]], _Result],
    *operands: *_Operands,
) -> _Result: ...
def switch(
    index: Any,
    branches: Sequence[Callable[[Unpack[_Operands]], _Result]],
    *operands: *_Operands,
) -> _Result: ...
def __getattr__(name: str) -> Any: ...
