"""What is timed of a batch: bare physics, the whole step, the whole step without sensors; in a loop."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.engines import Inputs, PhysicsState
from usarmjx.sim.batch import Batch
from usarmjx.sim.batch_state import BatchState
from usarmjx.sim.control import ControlMode, idle_command, set_drive
from usarmjx.sim.robot_group import RobotGroup
from usarmjx.sim.scene import Scene
from usarmjx.sim.site import moved_geom_poses

RESET_SHARE = 0.01
"""Share of worlds that are reset at each control step of the whole step."""


def repeat_loop(
    batch: Batch, body: Callable[..., Any], steps: int, given: tuple[Array, ...] = ()
) -> Callable[[Any], Any]:
    """Repeat `body(i, state, *given)`, inside one compiled function where the engine allows.

    What of many worlds is given stays data: as a constant it would be worked with while compiling.
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
        scene: What every world is a copy of.
        worlds: How many.
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
