"""Compile the first rollout while the worlds are made: XLA works on both at once, and a start waits less."""

from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import jax
from jax.sharding import SingleDeviceSharding

from usarmjx.train.learning.rollout import Rollout


@contextmanager
def compiling(
    rollout: Rollout, starts: Callable[[], tuple[Any, Any, jax.Array]], device: jax.Device
) -> Generator[None]:
    """Compile a rollout beside what is done meanwhile, and wait for it.

    What is wrong with it is for the first rollout to tell, which finds in JAX's own cache what was compiled.

    Args:
        rollout: Of worlds that can be traced; else nothing is done.
        starts: Returns what the first rollout is given; is only traced.
        device: On which all of that will be.
    """
    if not rollout.env.traceable:
        yield
        return
    place = SingleDeviceSharding(device)
    shapes = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=place), jax.eval_shape(starts)
    )
    with ThreadPoolExecutor(1, "compiling a rollout") as pool:
        pool.submit(rollout.compile_ahead, *shapes)
        yield
