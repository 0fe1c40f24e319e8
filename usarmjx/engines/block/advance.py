"""End of a step beside solver `block`: one thread for each tree, in place of nine launches of MuJoCo Warp's.

It solves for the accelerations with implicit damping, and advances velocities, coordinates and activations,
as MuJoCo's Euler integrator does. Mass matrices of trees fit registers up to a size (`trees.MOST_SIZE`).
"""

from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from usarmjx.base.warp_functions import with_globals
from usarmjx.engines.block import trees
from usarmjx.engines.planar.warp_solids import expand_macros

warp: Any = import_module("warp")
warp.set_module_options({"enable_backward": False, "fast_math": False})

FORWARD = "mujoco.mjx.third_party.mujoco_warp._src.forward"
"""Private; the version of MJX is pinned."""
_MUJOCO: Any = mujoco  # more of it than its stubs have
_JOINT = _MUJOCO.mjtJoint
JOINT_NUMBERS = 3
"""Numbers of a joint: type, first of its coordinates and of its degrees of freedom."""
ACTUATOR_NUMBERS = 4
"""Numbers of an actuator: index, activation, kind of dynamics, whether the activation is limited."""
MACROS: dict[str, object] = {
    "JOINT_NUMBERS": JOINT_NUMBERS,
    "ACTUATOR_NUMBERS": ACTUATOR_NUMBERS,
    "FREE": int(_JOINT.mjJNT_FREE),
    "BALL": int(_JOINT.mjJNT_BALL),
    "DYN_FILTEREXACT": int(_MUJOCO.mjtDyn.mjDYN_FILTEREXACT),
    "TINY": "1e-15f",
}
"""Macros of the native code."""

LOAD_CODE = """
    const int block = index / p.worlds, world = index % p.worlds, start = p.starts.data[block];
#define MODEL(name) ((const float*)((const char*)p.name.data + \\
    (p.name.shape[0] == 1 ? (size_t)0 : (size_t)(world % p.name.shape[0]) * (size_t)p.name.strides[0])))
#define DATA(name) ((float*)((char*)p.name.data + (size_t)world * (size_t)p.name.strides[0]))
    const float step = *MODEL(timestep);
    const float* const values = DATA(M);
    const float* const right = DATA(momentum) + start;
    float* const qvel = DATA(qvel) + start;
    const int* const places = p.elements.data + (size_t)block * SIZE * SIZE;
    float factor[SIZE][SIZE], x[SIZE], inverse[SIZE];
    UNROLL
    for (int i = 0; i < SIZE; ++i) {
        x[i] = right[i];
        UNROLL
        for (int j = 0; j <= i; ++j) {
            const int place = places[i * SIZE + j];  // -1: zero
            factor[i][j] = place >= 0 ? values[place] : 0.0f;
        }
        const float* const poly = MODEL(dof_dampingpoly) + 2 * (start + i);
        const float v = qvel[i], size = v < 0.0f ? -v : v;
        // The derivative of the damping force, whose terms are in v, v |v| and v^3.
        const float more = 2.0f * poly[0] * size + 3.0f * poly[1] * size * size;
        factor[i][i] += step * (MODEL(dof_damping)[start + i] + more);
    }
"""
"""Native code that loads the mass matrix of a thread's tree, with implicit damping."""

