"""Smooth dynamics beside solver `block`: one kernel in place of 40 launches of MuJoCo Warp's.

It takes the place of MuJoCo Warp's kinematics, inertias, velocities, bias, passive and actuator forces, and
writes what its later stages and `mjx.Data` have of them; of inertias of bodies and forces in joints nothing
is kept. `why_not` says which models it does not cover: MuJoCo Warp's kernels take those.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from usarmjx.engines.block import smooth_code
from usarmjx.engines.block.advance import Advance, fits, untyped
from usarmjx.engines.block.branches import branches_of
from usarmjx.engines.planar.warp_solids import expand_macros

warp: Any = import_module("warp")
warp.set_module_options({"enable_backward": False, "fast_math": False})

_MUJOCO: Any = mujoco  # more of it than its stubs have
CHUNK_BODIES = 128
"""Bodies of a chunk, unless one subtree has more."""
THREADS = 128
"""Most threads of a block, which handles a chunk: whole warps, with a thread for each body."""
REGISTERS = 80
"""Most registers of a thread: six blocks of 16 robots have room beside each other."""
MOST_NUMBERS = 11_700
"""Numbers of shared memory of a block: 48 kB, of which Warp has 2 kB itself."""
STEP_NUMBERS = 256
"""Numbers by which the memory of kernels grows, so that few are compiled."""
LEFT_OUT = ("crb", "cinert", "cacc", "cfrc_int", "qfrc_spring", "qfrc_damper", "actuator_moment")
"""Data that MuJoCo Warp's kernels write and this does not."""

_JOINT, _DYN = _MUJOCO.mjtJoint, _MUJOCO.mjtDyn
_GAIN, _BIAS = _MUJOCO.mjtGain, _MUJOCO.mjtBias
MACROS: dict[str, object] = {
    **{name: getattr(smooth_code, name) for name in vars(smooth_code) if name.endswith("_NUMBERS")},
    "FREE": int(_JOINT.mjJNT_FREE),
    "BALL": int(_JOINT.mjJNT_BALL),
    "SLIDE": int(_JOINT.mjJNT_SLIDE),
    "HINGE": int(_JOINT.mjJNT_HINGE),
    "DYN_INTEGRATOR": int(_DYN.mjDYN_INTEGRATOR),
    "DYN_FILTEREXACT": int(_DYN.mjDYN_FILTEREXACT),
    "DYN_FILTER": int(_DYN.mjDYN_FILTER),
    "GAIN_AFFINE": int(_GAIN.mjGAIN_AFFINE),
    "BIAS_AFFINE": int(_BIAS.mjBIAS_AFFINE),
    "TINY": "1e-15f",
}
"""Macros of the native code; `TINY` is MuJoCo's least time constant."""
COVERED = {
    "actuator_trntype": [_MUJOCO.mjtTrn.mjTRN_JOINT, _MUJOCO.mjtTrn.mjTRN_JOINTINPARENT],
    "actuator_dyntype": [_DYN.mjDYN_NONE, _DYN.mjDYN_INTEGRATOR, _DYN.mjDYN_FILTER, _DYN.mjDYN_FILTEREXACT],
    "actuator_gaintype": [_GAIN.mjGAIN_FIXED, _GAIN.mjGAIN_AFFINE],
    "actuator_biastype": [_BIAS.mjBIAS_NONE, _BIAS.mjBIAS_AFFINE],
}
"""Kinds of actuators that the kernel has, by field."""
TABLES = "chunk body joint dof geom mass actuator pushing limited order level subtree"
"""Tables of integers of the model."""
MODEL_KINDS = {
    "qpos0 body_mass body_subtreemass dof_armature qpos_spring jnt_stiffness dof_damping": float,
    "body_pos body_ipos body_inertia jnt_pos jnt_axis geom_pos": "vec3",
    "body_quat body_iquat geom_quat": "quat",
    "jnt_stiffnesspoly dof_dampingpoly actuator_ctrlrange actuator_forcerange jnt_actfrcrange": "vec2",
    "actuator_gear": "spatial_vector",
    "actuator_gainprm actuator_biasprm actuator_dynprm": "vec10",
}
"""Fields of MuJoCo Warp's model that the kernel reads, and their types."""
DATA_KINDS = {
    "qpos qvel act ctrl qfrc_applied M actuator_length actuator_velocity actuator_force act_dot": float,
    "qfrc_bias qfrc_passive qfrc_actuator qfrc_smooth": float,
    "mocap_pos xpos xanchor xaxis xipos subtree_com geom_xpos": "vec3",
    "mocap_quat xquat": "quat",
    "xmat ximat geom_xmat": "mat33",
    "xfrc_applied cdof cdof_dot cvel": "spatial_vector",
}
"""Fields of its data that the kernel reads or writes, and their types."""
MUJOCO_WARP = "mujoco.mjx.third_party.mujoco_warp._src"
"""Private; the version of MJX is pinned."""


