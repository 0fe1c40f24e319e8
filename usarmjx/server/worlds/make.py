"""Construction of the worlds of `usarmjx serve`, by engine."""

from collections.abc import Sequence

from usarmjx.base.errors import UsageError
from usarmjx.engines import choose_engine
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.files.load import find_arena
from usarmjx.server.worlds.batch_world import BatchWorld, SharedBatch, check_instances
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.calibration import build_calibrated
from usarmjx.sim.scene import RosterEntry, Scene, build_scene, parse_roster


def make_worlds(
    arena: str,
    *,
    engine: str,
    worlds: int,
    instances: Sequence[int],
    roster: str,
    max_robots: int,
    seed: int,
) -> list[ServedWorld]:
    """Build a batch of worlds and return those of them that clients are served, each as a world of its own.

    Args:
        arena: Name of an arena, or a file.
        engine: Name of an engine.
        worlds: Worlds in the batch.
        instances: Which of them to return, in this order.
        roster: Robots that wait for clients, as P2AT:4,P2DX:2; on engine `c`, where any class can come at any
            time, those that are prepared before the first client.
        max_robots: Most robots of one world.
        seed: Seed of all random numbers; each world has its own.

    Raises:
        UsageError: No such instance, or a roster that does not parse.
        UnknownNameError: Unknown arena, engine or robot class.
        EngineError: The engine cannot run here.
    """
    check_instances(instances, worlds)
    if choose_engine(engine, "serve") == "c":
        spec, classes = find_arena(arena), dict.fromkeys(parse_roster(roster))
        made = [DynamicWorld(spec, seed=seed, number=i, max_robots=max_robots) for i in instances]
        for name in classes:
            # Prepared in one world for all: the results are kept by the robot's class.
            made[0].prepare(find_robot(name))
        return [*made]
    scene = parked_scene(arena, roster)
    chosen = choose_engine(engine, "serve")
    shared = SharedBatch(build_calibrated(lambda: Batch(scene, worlds, engine=chosen, seed=seed)))
    return [BatchWorld(shared, instance) for instance in instances]


def parked_scene(arena: str, roster: str, physics: Physics | None = None) -> Scene:
    """Return the scene of a batch whose robots wait for clients.

    Raises:
        UsageError: No robots, or a roster that does not parse.
        UnknownNameError: Unknown arena or robot class.
    """
    entries = [RosterEntry(robot=name, parked=True) for name in parse_roster(roster)]
    if not entries:
        raise UsageError("a batch needs a roster of robots for clients to claim, as --roster P2AT:4")
    return build_scene(arena, entries, physics)
