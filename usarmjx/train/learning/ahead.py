"""Compile rollout and update while the worlds are made: XLA works on all at once, and a start waits less."""

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event
from typing import TYPE_CHECKING

import jax
from jax.sharding import SingleDeviceSharding

if TYPE_CHECKING:
    from usarmjx.train.learning.learner import Trainer


@contextmanager
def compiling(trainer: "Trainer") -> Generator[None]:
    """Compile rollout and update beside what is done meanwhile, and wait for both.

    That begins once the rollout is with XLA, which takes longest for it: two programs that Python traces at
    once take turns.

    What is wrong with one is for its first call to tell, which compiles it again. Worlds that cannot be
    traced have no rollout to compile, and nothing is done.
    """
    if not trainer.env.traceable:
        yield
        return
    place = SingleDeviceSharding(trainer.process_group.device)
    shapes = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=place), trainer.start_shapes()
    )
    lowered = Event()
    with ThreadPoolExecutor(2, "compiling") as pool:

        def update_too(collected: tuple[object, ...]) -> None:
            lowered.set()
            pool.submit(trainer.compile_update, shapes[0], collected)

        done = pool.submit(trainer.rollout.compile_ahead, *shapes, tell=update_too)
        done.add_done_callback(lambda _: lowered.set())
        lowered.wait()
        yield
        done.exception()  # until then there may be more to submit
