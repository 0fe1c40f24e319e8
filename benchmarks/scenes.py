"""Common part of the benchmarks of step, compilation and memory: a batch of a scene."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.cases import SceneCase, SceneOptions
from usarmjx.base.backend import Array
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.engines import Inputs, PhysicsState, choose_engine
from usarmjx.engines.base import choose_solver
from usarmjx.models.compile.physics import PHYSICS
from usarmjx.models.generate import generate_many
from usarmjx.models.generate.kinds import DEFAULT_STARTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.server.worlds.make import parse_roster
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.calibration import build_calibrated
from usarmjx.sim.control import ControlMode, idle_command, set_drive
from usarmjx.sim.ray_geometry import moved_geom_poses
from usarmjx.sim.scene import RobotGroup, Scene, build_scene, start_height

RESET_SHARE = 0.01
"""Share of worlds that are reset at each control step of the whole step."""


def repeat_loop(
    batch: Batch, body: Callable[..., Any], steps: int, given: tuple[Array, ...] = ()
) -> Callable[[Any], Any]:
    """Repeat `body(i, state, *given)`, inside one compiled function where the engine allows.

    Given arrays of many worlds stay data: as constants they would be worked with while compiling.
    """
    if batch.engine.traceable:
        loop = jax.jit(
            lambda state, *given: jax.lax.fori_loop(0, steps, lambda i, now: body(i, now, *given), state)
        )
        return lambda state: loop(state, *given)

    def run(state: Any) -> Any:  # noqa: ANN401
        for i in range(steps):
            state = body(jnp.int32(i), state, *given)
        return state

    return run


def _inputs(batch: Batch, ctrl: jax.Array, act: Array) -> Inputs:
    model, worlds = batch.scene.model, batch.worlds
    return Inputs(
        ctrl=ctrl,
        act=act,
        xfrc_applied=jnp.zeros((worlds, model.nbody, 6)),
        pinned=jnp.zeros((worlds, model.nq), bool),
        pinned_dof=jnp.zeros((worlds, model.nv), bool),
        qpos=jnp.zeros((worlds, model.nq)),
    )


def _random_values(group: RobotGroup, worlds: int, key: jax.Array) -> dict[str, jax.Array]:
    """Return a random number within its limits for every key of a group's DRIVE (worlds, robots)."""
    full, shape = group.robot.drive.full_scale, (worlds, len(group.slots))
    keys = (jax.random.fold_in(key, int(group.slots[0]) * 16 + i) for i in range(len(full)))
    return {
        name: jax.random.uniform(k, shape, minval=-top, maxval=top)
        for k, (name, top) in zip(keys, full.items(), strict=True)
    }


def random_actuation(
    scene: Scene, worlds: int, key: jax.Array, qpos: Array, act: Array
) -> tuple[jax.Array, jax.Array]:
    """Return random wheel speeds, and servo targets that are where the joints are.

    Args:
        scene: Scene that every world copies.
        worlds: Number.
        key: Of the random numbers.
        qpos: Positions (worlds, nq).
        act: Activations (worlds, na).

    Returns:
        Actuator inputs (worlds, nu) and activations (worlds, na).
    """
    # Columns of others: writing single ones took a GPU 0.25 ms of a step in 65,536 worlds.
    still, ones = jnp.zeros((worlds, 1)), jnp.ones((worlds, 1))
    columns, source = [still, ones], np.zeros(scene.model.nu, int)
    kept = np.arange(scene.model.na)
    for group in scene.groups:
        values, shape = _random_values(group, worlds, key), (worlds, len(group.slots))
        idle = jax.tree.map(lambda x, s=shape: jnp.broadcast_to(x, (*s, *x.shape)), idle_command(group.robot))
        here = group.plan.actuated
        command = set_drive(group.robot, idle, values)
        speeds = jnp.where(command.mode == ControlMode.VELOCITY, command.target, 0.0)[..., here]
        first = sum(column.shape[1] for column in columns)
        columns.append(speeds.reshape(worlds, -1))
        source[group.hold_actuator_ids] = 1
        source[group.actuator_ids] = first + np.arange(columns[-1].shape[1]).reshape(group.actuator_ids.shape)
        kept[group.actadr] = len(kept) + group.qposadr[:, here]
    both = jnp.concatenate([jnp.asarray(act), jnp.asarray(qpos)], 1)
    return jnp.concatenate(columns, 1)[:, source], both[:, kept]


