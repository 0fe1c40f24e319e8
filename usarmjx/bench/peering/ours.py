"""This package as `usarmjx bench peers` measures it: in a process of its own, with the peers' options."""

import argparse
import json
import sys
from typing import Any

import jax

from usarmjx.bench.loops import bare_step, repeat_loop, whole_step
from usarmjx.bench.scenes import SceneCase
from usarmjx.bench.tools import time_repeats, versions

PARTS = ("whole", "blind", "bare")
"""All of a step; without sensors; the engine alone."""


def measure(  # noqa: PLR0913 - as the command line has them
    engine: str, part: str, worlds: int, robots: int, steps: int, repeats: int, seed: int, arena: str
) -> dict[str, Any]:
    """Return first call and repeats of a part of the step, as a peer's script prints them."""
    case = SceneCase(worlds=worlds, roster=f"P2AT:{robots}", arena=arena, engine=engine, seed=seed)
    scene = case.scene()
    batch, key = case.batch(scene), jax.random.key(seed + 1)
    state: Any = batch.reset()
    if part == "bare":
        (body, given), state = bare_step(batch, key, state), state.physics
    else:
        body, given = whole_step(batch, key, sensing=part == "whole"), ()
    first, times, end = time_repeats(repeat_loop(batch, body, steps, given), state, repeats)
    if part != "bare":
        batch.check_overflow(end)
    return {
        "first_s": first,
        "times_s": times,
        "period_s": scene.physics.period,
        "steps": steps,
        "device": "host" if engine == "c" else jax.devices()[0].device_kind,
        "versions": versions(),
    }


def main() -> None:
    """Measure what the command line asks for; print a line of JSON."""
    parser = argparse.ArgumentParser()
    for name in ("engine", "part", "arena"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("worlds", "robots", "steps", "repeats", "seed"):
        parser.add_argument(f"--{name}", type=int, required=True)
    sys.stdout.write("\n" + json.dumps(measure(**vars(parser.parse_args()))) + "\n")


if __name__ == "__main__":
    main()
