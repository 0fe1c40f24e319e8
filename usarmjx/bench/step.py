"""How fast a step is: bare physics and the whole step of the same model, in one run.

Bare is the engine alone under constant inputs (MJX's step mapped over the worlds, or `mj_step`); the
whole step adds random commands, control, bookkeeping, all sensors that are due, and resets of some worlds.
Rates count robots times physics steps. The share of the sensors is from the same step without them.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.bench.tools import append_record, record_header, time_repeats
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.engines import Inputs, choose_engine
from usarmjx.engines.c import c_model
from usarmjx.models.build.compose import PHYSICS
from usarmjx.models.generate import generate_many
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.server.worlds.make import parse_roster
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.control import ControlMode, idle_command, set_drive
from usarmjx.sim.robot_group import RobotGroup
from usarmjx.sim.scene import Scene, build_scene, start_height
from usarmjx.sim.site import moved_geom_poses

RESET_SHARE = 0.01
"""Share of worlds that are reset at each control step of the whole step."""
CONTROL_STEP = 0.05
"""[s]"""
BASELINE_STEPS = 400
SAMPLE_ARENAS = 64
"""Generated arenas that a shared one is chosen from."""


@dataclass(frozen=True, kw_only=True)
class StepCase:
    """What to measure; `steps` control steps of `substeps` physics steps, `repeats` times.

    Without `substeps`, control steps take 50 ms.

    With `generated` arenas, `arena` is the kind that is generated, and resets draw others of them. With 1 all
    worlds share one: the one with the most loose objects, and then solids, of `SAMPLE_ARENAS`, for a fair
    comparison, as a batch of many has room for the most of everything.
    """

    worlds: int
    roster: str = "P2AT"
    arena: str = "yellow"
    generated: int = 0
    engine: str = "auto"
    radio: bool = False
    physics: str = "reference"
    substeps: int | None = None
    steps: int = 20
    repeats: int = 5
    seed: int = 0


def _loop(batch: Batch, body: Callable[[jax.Array, Any], Any], steps: int) -> Callable[[Any], Any]:
    """Repeat `body`, inside one compiled function where the engine allows."""
    if batch.engine.traceable:
        return jax.jit(lambda state: jax.lax.fori_loop(0, steps, body, state))

    def run(state: Any) -> Any:  # noqa: ANN401
        for i in range(steps):
            state = body(jnp.int32(i), state)
        return state

    return run


def _bare_inputs(batch: Batch, speeds: jax.Array) -> Inputs:
    scene, worlds = batch.scene, batch.worlds
    model = scene.model
    return Inputs(
        ctrl=speeds,
        act=jnp.zeros((worlds, model.na)),
        xfrc_applied=jnp.zeros((worlds, model.nbody, 6)),
        pinned=jnp.zeros((worlds, model.nq), bool),
        pinned_dof=jnp.zeros((worlds, model.nv), bool),
        qpos=jnp.zeros((worlds, model.nq)),
    )


def _random_values(batch: Batch, group: RobotGroup, key: jax.Array) -> dict[str, jax.Array]:
    """Return a random number within its limits for every key of a group's DRIVE (worlds, robots)."""
    full, shape = group.robot.drive.full_scale, (batch.worlds, len(group.slots))
    keys = (jax.random.fold_in(key, int(group.slots[0]) * 16 + i) for i in range(len(full)))
    return {
        name: jax.random.uniform(k, shape, minval=-top, maxval=top)
        for k, (name, top) in zip(keys, full.items(), strict=True)
    }


def _physics_only(batch: Batch, key: jax.Array, state: BatchState) -> Callable[[jax.Array, Any], Any]:
    """The engine alone: new random wheel speeds each control step, servo targets kept near the joints.

    What of the arenas is data stays as it is at the start.
    """
    scene, start = batch.scene, jnp.zeros(())
    standing = jax.vmap(lambda world: moved_geom_poses(scene, world.arena_state, start))(state.worlds)

    def body(i: jax.Array, physics: Any) -> Any:  # noqa: ANN401
        now = batch.engine.state(physics)
        ctrl, act = jnp.zeros((batch.worlds, batch.scene.model.nu)), now.act
        for group in batch.scene.groups:
            values = _random_values(batch, group, jax.random.fold_in(key, i))
            shape = (batch.worlds, len(group.slots))
            still = jax.tree.map(
                lambda x, s=shape: jnp.broadcast_to(x, (*s, *x.shape)), idle_command(group.robot)
            )
            here = group.plan.actuated
            command = set_drive(group.robot, still, values)
            speeds = jnp.where(command.mode == ControlMode.VELOCITY, command.target, 0.0)
            ctrl = (
                ctrl.at[:, group.actuator_ids].set(speeds[..., here]).at[:, group.hold_actuator_ids].set(1.0)
            )
            act = jnp.asarray(act).at[:, group.actadr].set(now.qpos[:, group.qposadr[:, here]])
        return batch.engine.advance(physics, _bare_inputs(batch, ctrl).replace(act=act, geom_poses=standing))

    return body


def _full_step(
    batch: Batch, key: jax.Array, *, sensing: bool = True
) -> Callable[[jax.Array, BatchState], BatchState]:
    def body(i: jax.Array, state: BatchState) -> BatchState:
        now = jax.random.fold_in(key, i)
        for t, group in enumerate(batch.scene.groups):
            state = batch.drive(state, t, _random_values(batch, group, now))
        state = batch.step(state)
        if sensing:
            state, _ = batch.observe(state)
        if batch.scene.radio is not None:
            state, _ = batch.links(state)
        again = jax.random.uniform(jax.random.fold_in(now, 1), (batch.worlds,)) < RESET_SHARE
        return batch.reset_where(state, again)

    return body