def bare_step(
    batch: Batch, key: jax.Array, state: BatchState
) -> tuple[Callable[..., Any], tuple[Array, ...]]:
    """The engine alone: new random wheel speeds each control step, servo targets kept near the joints.

    Returns:
        A body for `repeat_loop`, and what it is given: poses of what of the arenas is data, which stay as
        they are at the start.
    """
    scene, start = batch.scene, jnp.zeros(())
    standing = jax.vmap(lambda world: moved_geom_poses(scene, world.arena_state, start))(state.worlds)

    flat, shape = jax.tree.flatten(standing)
    order = jax.jit(partial(random_actuation, scene, batch.worlds))  # else engine `c` waits for its orders

    def body(i: jax.Array, physics: Any, *standing: Array) -> Any:  # noqa: ANN401
        now: PhysicsState = batch.engine.state(physics)
        ctrl, act = order(jax.random.fold_in(key, i), now.qpos, now.act)
        poses = jax.tree.unflatten(shape, standing)
        return batch.engine.advance(physics, _inputs(batch, ctrl, act).replace(geom_poses=poses))

    return body, tuple(flat)


def whole_step(
    batch: Batch, key: jax.Array, *, sensing: bool = True
) -> Callable[[jax.Array, BatchState], BatchState]:
    """All of a control step: random commands, control, physics, sensors, radio if there is one, resets."""

    def body(i: jax.Array, state: BatchState) -> BatchState:
        now = jax.random.fold_in(key, i)
        for t, group in enumerate(batch.scene.groups):
            state = batch.drive(state, t, _random_values(group, batch.worlds, now))
        state = batch.step(state)
        if sensing:
            state, _ = batch.observe(state)
        if batch.scene.radio is not None:
            state, _ = batch.links(state)
        again = jax.random.uniform(jax.random.fold_in(now, 1), (batch.worlds,)) < RESET_SHARE
        return batch.reset_where(state, again)

    return body


def spread_over_worlds(values: np.ndarray) -> dict[str, float]:
    """Return mean, 95th percentile and largest of numbers."""
    return {
        "mean": float(values.mean()),
        "p95": float(np.quantile(values, 0.95)),
        "most": float(values.max()),
    }


class SceneFigures:
    """Looks at a batch now and then, and says what its scene is.

    Args:
        batch: The batch.
    """

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._seen: dict[str, list[np.ndarray]] = {}

    def look(self, state: BatchState) -> None:
        """Take note of what the engine tells of the last physics step of all worlds."""
        solved = self._batch.engine.solved(state.physics)
        for name, values in {} if solved is None else solved._asdict().items():
            if values is not None:
                self._seen.setdefault(name, []).append(np.asarray(values, float))

    def result(self, state: BatchState) -> dict[str, Any]:
        """Return the scene's sizes, what the solver met, and how many worlds went bad."""
        faults = jax.tree.map(np.asarray, vars(state.worlds.faults))
        bad = faults["not_finite"] + faults["runaway"] > 0
        told = {name: None for name in ("contacts", "constraint_rows", "solver_iterations")}
        told |= {name: spread_over_worlds(np.concatenate(rows)) for name, rows in self._seen.items()}
        return {
            **sizes(self._batch.scene),
            **told,
            "overflow": int((faults["overflow"] > 0).sum()),
            "bad_worlds": int(bad.sum()),
        }


