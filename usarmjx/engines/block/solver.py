"""Solver `block` of engine `warp`: islands of constraint rows, each solved to convergence by its own lanes.

It takes the place of MuJoCo Warp's `solver.solve`, with the same rows, in five launches; MuJoCo Warp's own
takes about twenty for each iteration. Each size class of islands has lanes and memory of its own.
"""

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import mujoco

from usarmjx.engines.block import islands, newton, small
from usarmjx.engines.block.branches import branches_of
from usarmjx.engines.planar.warp_solids import expand_macros

warp: Any = import_module("warp")
warp.set_module_options({"enable_backward": False, "fast_math": False})

SCRATCH_NUMBERS = 1 << 26
"""Numbers of global memory for islands beyond shared memory, of all worlds."""
WARP_TYPES = "mujoco.mjx.third_party.mujoco_warp._src.types"
"""Private; the version of MJX is pinned."""


@dataclass(frozen=True)
class SizeClass:
    """Islands of one size class.

    Attributes:
        lanes: Threads of an island: a power of two.
        slot: Numbers of shared memory of an island; 0: its memory is global.
        most: Most islands at a time; the rest wait.
        block: Threads of a block, which handles one or more islands.
        dofs: Most degrees of freedom, with the Hessian in registers; 0: any number, in the island's memory.
        registers: Most registers of a thread; None: as the compiler likes.
        fast: Whether divisions and roots may be off by two units in the last place.
    """

    lanes: int
    slot: int
    most: int
    block: int = 128
    dofs: int = 0
    registers: int | None = None
    fast: bool = False

    def code(self) -> str:
        """Return the native code of the lanes."""
        code = small.CODE if self.dofs else newton.CODE
        # Warp takes kernels of the same code for one, whatever the options of their modules.
        return code + ("    // fast\n" if self.fast else "")

    def words(self, which: int) -> dict[str, object]:
        """Return the macros of the native code, for the class of this index."""
        words = {"LANES": self.lanes, "SLOT": self.slot, "BLOCK": self.block, "SIZE_CLASS": which}
        return {**MACROS, **words, "DOFS": self.dofs}


LARGE = (
    SizeClass(lanes=32, slot=2944, most=1 << 14),
    SizeClass(lanes=128, slot=11760, most=1 << 12),
    SizeClass(lanes=128, slot=0, most=264),
)
"""Size classes of islands beyond the small ones. Shared memory of a block is 48 kB at most, of which Warp has
2 kB itself."""


def small_class(
    dofs: int, lanes: int, slot: int, block: int = 64, registers: int | None = None, fast: bool = False
) -> SizeClass:
    """Return a size class of small islands with the Hessian in registers.

    Args:
        dofs: Most degrees of freedom: a multiple of four.
        lanes: Threads of an island.
        slot: Numbers of shared memory: a multiple of four, and best eight more than one of 32, so that
            islands of a warp read other banks.
        block: Threads of a block.
        registers: As in `SizeClass`.
        fast: Likewise.
    """
    return SizeClass(lanes, slot, 1 << 22, block, dofs, registers, fast)


MIDDLE = small_class(24, 16, 1448, registers=168)
"""Size class of two robots in touch, or of one with many joints."""
VARIANTS = {
    "shared": (SizeClass(lanes=8, slot=768, most=1 << 22, block=64), *LARGE),
    "registers": (small_class(12, 8, 648), MIDDLE, *LARGE),
    "registers-128": (small_class(12, 8, 648, registers=128), MIDDLE, *LARGE),
    "registers-96": (small_class(12, 8, 648, registers=96), MIDDLE, *LARGE),
    "fast-128": (small_class(12, 8, 648, registers=128, fast=True), MIDDLE, *LARGE),
    "fast-tight": (small_class(12, 8, 520, registers=96, fast=True), MIDDLE, *LARGE),
    "fast-4": (small_class(12, 4, 648, registers=168, fast=True), MIDDLE, *LARGE),
    "fast-16": (small_class(12, 16, 648, block=128, registers=96, fast=True), MIDDLE, *LARGE),
    "fast-wide": (
        small_class(12, 8, 648, registers=128, fast=True),
        small_class(12, 16, 1160, registers=128, fast=True),
        small_class(24, 16, 1448, registers=168, fast=True),
        *LARGE,
    ),
    "objects": (
        small_class(8, 4, 264, registers=128, fast=True),
        small_class(12, 8, 648, registers=128, fast=True),
        MIDDLE,
        *LARGE,
    ),
}
"""Size classes by name, to be compared."""
CLASSES = VARIANTS["objects"]
"""Size classes of islands, the smallest first. Loose objects are of the first, most robots on flat ground of
the second: 12 degrees of freedom and eight contacts."""