def _baseline(scene: Scene, speeds: np.ndarray) -> float:
    """Robot-steps per second of plain `mj_step` on one CPU core, one world."""
    model = c_model(scene.model)
    data = mujoco.MjData(model)
    for group in scene.groups:
        for slot, address in zip(group.slots, group.root_qposadr, strict=True):
            start = scene.arena.starts[slot]
            data.qpos[address[:3]] = (*start.at[:2], start_height(scene.arena, start, group.robot))
    data.ctrl[: speeds.size] = speeds
    mujoco.mj_step(model, data, nstep=BASELINE_STEPS // 4)
    began = time.perf_counter()
    mujoco.mj_step(model, data, nstep=BASELINE_STEPS)
    return BASELINE_STEPS * scene.num_robots / (time.perf_counter() - began)


def _arena(case: StepCase) -> str | ArenaSpec | list[ArenaSpec]:
    """Return the arena of a case, or all its arenas; a single generated one is shared by all worlds."""
    if not case.generated:
        return case.arena
    if case.generated > 1:
        return generate_many(case.arena, case.generated, seed=case.seed)
    sample = generate_many(case.arena, SAMPLE_ARENAS, seed=case.seed)
    return max(sample, key=lambda arena: (len(arena.loose), len(arena.shapes)))


def measure_step(case: StepCase, file: Path | None = None) -> str:
    """Run a case, append its record to `file` as a JSON line, and return a summary for people.

    Raises:
        EngineError: A contact buffer overflowed, so the figures would be wrong.
    """
    engine = choose_engine(case.engine, "train")
    kept: dict[str, Any] = {"radio": RadioSettings()} if case.radio else {}
    physics = PHYSICS.get(case.physics)
    substeps = case.substeps or round(CONTROL_STEP / physics.timestep)
    scene = build_scene(_arena(case), parse_roster(case.roster), replace(physics, substeps=substeps), **kept)
    batch = Batch(scene, case.worlds, engine=engine, seed=case.seed, shuffle=True)
    key = jax.random.key(case.seed + 1)
    state = batch.reset()
    run = partial(time_repeats, repeats=case.repeats)
    bare_first, bare, _ = run(_loop(batch, _physics_only(batch, key, state), case.steps), state.physics)
    whole_first, whole, state = run(_loop(batch, _full_step(batch, key), case.steps), state)
    _, blind, state = run(_loop(batch, _full_step(batch, key, sensing=False), case.steps), state)
    batch.check_overflow(state)
    work = case.worlds * scene.num_robots * substeps * case.steps
    status = jax.tree.map(lambda count: int(count.sum()), vars(state.worlds.faults))
    rays = sum(len(group.slots) * sum(group.suite.ray_counts) for group in scene.groups)
    bare_rate, whole_rate = work / statistics.median(bare), work / statistics.median(whole)
    record = {
        **record_header("step", host=engine == "c"),
        "case": {**asdict(case), "engine": engine, "substeps": substeps},
        "robots_per_world": scene.num_robots,
        "arena_geoms": len(scene.fixed_geoms.kind) + len(scene.moved_geom_table.kind),
        "loose_objects": len(scene.arena.loose),
        "timestep": scene.physics.timestep,
        "in_the_step": "contacts, random commands, control, all sensors of the robots when due, "
        f"resets of {RESET_SHARE:.0%} of worlds every control step; "
        + (
            "all links of the radio every control step, no rendering"
            if case.radio
            else "no radio, no rendering"
        ),
        "rays_when_all_are_due": rays * case.worlds,
        "bare_robot_steps_per_s": bare_rate,
        "robot_steps_per_s": whole_rate,
        "robots_in_real_time": whole_rate * physics.timestep,
        "whole_to_bare": whole_rate / bare_rate,
        "sensors": {
            group.robot.name: [sensor.kind for sensor in group.suite.sensors] for group in scene.groups
        },
        "sensors_share": 1 - statistics.median(blind) / statistics.median(whole),
        "bare_times_s": bare,
        "whole_times_s": whole,
        "blind_times_s": blind,
        "compile_s": {"bare": bare_first - bare[0], "whole": whole_first - whole[0]},
        "cpu_mujoco_robot_steps_per_s": _baseline(scene, np.full(scene.model.nu, 1.0)),
        "faults": status,
    }
    append_record(record, file)
    return _summary(record)


def _summary(record: dict[str, Any]) -> str:
    case = record["case"]
    return "\n".join(
        [
            f"{case['worlds']} worlds x {case['roster']}, engine {case['engine']} on {record['device']}",
            f"bare physics  {record['bare_robot_steps_per_s']:12,.0f} robot-steps/s",
            f"whole step    {record['robot_steps_per_s']:12,.0f} robot-steps/s  ({record['in_the_step']})",
            f"in real time  {record['robots_in_real_time']:12,.0f} robots",
            f"ratio         {record['whole_to_bare']:12.2f}",
            f"sensors       {record['sensors_share']:12.1%} of the whole step",
            f"mj_step       {record['cpu_mujoco_robot_steps_per_s']:12,.0f} robot-steps/s, bare, one core",
            f"compile [s]   bare {record['compile_s']['bare']:.1f}, whole {record['compile_s']['whole']:.1f}",
            f"faults        {record['faults']}",
        ]
    )