MOVE_CODE = """
    UNROLL
    for (int i = 0; i < SIZE; ++i) qvel[i] += x[i] * step;
    const float* const velocity = DATA(qvel);
    const auto turn = [&](float* q, const float* w) {
        const float rate = wp::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
        const float half = 0.5f * step * rate, scale = rate > 0.0f ? wp::sin(half) / rate : 0.0f;
        const float old = wp::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        const float a = q[0] / old, b = q[1] / old, c = q[2] / old, d = q[3] / old;
        const float e = wp::cos(half), f = scale * w[0], g = scale * w[1], h = scale * w[2];
        const float r[4] = {
            a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g, a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e};
        const float length = wp::sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
        for (int i = 0; i < 4; ++i) q[i] = r[i] / length;
    };
    for (int j = p.joints.data[2 * block]; j < p.joints.data[2 * block + 1]; ++j) {
        const int* const row = p.joint.data + j * JOINT_NUMBERS;
        float* const q = DATA(qpos) + row[1];
        const float* const v = velocity + row[2];
        if (row[0] == BALL) {
            turn(q, v);
        } else if (row[0] == FREE) {
            for (int i = 0; i < 3; ++i) q[i] += step * v[i];
            turn(q + 3, v + 3);
        } else {
            q[0] += step * v[0];
        }
    }
    for (int k = p.acting.data[2 * block]; k < p.acting.data[2 * block + 1]; ++k) {
        const int* const row = p.actuator.data + k * ACTUATOR_NUMBERS;
        float time = step;
        if (row[2] == DYN_FILTEREXACT) {
            const float tau = wp::max(MODEL(actuator_dynprm)[10 * row[0]], TINY);
            // The exact solution as one step of another length, since `act_dot` is the difference over tau.
            time = tau * (1.0f - wp::exp(-step / tau));
        }
        float value = DATA(act)[row[1]] + DATA(act_dot)[row[1]] * time;
        if (row[3]) {
            const float* const range = MODEL(actuator_actrange) + 2 * row[0];
            value = wp::min(wp::max(value, range[0]), range[1]);
        }
        DATA(act)[row[1]] = value;
    }
#undef MODEL
#undef DATA
"""
"""Native code that advances a thread's tree."""
CODE = trees.BEGIN_CODE + LOAD_CODE + trees.SOLVE_CODE + MOVE_CODE + trees.END_CODE
"""Native code of a thread."""


def fits(model: mujoco.MjModel) -> bool:
    """Return whether the mass matrices of all trees fit registers, and damping is implicit."""
    m, disabled = untyped(model), _MUJOCO.mjtDisableBit
    # With either flag MuJoCo integrates without the implicit matrix, which the kernel always has.
    explicit = m.opt.disableflags & int(disabled.mjDSBL_EULERDAMP | disabled.mjDSBL_DAMPER)
    return not explicit and 0 < max(m.tree_dofnum, default=0) <= trees.MOST_SIZE


def untyped(model: mujoco.MjModel) -> Any:  # noqa: ANN401
    """Return the model as one of any type: it has more than MuJoCo's stubs say."""
    return model


@cache
def problem_type() -> Any:  # noqa: ANN401 - Warp's structs have no type
    """Return the struct of the kernel: tables of trees, and fields of MuJoCo Warp's model and data."""
    types = import_module("mujoco.mjx.third_party.mujoco_warp._src.types")
    whole, number, number_2d = warp.array(dtype=int), warp.array(dtype=float), warp.array2d(dtype=float)
    fields = dict.fromkeys(["starts", "elements", "joints", "joint", "acting", "actuator"], whole)
    fields |= dict.fromkeys(["dof_damping", "M", "momentum", "qvel", "qpos", "act", "act_dot"], number_2d)
    fields |= dict.fromkeys(("dof_dampingpoly", "actuator_actrange"), warp.array2d(dtype=warp.vec2))
    fields |= {"actuator_dynprm": warp.array2d(dtype=types.vec10), "timestep": number, "worlds": int}
    return warp.struct(type("AdvanceProblem", (), {"__annotations__": fields, "__module__": __name__}))


def code_of(size: int) -> str:
    """Return the native code for trees of some degrees of freedom."""
    return expand_macros(CODE, {**MACROS, "SIZE": size})


