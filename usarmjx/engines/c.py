"""C MuJoCo: starts at once, needs no accelerator, and is the oracle for the others."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.engines.base import Engine, Inputs, PhysicsState
from usarmjx.models.compose import Physics
from usarmjx.models.moved import MovedGeoms
from usarmjx.threads import cores
from usarmjx.transforms import Array

EVERYTHING = mujoco.mjtState.mjSTATE_INTEGRATION
"""All that a step depends on, warm start included, so that a state can be stepped again bit for bit."""


class CState(NamedTuple):
    """Integration states (worlds, n), the visible part of them, and warnings about full buffers (worlds,)."""

    everything: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    overflow: np.ndarray


def c_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy that does not silently reset a world that went bad; we count and reset those."""
    copy = model.__copy__()
    copy.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return copy


def move_geoms(
    model: mujoco.MjModel, ids: list[int], pos: Array, quat: Array, size: Array | None = None
) -> None:
    """Put geoms of the model elsewhere: pos (n, 3), quat (n, 4), and boxes' sizes (n, 3) if they change.

    The model must have its midphase disabled (its tree of bounding boxes would be out of date) and
    `geom_sameframe` cleared.
    """
    model.geom_pos[ids], model.geom_quat[ids] = pos, quat
    if size is not None:
        model.geom_size[ids], model.geom_aabb[ids, 3:] = size, size
        model.geom_rbound[ids] = np.linalg.norm(size, axis=-1)


def buffer_warnings(data: mujoco.MjData) -> int:
    """Return how often this data's contact or constraint buffer was too small."""
    full = (mujoco.mjtWarning.mjWARN_CONTACTFULL, mujoco.mjtWarning.mjWARN_CNSTRFULL)
    return int(sum(data.warning[w].number for w in full))


def _pin(data: mujoco.MjData, pinned: Array, pinned_dof: Array, qpos: Array) -> None:
    np.copyto(data.qpos, qpos, where=pinned)
    data.qvel[pinned_dof] = 0.0
    data.qacc_warmstart[pinned_dof] = 0.0


class CEngine(Engine):
    """Steps worlds one by one, on all cores."""

    name = "c"
    traceable = False

    def __init__(
        self, spec: mujoco.MjSpec, physics: Physics, worlds: int, moved: MovedGeoms | None = None
    ) -> None:
        super().__init__(spec, physics, worlds, moved)
        count = min(worlds, cores())
        # Each thread has its own model, as the arena of the world that it steps is part of it.
        self._models = [self.model if moved is None else self.model.__copy__() for _ in range(count)]
        self._datas = [mujoco.MjData(self.model) for _ in range(count)]
        self._pool = ThreadPoolExecutor(count) if count > 1 else None

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Return the model, with silent resets off."""
        model = c_model(spec.compile())
        if self.moved is not None:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
        return model

    def start(self) -> CState:
        """Return every world at the model's reference configuration."""
        size = mujoco.mj_stateSize(self.model, EVERYTHING)
        blank = CState(
            everything=np.zeros((self.worlds, size)),
            qpos=np.zeros((self.worlds, self.model.nq)),
            qvel=np.zeros((self.worlds, self.model.nv)),
            act=np.zeros((self.worlds, self.model.na)),
            overflow=np.zeros(self.worlds, np.int32),
        )
        return self.reset(blank, np.ones(self.worlds, bool), np.tile(self.model.qpos0, (self.worlds, 1)))

    def _save(self, data: mujoco.MjData, state: CState, world: int) -> None:
        mujoco.mj_getState(self.model, data, state.everything[world], EVERYTHING)
        state.qpos[world], state.qvel[world], state.act[world] = data.qpos, data.qvel, data.act

    def advance(self, own: CState, inputs: Inputs) -> CState:
        """Step every world by one control step."""
        new = CState(*(array.copy() for array in own))
        told = jax.tree.map(np.asarray, inputs)

        def work(thread: int) -> None:
            model, data = self._models[thread], self._datas[thread]
            for world in range(thread, self.worlds, len(self._datas)):
                mujoco.mj_setState(model, data, own.everything[world], EVERYTHING)
                self._apply(data, told, world)
                if told.places is not None:
                    here = told.places
                    size = None if here.size is None else here.size[world]
                    move_geoms(model, self.moved_ids, here.pos[world], here.quat[world], size)
                before = buffer_warnings(data)
                mujoco.mj_step(model, data, nstep=self.physics.substeps)
                new.overflow[world] = buffer_warnings(data) - before
                self._save(data, new, world)

        if self._pool is None:
            work(0)
        else:
            list(self._pool.map(work, range(len(self._datas))))
        return new

    def _apply(self, data: mujoco.MjData, told: Inputs, world: int) -> None:
        data.ctrl[:], data.act[:] = told.ctrl[world], told.act[world]
        data.xfrc_applied[:] = told.xfrc_applied[world]
        _pin(data, told.pinned[world], told.pinned_dof[world], told.qpos[world])

    def place(self, own: CState, pinned: Array, pinned_dof: Array, qpos: Array) -> CState:
        """Put the pinned coordinates at qpos, at rest."""
        new = CState(*(array.copy() for array in own))
        data = self._datas[0]
        for world in np.flatnonzero(np.asarray(pinned).any(-1)):
            mujoco.mj_setState(self.model, data, own.everything[world], EVERYTHING)
            _pin(data, np.asarray(pinned)[world], np.asarray(pinned_dof)[world], np.asarray(qpos)[world])
            self._save(data, new, int(world))
        return new

    def reset(self, own: CState, mask: Array, qpos: Array) -> CState:
        """Put the masked worlds at rest at qpos; the others are untouched."""
        new = CState(*(array.copy() for array in own))
        data = self._datas[0]
        for world in np.flatnonzero(np.asarray(mask)):
            mujoco.mj_resetData(self.model, data)
            data.qpos[:] = np.asarray(qpos[world])
            self._save(data, new, int(world))
        return new

    def state(self, own: CState) -> PhysicsState:
        """Return positions, velocities and activations in single precision."""
        return PhysicsState(
            qpos=jnp.asarray(own.qpos, jnp.float32),
            qvel=jnp.asarray(own.qvel, jnp.float32),
            act=jnp.asarray(own.act, jnp.float32),
        )

    def overflow(self, own: CState, inputs: Inputs) -> jnp.ndarray:
        """Return the number of buffer warnings of the last step (worlds,)."""
        del inputs
        return jnp.asarray(own.overflow)
