# Loops whose carry keeps its type; jax leaves that of fori_loop open.
from collections.abc import Callable
from typing import Any, TypeVar

_Carry = TypeVar("_Carry")
_Slice = TypeVar("_Slice")
_Output = TypeVar("_Output")

def fori_loop(
    lower: Any,
    upper: Any,
    body_fun: Callable[[Any, _Carry], _Carry],
    init_val: _Carry,
    *,
    unroll: int | bool | None = None,
) -> _Carry: ...
def while_loop(
    cond_fun: Callable[[_Carry], Any], body_fun: Callable[[_Carry], _Carry], init_val: _Carry
) -> _Carry: ...
def scan(
    f: Callable[[_Carry, _Slice], tuple[_Carry, _Output]],
    init: _Carry,
    xs: _Slice | None = None,
    length: int | None = None,
    reverse: bool = False,
    unroll: int | bool = 1,
) -> tuple[_Carry, _Output]: ...
def map(f: Callable[..., _Output], xs: Any, *, batch_size: int | None = None) -> _Output: ...
def __getattr__(name: str) -> Any: ...
