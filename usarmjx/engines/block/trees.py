"""Factor and solve of the mass matrix beside solver `block`: a thread for each block of the matrix.

It takes the place of MuJoCo Warp's launches of tiles, for blocks up to a size: these fit registers. Factors
are not kept, as that solver does not need them.
"""

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

from usarmjx.engines.planar.warp_solids import expand_macros

warp: Any = import_module("warp")
warp.set_module_options({"enable_backward": False, "fast_math": False})

SMOOTH = "mujoco.mjx.third_party.mujoco_warp._src.smooth"
"""Private; the version of MJX is pinned."""
MOST_SIZE = 16
"""Largest block in registers [degrees of freedom]; 0: MuJoCo Warp's tiles solve all."""

BEGIN_CODE = """
#if defined(__CUDA_ARCH__)
#define UNROLL _Pragma("unroll")
#else
#define UNROLL
#endif
    using wp::sqrt;
"""
"""Native macros."""
LOAD_CODE = """
    const int block = index / worlds, world = index % worlds, start = starts.data[block];
    const int* const places = elements.data + (size_t)block * SIZE * SIZE;
    const float* const values = mass.data + (size_t)world * masses;
    const float* const given = right.data + (size_t)world * dofs + start;
    float factor[SIZE][SIZE], x[SIZE], inverse[SIZE];
    UNROLL
    for (int i = 0; i < SIZE; ++i) {
        x[i] = given[i];
        UNROLL
        for (int j = 0; j <= i; ++j) {
            const int place = places[i * SIZE + j];  // beyond the last: zero
            factor[i][j] = place < masses ? values[place] : 0.0f;
        }
    }
"""
"""Native code that loads a block and its right side."""
SOLVE_CODE = """
    UNROLL
    for (int k = 0; k < SIZE; ++k) {
        const float root = sqrt(factor[k][k]);
        inverse[k] = 1.0f / root;
        x[k] *= inverse[k];
        UNROLL
        for (int i = k + 1; i < SIZE; ++i) {
            factor[i][k] *= inverse[k];
            x[i] -= factor[i][k] * x[k];
            UNROLL
            for (int j = k + 1; j <= i; ++j) factor[i][j] -= factor[i][k] * factor[j][k];
        }
    }
    UNROLL
    for (int k = SIZE - 1; k >= 0; --k) {
        x[k] *= inverse[k];
        UNROLL
        for (int i = 0; i < k; ++i) x[i] -= factor[k][i] * x[k];
    }
"""
"""Native code of Cholesky's factor, then both triangular systems."""
STORE_CODE = """
    float* const found = solution.data + (size_t)world * dofs + start;
    UNROLL
    for (int k = 0; k < SIZE; ++k) found[k] = x[k];
"""
"""Native code that stores the solution."""
END_CODE = """
#undef UNROLL
"""
"""Native macros, undefined."""
CODE = BEGIN_CODE + LOAD_CODE + SOLVE_CODE + STORE_CODE + END_CODE
"""Native code of a thread."""


@cache
def solve_kernel(size: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel that solves blocks of a size."""
    array, whole = warp.array(dtype=float), warp.array(dtype=int)
    kinds = {
        **dict.fromkeys(("starts", "elements"), whole),
        **dict.fromkeys(("mass", "right"), array),
        **dict.fromkeys(("worlds", "masses", "dofs"), int),
        "solution": array,
    }

    def solve_one(  # noqa: PLR0913 - a kernel's arguments are its buffers
        starts: object,
        elements: object,
        mass: object,
        right: object,
        worlds: int,
        masses: int,
        dofs: int,
        solution: object,
        index: int,
    ) -> None: ...

    # Warp's types are values made above, which annotations cannot name.
    solve_one.__annotations__.update(kinds)
    native = warp.func_native(expand_macros(CODE, {"SIZE": size}))(solve_one)

    def solve_blocks(  # noqa: PLR0913 - as above
        starts: object,
        elements: object,
        mass: object,
        right: object,
        worlds: int,
        masses: int,
        dofs: int,
        solution: object,
    ) -> None:
        native(starts, elements, mass, right, worlds, masses, dofs, solution, warp.tid())

    solve_blocks.__annotations__.update(kinds)
    return warp.kernel(solve_blocks, enable_backward=False, grid_stride=False, module="unique")


def fits(m: Any, factor: Any) -> bool:  # noqa: ANN401 - as above
    """Return whether all blocks are dense and small, given the model and the array of factors."""
    sizes = [tile.size for tile in m.M_tiles if tile.elemid.size]
    # A longer factor has sparse blocks (LDL) behind the dense ones, which this kernel does not solve.
    return bool(sizes) and max(sizes) <= MOST_SIZE and factor.shape[1] == m.qLD_block_total


def factor_solve(
    m: Any,  # noqa: ANN401 - as above
    d: Any,  # noqa: ANN401
    mass: Any,  # noqa: ANN401
    factor: Any,  # noqa: ANN401
    diagonal: Any,  # noqa: ANN401
    solution: Any,  # noqa: ANN401
    right: Any,  # noqa: ANN401
) -> None:
    """Solve a system of the mass matrix; arguments as of MuJoCo Warp's `factor_solve_i`.

    Factors of blocks in registers are not written.
    """
    smooth = import_module(SMOOTH)
    if not fits(m, factor):
        smooth.factor_solve_i(m, d, mass, factor, diagonal, solution, right)
        return
    # Native code indexes plain memory; `flatten` is a view of contiguous arrays and copies nothing.
    flat = [array.flatten() for array in (mass, right, solution)]
    for tile in m.M_tiles:
        blocks = tile.adr.size
        # Diagonal and small full blocks, which MuJoCo Warp itself solves by a thread each.
        if not tile.elemid.size:
            warp.launch(
                smooth._small_cholesky_factorize_solve_block(tile.size),
                dim=(d.nworld, blocks),
                inputs=[m.M_rowadr, m.qLD_block_adr, mass, tile.adr, right],
                outputs=[diagonal, solution, factor],
                block_dim=m.block_dim.small_cholesky,
            )
            continue
        sizes = [d.nworld, mass.shape[1], right.shape[1]]
        warp.launch(
            solve_kernel(tile.size),
            dim=d.nworld * blocks,
            inputs=[tile.adr, tile.elemid, *flat[:2], *sizes],
            outputs=flat[2:],
            block_dim=64,
        )


def smooth_module() -> ModuleType:
    """Return a copy of MuJoCo Warp's module `smooth` with `factor_solve` in place of its own."""
    copied = ModuleType(SMOOTH)
    # A copy: the module itself serves other models, which may need its own function.
    copied.__dict__.update({**vars(import_module(SMOOTH)), "factor_solve_i": factor_solve})
    return copied
