"""The engine of a scene."""

from typing import Any

from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.engines import choose_engine, make_engine
from usarmjx.engines.base import Engine
from usarmjx.sim.scene import Scene

LONGEST_SOLVED_STEP = 0.025
"""With longer steps a solver of contacts throws robots about [s]."""


def engine_of(scene: Scene, name: str, worlds: int) -> Engine[Any]:
    """Build the engine that steps copies of a scene.

    Args:
        scene: The scene.
        name: Of the engine, or `auto`: the best to train with here.
        worlds: How many copies.

    Raises:
        UnknownNameError: No such engine.
        UnsupportedFeatureError: The scene has a feature that the engine would ignore, or too long steps.
        EngineError: The engine cannot run here.
    """
    kind = choose_engine(name, "batch")
    if kind == "planar":
        from usarmjx.sim.calibration import ensure_calibrated  # it needs batches, which need engines

        ensure_calibrated(robot for robot, _ in scene.robots)
    elif scene.physics.timestep > LONGEST_SOLVED_STEP:
        raise UnsupportedFeatureError(
            f"engine {kind!r} cannot run this scene: physics steps of {scene.physics.timestep:g} s are for "
            f"engine planar, others take up to {LONGEST_SOLVED_STEP:g} s"
        )
    built = scene.spec, scene.physics, worlds, scene.moved_geoms, scene.varied_bodies
    return make_engine(kind, *built, robots=scene.robots)