def why_not(model: mujoco.MjModel) -> str | None:
    """Return what a model has that the kernel does not cover, or None."""
    m = untyped(model)
    option, disabled = m.opt, _MUJOCO.mjtDisableBit
    joints = np.isin(m.actuator_trnid[:, 0], np.flatnonzero(m.jnt_type >= int(_JOINT.mjJNT_SLIDE)))
    # MuJoCo numbers its joints free, ball, slide, hinge: the first two have no single coordinate.
    loose = m.jnt_type < int(_JOINT.mjJNT_SLIDE)
    uncovered = {
        "no degrees of freedom": m.nv == 0,
        "sensors": m.nsensor > 0,
        "energies": bool(option.enableflags & int(_MUJOCO.mjtEnableBit.mjENBL_ENERGY)),
        "sites": m.nsite > 0,
        "cameras or lights": m.ncam + m.nlight > 0,
        "tendons or flexes": m.ntendon + m.nflex > 0,
        "gravity compensation": bool(np.any(m.body_gravcomp)),
        "a fluid": bool(option.density or option.viscosity or np.any(option.wind)),
        "delays": m.nhistory > 0,
        "adhesion": bool(np.any(m.geom_adhesion)) if hasattr(m, "geom_adhesion") else False,
        "actuation switched off": bool(option.disableflags & int(disabled.mjDSBL_ACTUATION)),
        "springs of free or ball joints": bool(
            np.any(m.jnt_stiffness[loose]) or np.any(m.jnt_stiffnesspoly[loose])
        ),
        "actuators of other kinds": not all(
            np.isin(getattr(m, name), list(map(int, kinds))).all() for name, kinds in COVERED.items()
        ),
        "actuators of free or ball joints": not joints.all(),
        "actuators with early activations, or several": bool(
            np.any(m.actuator_actearly) or np.any(m.actuator_actnum > 1)
        ),
    }
    found = next((name for name, present in uncovered.items() if present), None)
    # Chunks of one subtree each are the smallest: a subtree is never split between blocks.
    if found is None and numbers_of(make_tables(model, 0), THREADS) > MOST_NUMBERS:
        return "a subtree of too many bodies"
    return found


@dataclass(frozen=True)
class Tables:
    """Tables of a model for the kernel; integers.

    Attributes:
        chunk: Ranges of each chunk (chunks, `smooth_code.CHUNK_NUMBERS`).
        body: See `smooth_code.BODY_NUMBERS`; likewise `joint`, `dof` and `actuator`, which is in the order of
            the chunks.
        geom: Body of each geom, and whether it moves (ngeom, 2).
        mass: Row and column of each number of the mass matrix (nC, 2).
        pushing: Actuators of the degrees of freedom, by their places in the chunk.
        limited: Whether the actuators' force on a joint is limited (njnt,).
        order: Bodies by chunk and depth.
        level: First of each level in `order`, and their number at the end.
        subtree: First and last (exclusive) body of each subtree below the world (subtrees, 2).
    """

    chunk: np.ndarray
    body: np.ndarray
    joint: np.ndarray
    dof: np.ndarray
    geom: np.ndarray
    mass: np.ndarray
    actuator: np.ndarray
    pushing: np.ndarray
    limited: np.ndarray
    order: np.ndarray
    level: np.ndarray
    subtree: np.ndarray


