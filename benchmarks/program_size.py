"""Size of traced programs: counts that no load of the machine changes, as a guard against slow decay.

`python -m benchmarks.program_size` prints them; `--write` keeps them as the bounds of the tests.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import jax

BOUNDS = Path(__file__).parents[1] / "tests" / "benchmarks" / "program_sizes.json"
"""Sizes that the tests allow, for one version of JAX."""
Size: TypeAlias = dict[str, int]
TOLERANCE = 0.05
"""Growth that is no decay."""


def program_size(lowered: Any) -> Size:  # noqa: ANN401 - jax.stages.Lowered is half typed
    """Return counts of a traced program, before XLA optimises it.

    Returns:
        Its lines, its writes at computed indices (`scatters`, each a slow kernel on a GPU), and its
        operations and bytes.
    """
    cost: dict[str, float] = lowered.cost_analysis()
    lines: list[str] = lowered.as_text().splitlines()
    return {
        "lines": len(lines),
        "scatters": sum("stablehlo.scatter" in line for line in lines),
        "flops": round(cost["flops"]),
        "bytes": round(cost["bytes accessed"]),
    }


def whole_step_size() -> Size:
    """Return the size of a control step of `planar`: commands, physics, all sensors, radio, resets."""
    from benchmarks.cases import SceneCase
    from benchmarks.scenes import batch_of, scene_of, whole_step

    case = SceneCase(worlds=4, roster="P2AT:4", engine="planar", physics="coarse", radio=True)
    batch = batch_of(case, scene_of(case))
    step = whole_step(batch, jax.random.key(0))
    return program_size(jax.jit(step).lower(jax.numpy.int32(0), batch.reset()))


def task_step_size() -> Size:
    """Return the size of a step of `explore-v2`: actions, control step, maps, plans, reward, observations."""
    from usarmjx.train.make import make

    env = make("explore-v2", worlds=4, engine="planar")
    actions = tuple(jax.numpy.zeros((env.worlds, len(one.agents), one.action_size)) for one in env.groups)
    return program_size(jax.jit(env.step).lower(jax.eval_shape(env.reset), actions))


PROGRAMS: dict[str, Callable[[], Size]] = {
    "planar, whole step": whole_step_size,
    "explore-v2, step": task_step_size,
}


def growths(size: Size, bound: Size, tolerance: float = TOLERANCE) -> list[str]:
    """Return a line for each count that is above its bound by more than a tolerance."""
    return [
        f"{count}: {size[count]:,}, bound {most:,} ({size[count] / most - 1:+.1%})"
        for count, most in bound.items()
        if size[count] > most * (1 + tolerance)
    ]


def main() -> None:
    """Print the sizes, or keep them."""
    sizes = {name: measure() for name, measure in PROGRAMS.items()}
    text = json.dumps({"jax": jax.__version__, "programs": sizes}, indent=1) + "\n"
    if "--write" in sys.argv[1:]:
        BOUNDS.write_text(text, encoding="utf-8")
    print(text, end="")


if __name__ == "__main__":
    main()
