# What recordings need of msgpack, which ships without types.
from collections.abc import Callable
from typing import Any

class ExtType:
    code: int
    data: bytes
    def __init__(self, code: int, data: bytes) -> None: ...

def packb(
    o: object, *, default: Callable[[Any], object] | None = None, strict_types: bool = False
) -> bytes | None: ...
def unpackb(
    packed: bytes,
    *,
    object_hook: Callable[[dict[str, Any]], object] | None = None,
    ext_hook: Callable[[int, bytes], object] | None = None,
    use_list: bool = True,
    strict_map_key: bool = True,
) -> Any: ...
def __getattr__(name: str) -> Any: ...
