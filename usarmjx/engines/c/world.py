"""One world on C MuJoCo whose robots join and leave at run time.

`batch.CEngine` steps many worlds of one model; here the model is recompiled when a robot joins or leaves, and
the state of everything that stays is kept to the bit.
"""

from collections.abc import Callable, Mapping
from functools import partial

import mujoco
import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.rotations import quat_from_mat
from usarmjx.base.transforms import Vec3
from usarmjx.engines.base import GeomPoses, Inputs, PhysicsState
from usarmjx.engines.c.batch import MovedBody, buffer_warnings
from usarmjx.engines.c.faults import RecoveryResult, reset_all, step_and_recover
from usarmjx.engines.c.rays import CRayCaster
from usarmjx.models.compile.compose import RobotIndex, add_weld, materials_of, remove_weld, set_weld
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.types.arena import ArenaSpec


class CWorld:
    """One world.

    Args:
        spec: Its description, which `edit` changes.
        arena: The arena in it.
        substeps: Physics steps per control step.
        moved_geoms: Movable geoms of the arena; None: none.

    Attributes:
        model: The compiled model, replaced by every `edit`.
        data: Its state, likewise.
    """

    def __init__(
        self, spec: mujoco.MjSpec, arena: ArenaSpec, substeps: int, moved_geoms: MovedGeoms | None
    ) -> None:
        self._spec, self._arena, self._substeps = spec, arena, substeps
        self._moved_names = () if moved_geoms is None else moved_geoms.names
        # Faults are recovered per robot; by default C MuJoCo silently resets the whole world.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._resolve()

    def _resolve(self) -> None:
        ids = [self.model.geom(name).id for name in self._moved_names]
        self.model.geom_sameframe[ids] = 0
        self._moved_body = MovedBody(self.model, ids) if ids else None
        # The caster holds the model's arrays, which a compilation replaces.
        self._caster: CRayCaster | None = None

    def edit(
        self,
        change: Callable[[mujoco.MjSpec], None],
        undo: Callable[[mujoco.MjSpec], None],
        arena: ArenaSpec | None = None,
    ) -> None:
        """Change the description and recompile; the state of everything that stays is kept bit for bit.

        Args:
            change: Changes the description.
            undo: Reverts all of `change`, or the part that was done, if it or the compilation fails.
            arena: The arena after the change; None: the same.
        """
        try:
            change(self._spec)
            self.model, self.data = self._spec.recompile(self.model, self.data)
            self._arena = self._arena if arena is None else arena
        except Exception:
            undo(self._spec)
            self.model, self.data = self._spec.recompile(self.model, self.data)
            raise
        # Also after a failure: the undone description has been compiled anew, and ids may differ.
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

    def apply(self, inputs: Inputs, path: GeomPoses | None = None) -> None:
        """Set the inputs of a control step (no axis over worlds); no robot is ever parked here.

        Args:
            inputs: The inputs.
            path: All poses that movable geoms take in the next steps, as for `move`.
        """
        # In place: assigning the attribute would not reach MuJoCo's memory.
        self.data.ctrl[:], self.data.act[:] = inputs.ctrl, inputs.act
        self.data.xfrc_applied[:] = inputs.xfrc_applied
        self.move(inputs.geom_poses, path)

    def move(self, poses: GeomPoses | None, path: GeomPoses | None = None) -> None:
        """Move the movable geoms.

        Args:
            poses: Their current poses (geoms, ...).
            path: Poses of several steps, the current ones among them (steps, geoms, ...): their boxes are
                computed once; None: the next poses are unknown.
        """
        if poses is None or self._moved_body is None:
            return
        if path is None:
            self._moved_body.move(self.model, poses.pos, poses.quat, poses.size)
        else:
            self._moved_body.move_along(self.model, poses.pos, poses.quat, path)

    def advance(
        self, robots: Mapping[int, RobotIndex], limits: Mapping[int, float], homes: Mapping[int, Array]
    ) -> tuple[int, RecoveryResult]:
        """Make one control step; faulty robots are reset, see `faults.step_and_recover`.

        Args:
            robots: Indices of each robot in the model, by slot.
            limits: Highest plausible speed of each [m/s].
            homes: Home of each: position, orientation and joints (7 + joints,).

        Returns:
            Number of contact buffer overflows, and the reset objects.
        """
        before = buffer_warnings(self.data)
        recovery = step_and_recover(self.model, self.data, self._substeps, robots, limits, homes)
        return buffer_warnings(self.data) - before, recovery

    def reset_all(self, robots: Mapping[int, RobotIndex], homes: Mapping[int, Array]) -> None:
        """Reset robots to their homes, see `advance`, and all other movable bodies to the reference pose."""
        reset_all(self.model, self.data, robots, homes)

    def pose(self, index: RobotIndex) -> np.ndarray:
        """Return a robot's position [m] and orientation (7,)."""
        return self.data.qpos[index.root_qposadr : index.root_qposadr + 7].copy()

    def home(self, index: RobotIndex) -> np.ndarray:
        """Return where a robot is, to be reset to: position [m], orientation and joints (7 + joints,)."""
        return np.concatenate([self.pose(index), self.data.qpos[list(index.qposadr)]])

    def place(self, index: RobotIndex, pos: Array, quat: Array) -> None:
        """Teleport a robot to a pose [m], at rest; its joints stay as they are and go on turning."""
        root = index.root_qposadr
        self.data.qpos[root : root + 7] = (*pos, *quat)
        self.data.qvel[index.root_dofadr : index.root_dofadr + 6] = 0.0
        # Rays and poses are read before the next step, which would compute these.
        mujoco.mj_kinematics(self.model, self.data)

    def move_surface(self, name: str, velocity: Vec3) -> None:
        """Set the velocity of the surface of a geom, in its own axes [m/s]."""
        model = self.model
        # The description, too: the next `edit` compiles it.
        self._spec.geom(name).surfacevel[:3] = velocity  # type: ignore - not in the stubs
        model.geom_surfacevel[model.geom(name).id, :3] = velocity
        # MuJoCo skips surface velocities unless this flag, computed by the compiler, is set.
        model.flg_surfacevel = bool(np.any(model.geom_surfacevel))  # type: ignore - not in the stubs

    def hold(self, name: str, pos: Array | Vec3, quat: Array) -> None:
        """Hold an object at another pose [m], if it is held."""
        weld = self._spec.equality(name)
        if weld is not None:  # the description, too: the next `edit` compiles it
            for data in (weld.data, self.model.eq_data[self.model.equality(name).id]):
                set_weld(data, pos, quat)

    def weld(self, name: str, one: str, other: str) -> None:
        """Hold a body at its present pose in the axes of another one, by a weld of that name."""
        data = self.data
        # `mj_step` leaves poses from before its integration.
        mujoco.mj_kinematics(self.model, data)
        base, thing = self.model.body(one).id, self.model.body(other).id
        axes = data.xmat[base].reshape(3, 3).T
        with numpy_backend():
            quat = quat_from_mat(axes @ data.xmat[thing].reshape(3, 3))
        pose = axes @ (data.xpos[thing] - data.xpos[base]), quat
        add = partial(add_weld, name=name, one=one, other=other, pose=pose)
        self.edit(add, partial(remove_weld, name=name))

    def unweld(self, name: str) -> None:
        """Remove the weld of that name."""
        self.edit(partial(remove_weld, name=name), lambda spec: None)

    def caster(
        self, robots: Mapping[int, RobotIndex], poses: GeomPoses | None, path: GeomPoses | None = None
    ) -> CRayCaster:
        """Return a ray caster for the current state.

        Args:
            robots: Indices of each robot in the model, by slot.
            poses: Current poses of the movable geoms.
            path: Their poses in several steps, as for `move`.
        """
        self.move(poses, path)
        # As in `weld`: poses after the last step.
        mujoco.mj_kinematics(self.model, self.data)
        if self._caster is None:
            materials = materials_of(self.model, self._arena)
            self._caster = CRayCaster(self.model, self.data, materials, robots)
        return self._caster
