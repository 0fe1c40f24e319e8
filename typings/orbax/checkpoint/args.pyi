from collections.abc import Mapping
from typing import Any

class PyTreeRestore:
    def __init__(self, *, restore_args: Mapping[str, Any]) -> None: ...

def __getattr__(name: str) -> Any: ...