def make_tables(model: mujoco.MjModel, bodies: int) -> Tables:
    """Return the tables of a model.

    Args:
        model: The model.
        bodies: Bodies of a chunk, unless a subtree has more.
    """
    m = untyped(model)
    tops = np.append(np.flatnonzero(m.body_parentid[1:] == 0) + 1, m.nbody)
    firsts = [1]
    for begin, end in pairwise(tops):
        # Chunks end between subtrees only: what a body passes to its parent stays within a block.
        if end - firsts[-1] > bodies and begin > firsts[-1]:
            firsts.append(int(begin))
    edges, depth, bodies_in_order = np.array([*firsts, m.nbody]), _zeros(m.nbody), _places(m.nbody)
    chunk_of = np.searchsorted(edges, bodies_in_order, side="right") - 1
    for body in range(1, m.nbody):
        depth[body] = depth[m.body_parentid[body]] + 1
    # The last key sorts first: chunks stay together, and within each the levels.
    order = np.lexsort([depth[1:], chunk_of[1:]]) + 1
    key: np.ndarray = chunk_of[order] * m.nbody + depth[order]
    level = np.append(np.flatnonzero(np.diff(key, prepend=-1)), len(order))
    single = m.jnt_type[m.dof_jntid] >= int(_JOINT.mjJNT_SLIDE)
    coordinate = np.where(single, m.jnt_qposadr[m.dof_jntid], -1)
    actuator, (pushed, pushing), acting = _actuator_tables(m, chunk_of)

    def range_of(sorted_bodies: np.ndarray) -> np.ndarray:
        return np.searchsorted(sorted_bodies, edges)

    ranges = [range_of(m.jnt_bodyid), range_of(m.dof_bodyid), range_of(m.geom_bodyid)]
    # One more entry: the last chunk ends behind the last row.
    row_ends = np.append(m.M_rowadr, m.nC)
    levels = np.searchsorted(chunk_of[order[level[:-1]]], _places(len(edges)))
    ranges = [edges, *ranges, row_ends[ranges[1]], acting, levels, range_of(tops[:-1])]
    # Geoms of static bodies keep their poses; those on mocap bodies are moved from outside.
    static = (m.body_weldid == 0) & (m.body_mocapid[m.body_rootid] == -1)
    return Tables(
        chunk=np.stack([ends for one in ranges for ends in (one[:-1], one[1:])], axis=1),
        body=np.stack(
            [
                getattr(m, f"body_{name}")
                for name in ["parentid", "rootid", "jntnum", "jntadr", "mocapid", "dofnum", "dofadr"]
            ],
            axis=1,
        ),
        joint=np.stack([m.jnt_type, m.jnt_bodyid, m.jnt_qposadr, m.jnt_dofadr], axis=1),
        dof=np.stack([m.dof_bodyid, coordinate, m.dof_jntid, pushed[:-1], pushed[1:]], axis=1),
        geom=np.stack([m.geom_bodyid, ~static[m.geom_bodyid]], axis=1),
        mass=np.stack([np.repeat(_places(m.nv), m.M_rownnz), m.M_colind], axis=1),
        actuator=actuator,
        pushing=pushing,
        limited=m.jnt_actfrclimited,
        order=order,
        level=level,
        subtree=np.stack([tops[:-1], tops[1:]], axis=1),
    )


def _places(count: int) -> np.ndarray:
    return np.arange(count)


def _zeros(count: int) -> np.ndarray:
    return np.zeros(count, int)


