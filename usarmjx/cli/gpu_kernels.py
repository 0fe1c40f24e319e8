"""Kernels of engine `warp`, compiled into the cache for GPUs that are elsewhere: in an image, or a cluster.

`python -m usarmjx.cli.gpu_kernels --arena yellow --roster P2AT:4 80 90` is for GPUs of compute capability 8.0
and 9.0. Two kernels, which compile in two seconds, depend on whether a GPU is here: its first step adds them.
"""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

from usarmjx.base.compilation import enable_compilation_cache
from usarmjx.cli.serve import WorldsOptions

if TYPE_CHECKING:
    from usarmjx.engines.mjx_warp import WarpEngine


def read_options(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the options of a command line: arena, roster and architectures."""
    parser = argparse.ArgumentParser(description="Compile kernels for GPUs that are elsewhere.")
    parser.add_argument("--arena", default=WorldsOptions.arena, help="name of an arena, or a file")
    parser.add_argument("--roster", default=WorldsOptions.roster, help="robots that wait for clients")
    parser.add_argument("architectures", nargs="+", type=int, help="compute capabilities: 90 for 9.0")
    return parser.parse_args(words)


def main(words: Sequence[str] | None = None) -> None:
    """Compile the kernels of a served batch.

    Raises:
        UsageError: A roster that does not parse.
        UnknownNameError: Unknown arena or robot class.
        EngineError: Warp is not installed.
    """
    options = read_options(words)
    enable_compilation_cache()  # before Warp is imported
    from usarmjx.base.warp_modules import block_sizes_of_gpus, compile_for

    with block_sizes_of_gpus():
        modules = served_engine(options.arena, options.roster).modules_of_step()
    compile_for(modules, options.architectures)


def served_engine(arena: str, roster: str) -> "WarpEngine":
    """Return engine `warp` of a served batch as it is on a GPU."""
    from usarmjx.models.compile.physics import Physics
    from usarmjx.server.worlds.make import parked_scene
    from usarmjx.sim.batch import engine_of

    # On a CPU `auto` is another solver.
    for solver in ("block", "CG"):
        scene = parked_scene(arena, roster, Physics(solver=solver))
        engine = cast("WarpEngine", engine_of(scene, "warp", 1))
        if engine.uncovered is None:
            break
    return engine


if __name__ == "__main__":
    main()