_MUJOCO: Any = mujoco  # more of its constants than its stubs have
_ROW, _STATE = _MUJOCO.mjtConstraint, _MUJOCO.mjtConstraintState
MACROS: dict[str, object] = {
    **newton.MACROS,
    "THREADS": islands.THREADS,
    "HELD_ROWS": islands.HELD_ROWS,
    "HELD_TREES": islands.HELD_TREES,
    "TASK_NUMBERS": islands.TASK_NUMBERS,
    "CONTACT_ELLIPTIC": int(_ROW.mjCNSTR_CONTACT_ELLIPTIC),
    "EQUALITY": int(_ROW.mjCNSTR_EQUALITY),
    "FRICTION_DOF": int(_ROW.mjCNSTR_FRICTION_DOF),
    "SATISFIED": int(_STATE.mjCNSTRSTATE_SATISFIED),
    "QUADRATIC": int(_STATE.mjCNSTRSTATE_QUADRATIC),
    "LINEAR_NEGATIVE": int(_STATE.mjCNSTRSTATE_LINEARNEG),
    "LINEAR_POSITIVE": int(_STATE.mjCNSTRSTATE_LINEARPOS),
    "SLIDING": int(_STATE.mjCNSTRSTATE_CONE),
}
"""Macros of the native code."""


@cache
def problem_type() -> Any:  # noqa: ANN401 - Warp's structs have no type
    """Return the struct of all arrays and sizes of the kernels.

    Sizes are those of the arrays; `sparse`: whether the Jacobian is; `warm`: whether to start from the last
    step's accelerations.
    """
    number, whole = warp.array(dtype=float), warp.array(dtype=int)
    number_2d, whole_2d = warp.array2d(dtype=float), warp.array2d(dtype=int)
    kinds = {
        "dof_tree tree_start tree_size mass_size mass_start mass_columns nefc dimension": whole,
        "impedance": number,
        "type id row_size row_start address": whole_2d,
        "columns": warp.array3d(dtype=int),
        "jacobian": warp.array3d(dtype=float),
        "weights reference bound inertia smooth_acceleration smooth_force warm_acceleration": number_2d,
        "friction": warp.array(dtype=import_module(WARP_TYPES).vec5),
        "labels roots offsets tallies islands listed counts tasks": whole,
        "scratch": number,
        "acceleration momentum constraint_force force": number_2d,
        "state": whole_2d,
        "iterations": whole,
        "worlds trees dofs most_rows most_values most_addresses padded_rows padded_dofs sparse": int,
        "masses impedances warm scratch_size": int,
    }
    # Warp reads annotations, so the struct's class is made from a table instead of written out.
    fields = {name: kind for names, kind in kinds.items() for name in names.split()}
    return warp.struct(type("BlockProblem", (), {"__annotations__": fields, "__module__": __name__}))


def islands_code(classes: tuple[SizeClass, ...]) -> str:
    """Return the native code that sorts rows by island, for some size classes."""
    fitting = islands.fitting_class([(one.slot, one.dofs) for one in classes])
    return expand_macros(islands.CODE, {**MACROS, "FITTING_CLASS": fitting})


@cache
def islands_kernel(classes: tuple[SizeClass, ...]) -> Any:  # noqa: ANN401 - as above
    """Return the kernel that sorts rows by island."""

    def sort_world(p: Any, index: int) -> None: ...  # noqa: ANN401 - as above

    # The struct's type is made at its first use.
    sort_world.__annotations__["p"] = problem_type()
    native = warp.func_native(islands_code(classes))(sort_world)

    def sort_rows_by_island(p: Any) -> None:  # noqa: ANN401 - as above
        native(p, warp.tid())

    sort_rows_by_island.__annotations__["p"] = problem_type()
    return warp.kernel(sort_rows_by_island, enable_backward=False, grid_stride=False, module="unique")


