"""Kernels of engine `warp`, compiled into the cache for GPUs that are elsewhere: in an image, or a cluster.

`python -m usarmjx.cli.gpu_kernels --arena yellow --roster P2AT:4 80 90` is for GPUs of compute capability 8.0
and 9.0. Two kernels, which compile in two seconds, depend on whether a GPU is here: its first step adds them.
"""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

from usarmjx.base.errors import UsarmjxError, one_line
from usarmjx.cli.common import announce, say
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
    """Compile the kernels of a served batch, or exit with a line that says why not."""
    options = read_options(words)
    known = ", ".join(f"{one / 10:.1f}" for one in options.architectures)
    announce(f"compiling kernels for compute capability {known} ...", engines=("warp",))  # before JAX
    from usarmjx.base.warp_modules import block_sizes_of_gpus, compile_for

    try:
        with block_sizes_of_gpus():
            modules = served_engine(options.arena, options.roster).modules_of_step()
    except UsarmjxError as error:
        raise SystemExit(f"usarmjx: {one_line(str(error))}") from error
    compile_for(modules, options.architectures)
    say(f"{len(modules)} modules of kernels are kept")


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