def sizes(scene: Scene) -> dict[str, int]:
    """Return how large a scene's model is."""
    model = scene.model
    touching = (model.geom_contype | model.geom_conaffinity) != 0
    return {
        "robots": scene.num_robots,
        "geoms": int(model.ngeom),
        "touching_geoms": int(touching.sum()),
        "bodies": int(model.nbody),
        "degrees_of_freedom": int(model.nv),
    }


CONTROL_STEP = 0.05
"""[s]"""
USUAL_SIZE, USUAL_TEAM = (8, 6), 16
"""Cells of a generated arena [1.2 m], and the largest team in it; larger ones have larger arenas."""
SAMPLE_ARENAS = 64
"""Generated arenas that a shared one is chosen from."""


def resolved(case: SceneOptions, batch: Batch | None = None) -> dict[str, Any]:
    """Return the engine and the substeps that a case means, and the solver if it is `block`.

    Of the solver `auto` older records say nothing: it was CG.

    Args:
        case: The case.
        batch: Its worlds, if they are there: their engine says whether the solver covers the scene.

    Raises:
        UnknownNameError: No such engine or physics.
    """
    engine = choose_engine(case.engine, "batch")
    physics = case.replaced(PHYSICS.get(case.physics))
    usual = choose_solver(physics, engine)
    ran = usual if batch is None else getattr(batch.engine, "solver", usual)
    solver = {"solver": ran} if ran == "block" or usual == "block" else {}
    return {"engine": engine, "substeps": case.substeps or round(CONTROL_STEP / physics.timestep), **solver}


def scene_of(case: SceneOptions) -> Scene:
    """Build the scene of a case.

    Raises:
        UsarmjxError: The roster or the arena cannot be built.
    """
    kept: dict[str, Any] = {"radio": RadioSettings()} if case.radio else {}
    physics = replace(case.replaced(PHYSICS.get(case.physics)), substeps=resolved(case)["substeps"])
    return build_scene(_arena(case), parse_roster(case.roster), physics, **kept)


def batch_of(case: SceneCase, scene: Scene) -> Batch:
    """Build the batch of a case's scene; resets draw start poses."""
    settings: dict[str, Any] = {"engine": resolved(case)["engine"], "seed": case.seed, "shuffle": True}
    return build_calibrated(lambda: Batch(scene, case.worlds, **settings))


def _arena(case: SceneOptions) -> str | ArenaSpec | list[ArenaSpec]:
    """Return the arena, or all arenas; a single generated one is shared by all worlds."""
    if not case.generated:
        return case.arena
    if case.generated > 1:
        return _generate(case, case.generated)
    sample = _generate(case, SAMPLE_ARENAS)
    return max(sample, key=lambda arena: (len(arena.loose), len(arena.shapes)))


def _generate(case: SceneOptions, count: int) -> list[ArenaSpec]:
    robots = len(parse_roster(case.roster))
    starts = max(DEFAULT_STARTS, robots)
    return generate_many(
        case.arena, count, seed=case.seed, size=case.cells or cells_for(robots), starts=starts
    )


def cells_for(robots: int) -> tuple[int, int]:
    """Return columns and rows of a generated arena in which a team has as much room as sixteen in 8 x 6."""
    if robots <= USUAL_TEAM:
        return USUAL_SIZE
    cells = robots * math.prod(USUAL_SIZE) / USUAL_TEAM
    columns = math.ceil(math.sqrt(cells * USUAL_SIZE[0] / USUAL_SIZE[1]))
    return columns, math.ceil(cells / columns)


def start_qpos(scene: Scene) -> np.ndarray:
    """Return positions with every robot at its start pose (nq,)."""
    qpos = np.array(scene.model.qpos0)
    for group in scene.groups:
        for slot, address in zip(group.slots, group.root_qposadr, strict=True):
            start = scene.arena.starts[slot]
            qpos[address[:3]] = (*start.at[:2], start_height(scene.arena, start, group.robot))
    return qpos
