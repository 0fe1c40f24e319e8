# jax's transformations, of functions whose arguments and results keep their types.
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, overload

from jax._src.basearray import Array
from jaxlib._jax import Device

_P = ParamSpec("_P")
_Rest = ParamSpec("_Rest")
_Result = TypeVar("_Result", covariant=True)
_Self = TypeVar("_Self")
_Function = TypeVar("_Function", bound=Callable[..., Any])
_Tree = TypeVar("_Tree")

class _NamedScope(AbstractContextManager[None], Protocol):
    def __call__(self, function: _Function) -> _Function: ...

class Jitted(Generic[_P, _Result]):
    __wrapped__: Callable[_P, _Result]

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> _Result: ...
    @overload
    def __get__(self, instance: None, owner: Any) -> Jitted[_P, _Result]: ...
    @overload
    def __get__(
        self: Jitted[Concatenate[_Self, _Rest], _Result], instance: _Self, owner: Any
    ) -> Jitted[_Rest, _Result]: ...
    def eval_shape(self, *args: Any, **kwargs: Any) -> Any: ...
    def trace(self, *args: Any, **kwargs: Any) -> Any: ...
    def lower(self, *args: Any, **kwargs: Any) -> Any: ...
    def clear_cache(self) -> None: ...
    def _cache_size(self) -> int: ...

@overload
def jit(
    fun: Callable[_P, _Result],
    /,
    *,
    in_shardings: Any = ...,
    out_shardings: Any = ...,
    static_argnums: int | Sequence[int] | None = ...,
    static_argnames: str | Iterable[str] | None = ...,
    donate_argnums: int | Sequence[int] | None = ...,
    donate_argnames: str | Iterable[str] | None = ...,
    keep_unused: bool = ...,
    device: Device | None = ...,
    backend: str | None = ...,
    inline: bool = ...,
    compiler_options: dict[str, Any] | None = ...,
) -> Jitted[_P, _Result]: ...
@overload
def jit(
    *,
    in_shardings: Any = ...,
    out_shardings: Any = ...,
    static_argnums: int | Sequence[int] | None = ...,
    static_argnames: str | Iterable[str] | None = ...,
    donate_argnums: int | Sequence[int] | None = ...,
    donate_argnames: str | Iterable[str] | None = ...,
    keep_unused: bool = ...,
    device: Device | None = ...,
    backend: str | None = ...,
    inline: bool = ...,
    compiler_options: dict[str, Any] | None = ...,
) -> Callable[[Callable[_P, _Result]], Jitted[_P, _Result]]: ...
def vmap(
    fun: _Function,
    in_axes: int | Sequence[Any] | None = 0,
    out_axes: Any = 0,
    axis_name: Any = None,
    axis_size: int | None = None,
    spmd_axis_name: Any = None,
) -> _Function: ...
def grad(
    fun: Callable[_P, Any], argnums: int | Sequence[int] = 0, has_aux: bool = False
) -> Callable[_P, Any]: ...
def value_and_grad(
    fun: Callable[_P, Any], argnums: int | Sequence[int] = 0, has_aux: bool = False
) -> Callable[_P, tuple[Any, Any]]: ...
def eval_shape(fun: Callable[..., Any], *args: Any, **kwargs: Any) -> Any: ...
def make_jaxpr(fun: Callable[..., Any], static_argnums: int | Sequence[int] = ()) -> Callable[..., Any]: ...
def device_get(x: Any) -> Any: ...
def device_put(x: Any, device: Any = None, *, donate: bool = False) -> Any: ...
def block_until_ready(x: _Tree) -> _Tree: ...
def jvp(fun: Callable[..., Any], primals: Any, tangents: Any, has_aux: bool = False) -> tuple[Any, ...]: ...
def vjp(fun: Callable[..., Any], *primals: Any, has_aux: bool = False) -> tuple[Any, ...]: ...
def named_scope(name: str) -> _NamedScope: ...
def live_arrays(platform: str | None = None) -> list[Array]: ...
def clear_caches() -> None: ...
def __getattr__(name: str) -> Any: ...
