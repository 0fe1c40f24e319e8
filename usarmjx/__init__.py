"""usarmjx: USARSim rebuilt as a GPU-batched simulator of multi-robot swarms.

`make` gives a task's environment, `sim.batch.Batch` steps worlds, `server` serves one over the Gamebots
protocol. docs/architecture.md says what is in which folder, and follows a command, a range, an action and a
radio link through them; docs/glossary.md has the words. Importing this raises JAX's pool of threads, see
`base.threads`.
"""

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
