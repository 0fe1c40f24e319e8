"""Engine `c`: batches on C MuJoCo, which starts at once and is the oracle of the other engines.

Geoms may move between worlds. MuJoCo builds the bounding volume hierarchy of a body at compile time: it would
be outdated for moved geoms, and without it each geom of a robot is tested against each of the arena's. It is
rebuilt here when many geoms have moved (another arena), and refitted when a few have (limbs of victims).
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.process import cores
from usarmjx.base.rotations import mat_from_quat
from usarmjx.engines.base import Engine, GeomPoses, Inputs, PhysicsState, SolvedStep
from usarmjx.engines.c.bounding_trees import TreeShape, tree_shape
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import RandomizedBodies

REBUILD_FRACTION = 0.5
"""Fraction of moved geoms above which the hierarchy is rebuilt."""
PATH_MARGIN = 1e-9
"""Enlargement of boxes around paths against rounding [m]."""


class BoundingTree(NamedTuple):
    """Bounding volume hierarchy of one world.

    Attributes:
        places: Position, orientation and half sizes of the bounding box of each movable geom (movable, 10).
        leaves: Centre and half size of each geom's box (geoms, 6).
        shape: Its topology.
        boxes: Centre and half size of each node's box (nodes, 6).
    """

    places: np.ndarray
    leaves: np.ndarray
    shape: TreeShape
    boxes: np.ndarray


class MovedBody:
    """Movable geoms of a static body at the world's origin, and their hierarchy in each world.

    Args:
        model: The compiled model, which gets this hierarchy.
        ids: The movable geoms, all of one body.
    """

    def __init__(self, model: mujoco.MjModel, ids: list[int]) -> None:
        self.ids = np.array(ids)
        body, tree = int(model.geom_bodyid[ids[0]]), _bvh_fields(model)
        begin, count = int(tree.body_bvhadr[body]), int(tree.body_bvhnum[body])
        self._nodes = slice(begin, begin + count)
        leaves: np.ndarray = tree.bvh_nodeid[self._nodes]
        # Inner nodes have -1.
        self._geoms: np.ndarray = np.sort(leaves[leaves >= 0])
        self._movable = np.flatnonzero(np.isin(self._geoms, self.ids))
        self._rows = np.array([ids.index(geom) for geom in self._geoms[self._movable].tolist()], int)
        self._worlds: dict[int, BoundingTree] = {}
        self._written: dict[int, BoundingTree] = {}
        self._covered: GeomPoses | None = None
        if len(self._geoms):
            with numpy_backend():
                self._frame = np.asarray(mat_from_quat(model.body_iquat[body]))
            self._write_tree(model, self._bounding_tree(model, 0))

    def move(
        self, model: mujoco.MjModel, pos: Array, quat: Array, size: Array | None = None, world: int = 0
    ) -> None:
        """Move the geoms. The model must have their `geom_sameframe` cleared.

        Args:
            model: The model.
            pos: Positions (n, 3) [m].
            quat: Orientations (n, 4).
            size: Half sizes (n, 3) [m] of boxes; None: unchanged.
            world: The world, whose hierarchy is kept for its next call.
        """
        model.geom_pos[self.ids], model.geom_quat[self.ids] = pos, quat
        # Geoms with sizes of their own are boxes, whose half lengths are those of the bounding box, too.
        if size is not None:
            model.geom_size[self.ids], model.geom_aabb[self.ids, 3:] = size, size
            model.geom_rbound[self.ids] = np.linalg.norm(size, axis=-1)
        self._covered = None
        if len(self._geoms):
            self._write_tree(model, self._bounding_tree(model, world))

    def move_along(self, model: mujoco.MjModel, pos: Array, quat: Array, path: GeomPoses) -> None:
        """Move the geoms of the only world along a path, whose boxes are computed once.

        MuJoCo tests the pairs whose boxes overlap exactly: larger boxes change no contact and no ray.

        Args:
            model: The model; the same one in all calls.
            pos: Positions (n, 3) [m].
            quat: Orientations (n, 4).
            path: All poses on the path, these among them: (steps, n, 3) and (steps, n, 4).
        """
        model.geom_pos[self.ids], model.geom_quat[self.ids] = pos, quat
        if self._covered is path or not len(self._movable):
            return
        known = self._worlds.get(0) or self._bounding_tree(model, 0)
        places, turns = (np.asarray(part, float)[:, self._rows] for part in (path.pos, path.quat))
        boxes = _bounding_boxes(model, self._geoms[self._movable], places, turns, self._frame)
        mid, half = boxes[..., :3], boxes[..., 3:]
        low, high = (mid - half).min(0) - PATH_MARGIN, (mid + half).max(0) + PATH_MARGIN
        leaves = known.leaves.copy()
        leaves[self._movable] = np.hstack([(low + high) / 2, (high - low) / 2])
        # Nowhere is what these boxes are of: another way of moving computes them anew.
        nowhere = np.full_like(known.places, np.nan)
        tree = BoundingTree(nowhere, leaves, known.shape, known.shape.node_boxes(leaves))
        self._worlds[0], self._covered = tree, path
        self._write_tree(model, tree)

    def _bounding_tree(self, model: mujoco.MjModel, world: int) -> BoundingTree:
        known, movable = self._worlds.get(world), self._geoms[self._movable]
        places = np.hstack([model.geom_pos[movable], model.geom_quat[movable], model.geom_aabb[movable, 3:]])
        if known is None:
            leaves = self._present_boxes(model, self._geoms)
            shape = tree_shape(leaves)
        else:
            changed = self._movable[(known.places != places).any(axis=1)]
            if not len(changed):
                return known
            leaves, shape = known.leaves.copy(), known.shape
            leaves[changed] = self._present_boxes(model, self._geoms[changed])
            # After few changes the old shape still separates well, and another costs more than it saves.
            if len(changed) > REBUILD_FRACTION * len(leaves):
                shape = tree_shape(leaves)
        self._worlds[world] = BoundingTree(places, leaves, shape, shape.node_boxes(leaves))
        return self._worlds[world]

    def _present_boxes(self, model: mujoco.MjModel, geoms: np.ndarray) -> np.ndarray:
        """Return the boxes of geoms where they are now (geoms, 6)."""
        return _bounding_boxes(model, geoms, model.geom_pos[geoms], model.geom_quat[geoms], self._frame)

    def _write_tree(self, model: mujoco.MjModel, known: BoundingTree) -> None:
        # Threads have models of their own: each remembers which world's tree it holds.
        if self._written.get(id(model)) is known:
            return
        node_ids = np.full(len(known.boxes), -1, np.int32)
        node_ids[known.shape.leaf] = self._geoms
        tree, nodes = _bvh_fields(model), self._nodes
        tree.bvh_nodeid[nodes], tree.bvh_aabb[nodes] = node_ids, known.boxes
        tree.bvh_child[nodes], tree.bvh_depth[nodes] = known.shape.children, known.shape.depth
        self._written[id(model)] = known


def _bvh_fields(model: mujoco.MjModel) -> Any:  # noqa: ANN401 - MuJoCo's types leave the tree's fields out
    return model


def _bounding_boxes(
    model: mujoco.MjModel, geoms: np.ndarray, pos: np.ndarray, quat: np.ndarray, frame: np.ndarray
) -> np.ndarray:
    """Return centres and half sizes of boxes around geoms, in their body's inertial frame (..., geoms, 6).

    Args:
        model: The model.
        geoms: The geoms, all of one body.
        pos: Their positions [m] (..., geoms, 3).
        quat: Their orientations (..., geoms, 4).
        frame: Orientation of that frame (3, 3).
    """
    body, own = model.geom_bodyid[geoms[0]], model.geom_aabb[geoms]
    with numpy_backend():
        mat = mat_from_quat(quat)
    # MuJoCo keeps a body's hierarchy in its inertial frame.
    mat = frame.T @ mat
    mid = (pos - model.body_ipos[body]) @ frame + np.einsum("...nij,nj->...ni", mat, own[:, :3])
    # |R| times the half sizes bounds a turned box.
    return np.concatenate([mid, np.einsum("...nij,nj->...ni", np.abs(mat), own[:, 3:])], -1)


STATE = mujoco.mjtState
INTEGRATION_STATE = STATE.mjSTATE_INTEGRATION
"""State components that a step depends on, warm start included, so that a state can be stepped again bit for
bit."""


VISIBLE_STATE = (STATE.mjSTATE_QPOS, STATE.mjSTATE_QVEL, STATE.mjSTATE_ACT)
"""State components returned to the layers above."""
BUFFER_WARNINGS = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]
"""Warnings about full contact and constraint buffers."""


class CState(NamedTuple):
    """State of the worlds on C MuJoCo.

    Attributes:
        integration: MuJoCo's integration states (worlds, n).
        qpos: Positions in these (worlds, nq).
        qvel: Velocities in these (worlds, nv).
        act: Activations in these (worlds, na).
        overflow: Warnings about full buffers in the last control step (worlds,).
        solved: Contacts, rows and iterations of the last physics step (worlds, 3).
    """

    integration: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    overflow: np.ndarray
    solved: np.ndarray


def c_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy without MuJoCo's silent reset of diverged worlds, which are counted and reset here."""
    copy = model.__copy__()
    copy.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return copy


