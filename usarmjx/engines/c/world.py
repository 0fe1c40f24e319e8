"""One world on C MuJoCo whose robots come and go while it runs.

`c.CEngine` steps many worlds of one model; here the model is recompiled when a robot joins or leaves, and the
state of all that stays is kept to the bit.
"""

from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.engines.base import GeomPoses, Inputs, PhysicsState
from usarmjx.engines.c.batch import buffer_warnings
from usarmjx.engines.c.faults import RecoveryResult, put_all_back, step_and_recover
from usarmjx.engines.c.moved_geoms import MovedBody
from usarmjx.engines.c.rays import CRayCaster
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.layout import RobotIndex
from usarmjx.models.compile.materials import materials_of
from usarmjx.models.types.arena import ArenaSpec


class CWorld:
    """One world.

    Args:
        spec: Its description, which `edit` changes.
        arena: The arena in it.
        substeps: Physics steps per control step.
        moved_geoms: Geoms of the arena that move; None: there are none.

    Attributes:
        model: The compiled model, another one after every `edit`.
        data: Its state, likewise.
    """

    def __init__(
        self, spec: mujoco.MjSpec, arena: ArenaSpec, substeps: int, moved_geoms: MovedGeoms | None
    ) -> None:
        self._spec, self._arena, self._substeps = spec, arena, substeps
        self._moved_names = () if moved_geoms is None else moved_geoms.names
        # We count and mend what goes bad; C MuJoCo would reset the world without a word.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._resolve()

    def _resolve(self) -> None:
        ids = [self.model.geom(name).id for name in self._moved_names]
        self.model.geom_sameframe[ids] = 0
        self._moved_body = MovedBody(self.model, ids) if ids else None
        self._caster: CRayCaster | None = None

    def edit(self, change: Callable[[mujoco.MjSpec], None], undo: Callable[[mujoco.MjSpec], None]) -> None:
        """Change the description and compile it; the states of all that stays are kept bit for bit.

        Args:
            change: Changes it.
            undo: Takes back what it did, all or a part of it, if it or the compilation fails.
        """
        try:
            change(self._spec)
            self.model, self.data = self._spec.recompile(self.model, self.data)
        except Exception:
            undo(self._spec)
            self.model, self.data = self._spec.recompile(self.model, self.data)
            raise
        finally:
            self._resolve()

    def state(self) -> PhysicsState:
        """Return positions, velocities and activations in single precision, without an axis over worlds."""
        data = self.data
        return PhysicsState(
            qpos=data.qpos.astype(np.float32),
            qvel=data.qvel.astype(np.float32),
            act=data.act.astype(np.float32),
        )

    def apply(self, inputs: Inputs) -> None:
        """Take the inputs of a control step (no axis over worlds); nobody is ever parked here."""
        self.data.ctrl[:], self.data.act[:] = inputs.ctrl, inputs.act
        self.data.xfrc_applied[:] = inputs.xfrc_applied
        self.move(inputs.geom_poses)

    def move(self, poses: GeomPoses | None) -> None:
        """Put the geoms that move where they are now."""
        if poses is not None and self._moved_body is not None:
            self._moved_body.move(self.model, poses.pos, poses.quat)

    def advance(
        self, robots: Mapping[int, RobotIndex], limits: Mapping[int, float], homes: Mapping[int, Array]
    ) -> tuple[int, RecoveryResult]:
        """Advance by a control step; robots that go bad are put back, see `faults.step_and_recover`.

        Args:
            robots: Where each robot is in the model, by slot.
            limits: Up to which speed each is sound [m/s].
            homes: Where each is put back: position and orientation (7,).

        Returns:
            How often a contact buffer was too small, and what was put back.
        """
        before, floor = buffer_warnings(self.data), self._arena.floor
        put_back = step_and_recover(self.model, self.data, self._substeps, robots, limits, homes, floor)
        return buffer_warnings(self.data) - before, put_back

    def put_all_back(self, robots: Mapping[int, RobotIndex], homes: Mapping[int, Array]) -> None:
        """Put robots back to their homes, see `advance`, and all else that moves where the model has it."""
        put_all_back(self.model, self.data, robots, homes, self._arena.floor)

    def pose(self, index: RobotIndex) -> np.ndarray:
        """Return where a robot is: position [m] and orientation (7,)."""
        return self.data.qpos[index.root_qposadr : index.root_qposadr + 7].copy()

    def place(self, index: RobotIndex, pos: Array, quat: Array) -> None:
        """Put a robot somewhere [m], at rest."""
        root = index.root_qposadr
        self.data.qpos[root : root + 7] = (*pos, *quat)
        self.data.qvel[index.root_dofadr : index.root_dofadr + 6] = 0.0
        mujoco.mj_kinematics(self.model, self.data)

    def caster(self, robots: Mapping[int, RobotIndex], poses: GeomPoses | None) -> CRayCaster:
        """Return what casts rays at the world as it is now.

        Args:
            robots: Where each robot is in the model, by slot.
            poses: Where the geoms that move are now.
        """
        self.move(poses)
        mujoco.mj_kinematics(self.model, self.data)
        if self._caster is None:
            materials = materials_of(self.model, self._arena)
            self._caster = CRayCaster(self.model, self.data, materials, robots)
        return self._caster