@cache
def advance_kernel(size: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel for trees of some degrees of freedom."""

    def advance_one(p: Any, index: int) -> None: ...  # noqa: ANN401

    # Warp reads annotations, and the struct's type is made at its first use.
    advance_one.__annotations__["p"] = problem_type()
    native = warp.func_native(code_of(size))(advance_one)

    def advance_trees(p: Any) -> None:  # noqa: ANN401
        native(p, warp.tid())

    advance_trees.__annotations__["p"] = problem_type()
    return warp.kernel(advance_trees, enable_backward=False, grid_stride=False, module="unique")


def make_tables(model: mujoco.MjModel) -> dict[int, dict[str, np.ndarray]]:
    """Return the tables of trees by their degrees of freedom: fields of the kernel's struct."""
    m = untyped(model)
    tree_of = m.dof_treeid[m.jnt_dofadr]
    joint = np.stack([m.jnt_type, m.jnt_qposadr, m.jnt_dofadr], axis=1)
    stateful = np.flatnonzero(m.actuator_actadr >= 0) if m.na else np.zeros(0, int)
    acts_on = tree_of[m.actuator_trnid[stateful, 0]]
    # Sorted by tree: each thread reads a run of its own actuators, and no two write the same activation.
    stateful, acts_on = stateful[np.argsort(acts_on, kind="stable")], np.sort(acts_on)
    acting = [m.actuator_actadr, m.actuator_dyntype, m.actuator_actlimited]
    actuator = np.stack([stateful, *(one[stateful] for one in acting)], axis=1)
    # Sparse rows of M have no entry for joints of other branches.
    place = np.full((m.nv, m.nv), -1)
    rows = np.repeat(np.arange(int(m.nv)), m.M_rownnz)
    place[rows, m.M_colind] = np.arange(m.nC)
    tables: dict[int, dict[str, np.ndarray]] = {}
    for size in np.unique(m.tree_dofnum):
        own = np.flatnonzero(m.tree_dofnum == size)
        starts = m.tree_dofadr[own]
        dofs = starts[:, None] + np.arange(int(size))
        # Joints are in the order of their trees, so two searches give each tree's range.
        edges = np.stack([own, own + 1], axis=1)
        tables[int(size)] = {
            "starts": starts,
            # Of each tree a dense block: other trees have no entries in its rows of M.
            "elements": place[dofs[:, :, None], dofs[:, None, :]],
            "joints": np.searchsorted(tree_of, edges),
            "joint": joint,
            "acting": np.searchsorted(acts_on, edges),
            "actuator": actuator,
        }
    return tables


class Advance:
    """Function in place of MuJoCo Warp's Euler integrator.

    Args:
        model: The model, which `fits`; `smooth.why_not` covers its actuators.
        device: Device of its tables.
    """

    def __init__(self, model: mujoco.MjModel, device: Any = None) -> None:  # noqa: ANN401
        self._tables = {
            size: {
                name: warp.array(np.ravel(table).astype(np.int32), dtype=int, device=device)
                for name, table in tables.items()
            }
            for size, tables in make_tables(model).items()
        }
        forward = import_module(FORWARD)
        # The rest of MuJoCo Warp's function, such as the time and the warm start, runs as it is.
        left = {forward._next_activation, forward._next_velocity, forward._next_position}

        def launch(kernel: object, *args: object, **kwargs: object) -> None:
            if kernel not in left:
                warp.launch(kernel, *args, **kwargs)

        self._rest = with_globals(forward._advance, wp=SimpleNamespace(**vars(warp) | {"launch": launch}))

    def problem(self, m: Any, d: Any, size: int) -> Any:  # noqa: ANN401
        """Return the struct of the kernel, for trees of some degrees of freedom."""
        p = problem_type()()
        for name, table in self._tables[size].items():
            setattr(p, name, table)
        for name in ("dof_damping", "dof_dampingpoly", "actuator_dynprm", "actuator_actrange"):
            setattr(p, name, getattr(m, name))
        for name in ("M", "qvel", "qpos", "act", "act_dot"):
            setattr(p, name, getattr(d, name))
        # The solver leaves the product of mass matrix and accelerations, the right side of the implicit
        # step.
        p.momentum, p.timestep, p.worlds = d.efc.Ma, m.opt.timestep, d.nworld
        return p

    def __call__(self, m: Any, d: Any) -> None:  # noqa: ANN401
        """Advance all worlds by a step; accelerations are kept as a start for the next one."""
        for size, tables in self._tables.items():
            dim = d.nworld * tables["starts"].size
            inputs = [self.problem(m, d, size)]
            # A launch for each size of trees: matrices in registers need a size that is known when
            # a kernel is compiled.
            warp.launch(advance_kernel(size), dim=dim, inputs=inputs, block_dim=64, device=d.qpos.device)
        self._rest(m, d, d.qacc)
