# flax leaves the arguments of these without types.
from collections.abc import Callable, Mapping
from typing import Any, Self, TypeVar, dataclass_transform, overload

_Class = TypeVar("_Class", bound=type[Any])

def field(pytree_node: bool = True, *, metadata: Mapping[str, Any] | None = None, **kwargs: Any) -> Any: ...
@overload
@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def dataclass(clz: _Class, **kwargs: Any) -> _Class: ...
@overload
@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def dataclass(**kwargs: Any) -> Callable[[_Class], _Class]: ...

@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class PyTreeNode:
    def __init_subclass__(cls, **kwargs: Any) -> None: ...
    def replace(self, **overrides: Any) -> Self: ...
