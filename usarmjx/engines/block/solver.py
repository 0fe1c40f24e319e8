"""Solver `block` of engine `warp`: islands of constraint rows, each solved to convergence by its own lanes.

It takes the place of MuJoCo Warp's `solver.solve`, with the same rows, in five launches; MuJoCo Warp's own takes
about twenty for each iteration. Islands differ in size, so each size class has lanes and memory of its own.
"""

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import mujoco
import warp as wp

from usarmjx.engines.block import islands, newton
from usarmjx.engines.planar.warp_solids import expand_macros

SCRATCH_NUMBERS = 1 << 26
"""Numbers of global memory for islands beyond shared memory, of all worlds."""
WARP_TYPES = "mujoco.mjx.third_party.mujoco_warp._src.types"
SIZES = (
    "worlds", "trees", "dofs", "most_rows", "most_values", "most_addresses", "padded_rows", "padded_dofs", "sparse",
    "masses", "impedances", "warm", "scratch_size",
)  # fmt: skip
"""Sizes of the arrays; whether the Jacobian is sparse; whether to start from the last step's accelerations."""


@dataclass(frozen=True)
class SizeClass:
    """Islands of one size class.

    Attributes:
        lanes: Threads of an island: a power of two.
        slot: Numbers of shared memory of an island; 0: its memory is global.
        most: Most islands at a time; the rest wait.
        block: Threads of a block, which handles one or more islands.
    """

    lanes: int
    slot: int
    most: int
    block: int = 128


CLASSES = (
    SizeClass(lanes=16, slot=744, most=1 << 22),
    SizeClass(lanes=32, slot=2944, most=1 << 14),
    SizeClass(lanes=128, slot=11760, most=1 << 12),
    SizeClass(lanes=128, slot=0, most=264),
)
"""Size classes of islands. Shared memory of a block is 48 kB at most, of
which Warp has 2 kB itself. Most robots on flat ground are of the first:
12 degrees of freedom and eight contacts."""

MACROS: dict[str, object] = {
    **newton.MACROS,
    **{f"SLOT_{k}": size_class.slot for k, size_class in enumerate(CLASSES[:-1])},
    "THREADS": islands.THREADS,
    "TASK_NUMBERS": islands.TASK_NUMBERS,
    **{
        name: int(getattr(mujoco.mjtConstraint, f"mjCNSTR_{name}"))
        for name in ("CONTACT_ELLIPTIC", "EQUALITY", "FRICTION_DOF")
    },
    "SATISFIED": int(mujoco.mjtConstraintState.mjCNSTRSTATE_SATISFIED),
    "QUADRATIC": int(mujoco.mjtConstraintState.mjCNSTRSTATE_QUADRATIC),
    "LINEAR_NEGATIVE": int(mujoco.mjtConstraintState.mjCNSTRSTATE_LINEARNEG),
    "LINEAR_POSITIVE": int(mujoco.mjtConstraintState.mjCNSTRSTATE_LINEARPOS),
    "CONE": f"{int(mujoco.mjtConstraintState.mjCNSTRSTATE_CONE)}",
}
"""Macros of the native code."""


def coefficients_type() -> Any:  # noqa: ANN401 - as below
    """Return MuJoCo Warp's type of the five friction coefficients of a contact."""
    return import_module(WARP_TYPES).vec5


@cache
def problem_type() -> Any:  # noqa: ANN401 - Warp's structs have no type
    """Return the struct of all arrays and sizes of the two kernels."""
    number, whole = wp.array(dtype=float), wp.array(dtype=int)
    number_2d, whole_2d = wp.array2d(dtype=float), wp.array2d(dtype=int)
    fields = {
        # Of the model.
        **dict.fromkeys(("dof_tree", "tree_start", "tree_size"), whole),
        **dict.fromkeys(("mass_size", "mass_start", "mass_columns"), whole),
        "impedance": number,
        # Rows, as MuJoCo Warp makes them.
        "nefc": whole,
        **dict.fromkeys(("type", "id", "row_size", "row_start"), whole_2d),
        "columns": wp.array3d(dtype=int),
        "jacobian": wp.array3d(dtype=float),
        **dict.fromkeys(("weights", "reference", "bound"), number_2d),
        "dimension": whole,
        "address": whole_2d,
        "friction": wp.array(dtype=coefficients_type()),
        "inertia": number_2d,
        **dict.fromkeys(("smooth_acceleration", "smooth_force", "warm_acceleration"), number_2d),
        # Islands.
        **dict.fromkeys(("labels", "roots", "offsets", "islands", "listed", "counts", "tasks"), whole),
        "scratch": number,
        # Results.
        **dict.fromkeys(("acceleration", "momentum", "constraint_force", "force"), number_2d),
        "state": whole_2d,
        "iterations": whole,
        # Sizes.
        **dict.fromkeys(SIZES, int),
    }
    return wp.struct(type("BlockProblem", (), {"__annotations__": fields, "__module__": __name__}))


