"""`usarmjx kernels`: compile the kernels of engine `warp` for GPUs that are elsewhere, as in an image."""

from typing import TYPE_CHECKING, Annotated, cast

import typer

from usarmjx.cli.common import ArenaOption, ErrorExit, announce, say
from usarmjx.cli.known_names import check_roster
from usarmjx.cli.serve import RosterOption, WorldsOptions

if TYPE_CHECKING:
    from usarmjx.engines.mjx_warp import WarpEngine


def kernels(
    architectures: Annotated[list[int], typer.Argument(help="Compute capabilities of the GPUs: 90 for 9.0.")],
    arena: ArenaOption = WorldsOptions.arena,
    roster: RosterOption = WorldsOptions.roster,
) -> None:
    """Compile kernels of engine warp into the cache, for GPUs that are elsewhere.

    Two kernels, which compile in two seconds, depend on whether a GPU is here: its first step adds them.
    """
    with ErrorExit():
        # Before JAX is imported: a class that there is not is refused at once.
        check_roster(roster)
        known = ", ".join(f"{one / 10:.1f}" for one in architectures)
        announce(f"compiling kernels for compute capability {known} ...", engines=("warp",))  # before JAX
        from usarmjx.base.warp_modules import block_sizes_of_gpus, check_architectures, compile_for

        check_architectures(architectures)
        with block_sizes_of_gpus():
            modules = _served_engine(arena, roster).modules_of_step()
        compile_for(modules, architectures)
        say(f"{len(modules)} modules of kernels are kept")


def _served_engine(arena: str, roster: str) -> "WarpEngine":
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