@cache
def newton_kernel(size: SizeClass, which: int) -> Any:  # noqa: ANN401 - as above
    """Return the kernel that solves islands of a size class, whose index is given, too."""

    def solve_group(p: Any, groups: int, index: int) -> None: ...  # noqa: ANN401 - as above

    solve_group.__annotations__["p"] = problem_type()
    native = warp.func_native(expand_macros(size.code(), size.words(which)))(solve_group)

    def solve_islands(p: Any, groups: int) -> None:  # noqa: ANN401 - as above
        native(p, groups, warp.tid())

    solve_islands.__annotations__["p"] = problem_type()
    options = {"enable_backward": False, "grid_stride": False, "cuda_max_registers": size.registers}
    # A module of its own: options such as fast divisions hold for a whole module.
    return warp.kernel(solve_islands, module="unique", module_options={"fast_math": size.fast}, **options)


def make_problem(m: Any, d: Any) -> Any:  # noqa: ANN401 - as above
    """Return the struct of a model and the data of its worlds, with new arrays for the islands."""
    p = problem_type()()
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
    p.acceleration, p.momentum, p.constraint_force = d.qacc, efc.Ma, d.qfrc_constraint
    p.force, p.state, p.iterations = efc.force, efc.state, d.solver_niter
    trees = d.nworld * m.ntree
    sizes = {
        "labels": d.nworld * d.njmax,
        "listed": 2 * d.nworld * d.njmax,
        "roots": trees,
        "offsets": trees,
        "tallies": 3 * trees,
        "islands": trees * islands.TASK_NUMBERS,
        "tasks": trees * len(CLASSES),
    }
    # Uninitialised: each step writes what it reads, and clearing would cost a pass over the memory.
    for name, size in sizes.items():
        setattr(p, name, warp.empty(size, dtype=int))
    # Counted up by atomics from zero.
    p.counts = warp.zeros(len(CLASSES), dtype=int)
    p.worlds, p.trees, p.dofs, p.most_rows = d.nworld, m.ntree, m.nv, d.njmax
    # The last axis of J: all values of a world if sparse, the columns of a row if not.
    p.most_values = p.padded_dofs = efc.J.shape[-1]
    p.most_addresses, p.padded_rows = contact.efc_address.shape[-1], efc.D.shape[-1]
    p.masses, p.impedances, p.sparse = d.M.shape[-1], p.impedance.shape[0], int(m.is_sparse)
    p.warm = int(not m.opt.disableflags & int(_MUJOCO.mjtDisableBit.mjDSBL_WARMSTART))
    p.scratch_size = newton.most_numbers(m.nv, d.njmax)
    return p


def solve(m: Any, d: Any) -> None:  # noqa: ANN401 - as above
    """Solve for the constraint forces of all worlds; model and data are MuJoCo Warp's.

    Writes accelerations, generalized constraint forces, forces and states of the rows, the product of mass
    matrix and accelerations, and the most iterations of a world's islands.
    """
    p, threads, device = make_problem(m, d), islands.THREADS, d.qacc.device
    warp.launch(islands_kernel(CLASSES), dim=d.nworld * threads, inputs=[p], block_dim=threads, device=device)
    branches = branches_of(device)
    for which, size_class in reversed(list(enumerate(CLASSES))):  # the largest, which take longest, first
        groups = min(d.nworld * m.ntree, size_class.most)
        if not size_class.slot:
            # Fewer groups take islands in turn, so that memory does not grow with the number of worlds.
            groups = max(1, min(groups, SCRATCH_NUMBERS // p.scratch_size))
            # The struct is copied into each launch: a later class may have another scratch.
            p.scratch = warp.empty(groups * p.scratch_size, dtype=float)
        groups += -groups % (32 // min(size_class.lanes, 32))  # whole warps
        dim, kernel = groups * size_class.lanes, newton_kernel(size_class, which)
        options = {"block_dim": size_class.block, "device": device, "stream": branches.stream(which)}
        warp.launch(kernel, dim=dim, inputs=[p, groups], **options)
    branches.join()