def state_slices(model: mujoco.MjModel) -> dict[mujoco.mjtState, slice]:
    """Return the slice of each component of `INTEGRATION_STATE`."""
    places: dict[mujoco.mjtState, slice] = {}
    start = 0
    # `mj_getState` packs components in the order of their bits.
    for bit in range(int(mujoco.mjtState.mjNSTATE)):
        part = mujoco.mjtState(1 << bit)
        if INTEGRATION_STATE & part:
            end = start + mujoco.mj_stateSize(model, part)
            places[part], start = slice(start, end), end
    return places


def buffer_warnings(data: mujoco.MjData) -> int:
    """Return how often this data's contact or constraint buffer was full."""
    counts = data.warning.number
    return sum(int(counts[kind]) for kind in BUFFER_WARNINGS)


def _pin(data: mujoco.MjData, pinned: Array, pinned_dof: Array, qpos: Array) -> None:
    np.copyto(data.qpos, qpos, where=pinned)
    data.qvel[pinned_dof] = 0.0
    # The warm start belongs to the old place: kept, it would kick the body.
    data.qacc_warmstart[pinned_dof] = 0.0


class CEngine(Engine[CState]):
    """Engine that steps worlds one by one, on all cores."""

    name = "c"
    traceable = False

    def __init__(
        self,
        spec: mujoco.MjSpec,
        physics: Physics,
        worlds: int,
        moved_geoms: MovedGeoms | None = None,
        varied_bodies: RandomizedBodies | None = None,
    ) -> None:
        super().__init__(spec, physics, worlds, moved_geoms, varied_bodies)
        self._parts = state_slices(self.model)
        count = min(worlds, cores())
        # Each thread has its own model: fields that differ between worlds are written into it.
        same = moved_geoms is None and varied_bodies is None
        self.moved_body = MovedBody(self.model, self.moved_ids) if self.moved_ids else None
        self._models = [self.model if same else self.model.__copy__() for _ in range(count)]
        self._fields = None if self.varied_model is None else jax.jit(self.varied_model.fields)
        self._datas = [mujoco.MjData(self.model) for _ in range(count)]
        # MuJoCo releases Python's lock within a step, so threads are enough.
        self._pool = ThreadPoolExecutor(count) if count > 1 else None

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Compile the model with silent resets off."""
        model = c_model(spec.compile())
        if self.varied_bodies is not None and self.varied_bodies.vary.wheel is not None:
            # The bounding volume hierarchy has the compiled wheel sizes, so all geom pairs are tested.
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
        return model

    def start(self) -> CState:
        """Return every world in the model's reference configuration."""
        size = mujoco.mj_stateSize(self.model, INTEGRATION_STATE)
        blank = CState(
            integration=np.zeros((self.worlds, size)),
            qpos=np.zeros((self.worlds, self.model.nq)),
            qvel=np.zeros((self.worlds, self.model.nv)),
            act=np.zeros((self.worlds, self.model.na)),
            overflow=np.zeros(self.worlds, np.int32),
            solved=np.zeros((self.worlds, 3), np.int32),
        )
        # Through a reset: MuJoCo's state has more components than positions, all with defaults.
        return self.reset(blank, np.ones(self.worlds, bool), np.tile(self.model.qpos0, (self.worlds, 1)))

    def _save(self, data: mujoco.MjData, state: CState, world: int) -> None:
        mujoco.mj_getState(self.model, data, state.integration[world], INTEGRATION_STATE)
        state.qpos[world], state.qvel[world], state.act[world] = data.qpos, data.qvel, data.act

    def advance(self, engine_state: CState, inputs: Inputs) -> CState:
        """Step every world by one control step."""
        # Once for all worlds: taking rows of JAX arrays would dispatch an operation for each.
        arrays = jax.tree.map(np.asarray, inputs)
        fields = self._varied_fields(inputs)
        # A fresh array: states that the caller still holds stay as they were.
        states, overflow = self._applied(engine_state, arrays), np.zeros(self.worlds, np.int32)
        solved = np.zeros((self.worlds, 3), np.int32)

        def work(thread: int) -> None:
            model, data = self._models[thread], self._datas[thread]
            # MuJoCo's counters only grow: what a world adds is the difference.
            before = buffer_warnings(data)
            varied = [(getattr(model, name), values) for name, values in fields.items()]
            # Worlds in turn, so that threads get equal numbers of them.
            for world in range(thread, self.worlds, len(self._datas)):
                mujoco.mj_setState(model, data, states[world], INTEGRATION_STATE)
                for array, values in varied:
                    # In place: MuJoCo holds the addresses of the model's arrays.
                    array[:] = values[world]
                if arrays.geom_poses is not None and self.moved_body is not None:
                    here = arrays.geom_poses
                    size = None if here.size is None else here.size[world]
                    self.moved_body.move(model, here.pos[world], here.quat[world], size, world)
                mujoco.mj_step(model, data, nstep=self.physics.substeps)
                # Threads write disjoint rows of the common arrays, so no lock is needed.
                mujoco.mj_getState(model, data, states[world], INTEGRATION_STATE)
                warnings = buffer_warnings(data)
                overflow[world], before = warnings - before, warnings
                solved[world] = data.ncon, data.nefc, data.solver_niter[0]

        if self._pool is None:
            work(0)
        else:
            # `list` waits for all threads and raises what they raised.
            list(self._pool.map(work, range(len(self._datas))))
        # Copies: views of the states would keep all of them in memory.
        qpos, qvel, act = (states[:, self._parts[part]].copy() for part in VISIBLE_STATE)
        return CState(states, qpos, qvel, act, overflow, solved)

    def _varied_fields(self, inputs: Inputs) -> dict[str, np.ndarray]:
        """Return the model's fields that differ between worlds (worlds, ...)."""
        if self._fields is None or inputs.varied is None:
            return {}
        return {name: np.asarray(values) for name, values in self._fields(inputs.varied).items()}

    def _applied(self, own: CState, arrays: Inputs) -> np.ndarray:
        """Return the integration states with the inputs written into them (worlds, n)."""
        new, at = own.integration.copy(), self._parts
        new[:, at[STATE.mjSTATE_CTRL]], new[:, at[STATE.mjSTATE_ACT]] = arrays.ctrl, arrays.act
        new[:, at[STATE.mjSTATE_XFRC_APPLIED]] = arrays.xfrc_applied.reshape(self.worlds, -1)
        np.copyto(new[:, at[STATE.mjSTATE_QPOS]], arrays.qpos, where=arrays.pinned)
        # The warm start, too, as it is an acceleration: pinned coordinates have none.
        for part in (STATE.mjSTATE_QVEL, STATE.mjSTATE_WARMSTART):
            np.copyto(new[:, at[part]], 0.0, where=arrays.pinned_dof)
        return new

    def set_qpos(self, engine_state: CState, pinned: Array, pinned_dof: Array, qpos: Array) -> CState:
        """Set the pinned coordinates to qpos, at rest."""
        new = CState(*(array.copy() for array in engine_state))
        data = self._datas[0]
        for world in np.flatnonzero(np.asarray(pinned).any(-1)):
            mujoco.mj_setState(self.model, data, engine_state.integration[world], INTEGRATION_STATE)
            _pin(data, np.asarray(pinned)[world], np.asarray(pinned_dof)[world], np.asarray(qpos)[world])
            self._save(data, new, int(world))
        return new

    def reset(self, engine_state: CState, mask: Array, qpos: Array) -> CState:
        """Reset the masked worlds to qpos, at rest; the others are untouched."""
        new = CState(*(array.copy() for array in engine_state))
        data, qpos = self._datas[0], np.asarray(qpos)
        for world in np.flatnonzero(np.asarray(mask)):
            mujoco.mj_resetData(self.model, data)
            data.qpos[:] = qpos[world]
            self._save(data, new, int(world))
        return new

    def state(self, engine_state: CState) -> PhysicsState:
        """Return positions, velocities and activations in single precision."""
        return PhysicsState(
            qpos=jnp.asarray(np.float32(engine_state.qpos)),
            qvel=jnp.asarray(np.float32(engine_state.qvel)),
            act=jnp.asarray(np.float32(engine_state.act)),
        )

    def overflow(self, engine_state: CState, inputs: Inputs) -> jax.Array:
        """Return the number of buffer warnings of the last step (worlds,)."""
        del inputs
        return jnp.asarray(engine_state.overflow)

    def solved(self, engine_state: CState) -> SolvedStep:
        """Return the solver statistics of each world's last physics step."""
        return SolvedStep(*engine_state.solved.T)
