"""usarmjx: USARSim rebuilt as a GPU-batched simulator of multi-robot swarms."""

from typing import TYPE_CHECKING, Any

from usarmjx.base import threads

if TYPE_CHECKING:
    from usarmjx.train.make import make

threads.ensure_pool_size()

__all__ = ["make"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever has that name
    # On demand: whoever imports a small part of usarmjx does not wait for all of it.
    if name == "make":
        from usarmjx.train.make import make

        return make
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