def _actuator_tables(
    m: Any,  # noqa: ANN401 - more of MuJoCo than its stubs have
    chunk_of: np.ndarray,
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return the table of actuators, those of each degree of freedom, and the first of each chunk."""
    joint = m.actuator_trnid[:, 0]
    chunk = chunk_of[m.jnt_bodyid[joint]] if m.nactuator else np.zeros(0, int)
    # Stable: within a chunk the model's order stays, in which forces are summed.
    ids = np.argsort(chunk, kind="stable")
    firsts = np.searchsorted(chunk[ids], _places(int(chunk_of.max()) + 2))
    dof, control = m.jnt_dofadr[joint[ids]], m.actuator_ctrladr[ids]
    clamped = not m.opt.disableflags & int(_MUJOCO.mjtDisableBit.mjDSBL_CLAMPCTRL)
    has_control = m.actuator_ctrlnum[ids] > 0
    table = np.stack(
        [
            ids,
            m.jnt_qposadr[joint[ids]],
            dof,
            np.where(has_control, control, -1),
            # The appended number stands for actuators without a control: their index is -1.
            np.append(m.actuator_ctrllimited, 0)[np.where(has_control, control, -1)] & clamped,
            m.actuator_forcelimited[ids],
            np.where(m.na > 0, m.actuator_actadr[ids], -1),
            *(getattr(m, f"actuator_{kind}type")[ids] for kind in ("dyn", "gain", "bias")),
        ],
        axis=1,
    )
    by_dof = np.argsort(dof, kind="stable")
    places = _places(len(ids)) - firsts[chunk[ids]]
    starts = np.searchsorted(dof[by_dof], _places(m.nv + 1))
    return table, (starts, places[by_dof]), firsts


def numbers_of(tables: Tables, threads: int) -> int:
    """Return the numbers of memory that the largest chunk needs; the layout is that of `SETUP_CODE`."""
    size = (tables.chunk[:, 1::2] - tables.chunk[:, ::2]).T
    slots, joints, dofs, actuators = size[0] + 1, size[1], size[2], size[5]
    # Scratch memory of warps lies where inertias are written later: the larger of both counts.
    poses = 7 * slots + 6 * joints + dofs + actuators + 12 * slots
    return int((poses + np.maximum(20 * slots + 12 * dofs, 9 * threads)).max())


@cache
def problem_type() -> Any:  # noqa: ANN401 - Warp's structs have no type
    """Return the struct of the kernel: tables, and fields of MuJoCo Warp's model and data.

    `weight`, `springs` and `dampers`: whether gravity, springs and dampers act.
    """
    types = import_module(f"{MUJOCO_WARP}.types")

    def kind_of(name: Any) -> Any:  # noqa: ANN401
        return name if name is float else types.vec10 if name == "vec10" else getattr(warp, name)

    fields: dict[str, Any] = {name: warp.array(dtype=int) for name in TABLES.split()}
    for kinds in (MODEL_KINDS, DATA_KINDS):
        for names, kind in kinds.items():
            fields |= {name: warp.array2d(dtype=kind_of(kind)) for name in names.split()}
    fields |= {"gravity": warp.array(dtype=warp.vec3)}
    fields |= dict.fromkeys(("worlds", "chunks", "weight", "springs", "dampers"), int)
    return warp.struct(type("SmoothProblem", (), {"__annotations__": fields, "__module__": __name__}))


def smooth_code_of(capacity: int, threads: int) -> str:
    """Return the native code of the kernel, for some memory and threads of a block."""
    return expand_macros(smooth_code.CODE, {**MACROS, "CAPACITY": capacity, "THREADS": threads})


@cache
def smooth_kernel(capacity: int, threads: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel, for some memory and threads of a block."""

    def solve_chunk(p: Any, index: int) -> None: ...  # noqa: ANN401

    # As in `advance`: Warp reads annotations, and the struct's type is made at its first use.
    solve_chunk.__annotations__["p"] = problem_type()
    native = warp.func_native(smooth_code_of(capacity, threads))(solve_chunk)

    def smooth_dynamics(p: Any) -> None:  # noqa: ANN401
        native(p, warp.tid())

    smooth_dynamics.__annotations__["p"] = problem_type()
    options = {"enable_backward": False, "grid_stride": False, "cuda_max_registers": REGISTERS}
    return warp.kernel(smooth_dynamics, module="unique", **options)


class SmoothDynamics:
    """Function in place of MuJoCo Warp's stages from kinematics to the smooth forces.

    Attributes:
        advance: Function in place of its integrator, or None if that is needed.

    Args:
        model: The model, which `why_not` covers.
        device: Device of its tables.
        bodies: Bodies of a chunk.
        threads: Most threads of a block.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        device: Any = None,  # noqa: ANN401
        bodies: int = CHUNK_BODIES,
        threads: int = THREADS,
    ) -> None:
        self.advance = Advance(model, device) if fits(model) else None
        tables = make_tables(model, bodies)
        # Ends: `why_not` has refused models of which a single subtree is too large.
        while numbers_of(tables, threads) > MOST_NUMBERS:
            bodies //= 2
            tables = make_tables(model, bodies)
        self._tables = {
            name: warp.array(np.ravel(getattr(tables, name)).astype(np.int32), dtype=int, device=device)
            for name in TABLES.split()
        }
        self._chunks, most = len(tables.chunk), int((tables.chunk[:, 1] - tables.chunk[:, 0]).max())
        if warp.get_device(device).is_cuda:
            # Rounded up to whole warps.
            self._threads = min(threads, most + -most % 32)
            needed = numbers_of(tables, self._threads)
            self._capacity = needed + -needed % STEP_NUMBERS
        else:  # one kernel serves all models
            self._threads, self._capacity = 32, MOST_NUMBERS

    def problem(self, m: Any, d: Any) -> Any:  # noqa: ANN401
        """Return the struct of the kernel."""
        p, disabled = problem_type()(), _MUJOCO.mjtDisableBit
        for name, table in self._tables.items():
            setattr(p, name, table)
        for kinds, source in ((MODEL_KINDS, m), (DATA_KINDS, d)):
            for names in kinds:
                for name in names.split():
                    setattr(p, name, getattr(source, name))
        p.gravity, p.worlds, p.chunks = m.opt.gravity, d.nworld, self._chunks
        flags = m.opt.disableflags
        for name, bit in (("weight", "GRAVITY"), ("springs", "SPRING"), ("dampers", "DAMPER")):
            setattr(p, name, int(not flags & int(getattr(disabled, f"mjDSBL_{bit}"))))
        return p

    def __call__(self, m: Any, d: Any) -> None:  # noqa: ANN401
        """Compute everything that does not depend on contacts, up to the smooth forces."""
        warp.launch(
            smooth_kernel(self._capacity, self._threads),
            dim=d.nworld * self._chunks * self._threads,
            inputs=[self.problem(m, d)],
            block_dim=self._threads,
            device=d.qpos.device,
        )


def stages(
    smooth_dynamics: Callable[..., None], collision: Callable[..., None], factor_solve: Callable[..., None]
) -> dict[str, object]:
    """Return MuJoCo Warp's stages of a step by name, where one function computes what comes before contacts.

    Args:
        smooth_dynamics: The function, which is called in place of the first stage.
        collision: Finds contacts.
        factor_solve: Solves for accelerations without constraints.
    """
    make_constraint = import_module(f"{MUJOCO_WARP}.constraint").make_constraint

    def fwd_position(m: Any, d: Any, factorize: bool = True) -> None:  # noqa: ANN401
        # MuJoCo Warp passes this flag by name; `factor_solve` always does both.
        del factorize
        smooth_dynamics(m, d)
        stream = branches_of(d.qpos.device).stream(0)
        with warp.ScopedStream(stream):  # contacts do not need these accelerations
            factor_solve(m, d, d.M, d.qLD, d.qLDiagInv, d.qacc_smooth, d.qfrc_smooth)
        if m.opt.run_collision_detection:
            collision(m, d)
        make_constraint(m, d)

    def fwd_acceleration(m: Any, d: Any, factorize: bool = False) -> None:  # noqa: ANN401
        del m, factorize
        # Here at the latest: the solver starts from these accelerations.
        branches_of(d.qpos.device).join()

    # All of it has happened in `fwd_position`.
    def done(m: Any, d: Any) -> None:  # noqa: ANN401
        del m, d

    found = {"fwd_position": fwd_position, "fwd_acceleration": fwd_acceleration}
    return {**found, "fwd_velocity": done, "fwd_actuation": done}
