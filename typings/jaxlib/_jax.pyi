# jaxlib's extension module has no types; jax's signatures name these of it.
from typing import Any

class Client:
    platform: str
    platform_version: str

    def devices(self) -> list[Device]: ...

class Device:
    id: int
    process_index: int
    platform: str
    device_kind: str
    client: Client

    def memory_stats(self) -> dict[str, int] | None: ...

class Sharding: ...

def __getattr__(name: str) -> Any: ...