@cache
def islands_kernel() -> Any:  # noqa: ANN401 - as above
    """Return the kernel that sorts rows by island."""
    problem = problem_type()

    @wp.func_native(expand_macros(newton.NEED_CODE + islands.SIZES_CODE + islands.CODE, MACROS))
    def sort_world(p: problem, index: int) -> None: ...

    def sort_rows_by_island(p: problem) -> None:
        sort_world(p, wp.tid())

    return wp.kernel(sort_rows_by_island, enable_backward=False, grid_stride=False, module="unique")


@cache
def newton_kernel(which: int) -> Any:  # noqa: ANN401 - as above
    """Return the kernel that solves islands of a size class."""
    problem = problem_type()
    size_class = CLASSES[which]
    words = {"LANES": size_class.lanes, "SLOT": size_class.slot, "BLOCK": size_class.block, "SIZE_CLASS": which}

    @wp.func_native(expand_macros(newton.CODE, {**MACROS, **words}))
    def solve_group(p: problem, groups: int, index: int) -> None: ...

    def solve_islands(p: problem, groups: int) -> None:
        solve_group(p, groups, wp.tid())

    return wp.kernel(solve_islands, enable_backward=False, grid_stride=False, module="unique")


def make_problem(m: Any, d: Any) -> Any:  # noqa: ANN401 - as above
    """Return the struct of a model and the data of its worlds, with new arrays for the islands."""
    p = problem_type()()
    worlds, trees = d.nworld, m.ntree
    p.dof_tree, p.tree_start, p.tree_size = m.dof_treeid, m.tree_dofadr, m.tree_dofnum
    p.mass_size, p.mass_start, p.mass_columns = m.M_rownnz, m.M_rowadr, m.M_colind
    p.impedance = m.opt.impratio_invsqrt
    efc, contact = d.efc, d.contact
    p.nefc, p.type, p.id = d.nefc, efc.type, efc.id
    p.row_size, p.row_start, p.columns, p.jacobian = efc.J_rownnz, efc.J_rowadr, efc.J_colind, efc.J
    p.weights, p.reference, p.bound = efc.D, efc.aref, efc.frictionloss
    p.dimension, p.address, p.friction = contact.dim, contact.efc_address, contact.friction
    p.inertia, p.smooth_acceleration, p.smooth_force = d.M, d.qacc_smooth, d.qfrc_smooth
    p.warm_acceleration = d.qacc_warmstart
    p.labels = wp.empty(worlds * d.njmax, dtype=int)
    p.roots, p.offsets = wp.empty(worlds * trees, dtype=int), wp.empty(worlds * trees, dtype=int)
    p.islands = wp.empty(worlds * trees * islands.TASK_NUMBERS, dtype=int)
    p.listed = wp.empty(2 * worlds * d.njmax, dtype=int)
    p.counts = wp.zeros(len(CLASSES), dtype=int)
    p.tasks = wp.empty(len(CLASSES) * worlds * trees, dtype=int)
    p.acceleration, p.momentum, p.constraint_force = d.qacc, efc.Ma, d.qfrc_constraint
    p.force, p.state, p.iterations = efc.force, efc.state, d.solver_niter
    p.worlds, p.trees, p.dofs, p.most_rows, p.masses = worlds, trees, m.nv, d.njmax, d.M.shape[-1]
    p.most_values, p.most_addresses, p.padded_rows = efc.J.shape[-1], contact.efc_address.shape[-1], efc.D.shape[-1]
    p.padded_dofs, p.sparse, p.impedances = efc.J.shape[-1], int(m.is_sparse), p.impedance.shape[0]
    p.warm = int(not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_WARMSTART)
    p.scratch_size = newton.most_numbers(m.nv, d.njmax)
    return p


def solve(m: Any, d: Any) -> None:  # noqa: ANN401 - as above
    """Solve for the constraint forces of all worlds; model and data are MuJoCo Warp's.

    Writes accelerations, generalized constraint forces, forces and states of the rows, the product of mass matrix
    and accelerations, and the most iterations of a world's islands.
    """
    p = make_problem(m, d)
    device = d.qacc.device
    wp.launch(
        islands_kernel(), dim=d.nworld * islands.THREADS, inputs=[p], block_dim=islands.THREADS, device=device
    )
    for which, size_class in enumerate(CLASSES):
        groups = min(d.nworld * m.ntree, size_class.most)
        if not size_class.slot:
            groups = max(1, min(groups, SCRATCH_NUMBERS // p.scratch_size))
            p.scratch = wp.empty(groups * p.scratch_size, dtype=float)
        dim = groups * size_class.lanes
        wp.launch(newton_kernel(which), dim=dim, inputs=[p, groups], block_dim=size_class.block, device=device)
