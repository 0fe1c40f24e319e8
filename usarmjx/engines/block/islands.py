"""Native code that sorts the constraint rows of each world by island.

Kinematic trees that a constraint couples are one island. A constraint is one row, or all rows of a contact
with an elliptic cone. A block of threads handles a world: its threads join the trees and count what islands
have, then a warp lists the constraints of each island in the order of their rows.
"""

from collections.abc import Sequence

THREADS = 64
"""Threads of a block, which handles one world."""
HELD_ROWS, HELD_TREES = 1024, 128
"""Rows and trees of a world that a GPU's shared memory has room for; more are in global memory."""
TASK_NUMBERS = 6
"""Numbers of an island: its trees, degrees of freedom, rows, constraints, numbers of its Hessians, offset of
its constraints in the list of its world."""
NEED_CODE = """
    // Numbers that an island needs: the layout is that of `newton.LOAD_CODE`.
    const auto need_of = [](int n, int rows, int constraints, int hessians) -> int {
        return rows * (n + 6) + 2 * constraints + hessians + (n + 1) * (n + 2) / 2 + n * (n + 1) / 2 + 8 * n;
    };
    // The same for islands with a Hessian in registers: the layout is that of `small.LOAD_CODE`.
    const auto small_need_of = [](int most, int rows, int constraints, int hessians) -> int {
        return 2 * most + rows * (most + 6) + 2 * constraints + hessians;
    };
"""
"""Native functions of an island's degrees of freedom, rows, constraints and numbers of their Hessians."""

SIZES_CODE = """
    const int worlds = p.worlds, trees = p.trees, dofs = p.dofs;
    const int most_rows = p.most_rows, most_values = p.most_values, padded_rows = p.padded_rows;
    const int padded_dofs = p.padded_dofs;
    const bool sparse = p.sparse != 0;
"""
"""Native constants: sizes of the arrays."""

SORT_CODE = """
#if defined(__CUDA_ARCH__)
    __shared__ int held_labels[HELD_ROWS], held_roots[HELD_TREES], held_tallies[HELD_TREES * 3];
    constexpr int width = 32;
    const int lane = (int)threadIdx.x, lanes = THREADS;
    const int world = (int)((unsigned)index / THREADS);
    const auto wait = []() { __syncthreads(); };
    const auto any = [](bool x) { return __syncthreads_or(x) != 0; };
    const auto lower = [](int* at, int value) { atomicMin(at, value); };
    const auto add = [](int* at, int value) { return atomicAdd(at, value); };
    const auto wait_of_warp = []() { __syncwarp(0xffffffffu); };
    const auto alike = [](int x) -> unsigned { return __match_any_sync(0xffffffffu, x); };
    const auto first_of = [](unsigned x) -> int { return __ffs((int)x) - 1; };
#else
    if ((unsigned)index % THREADS != 0) return;
    const int lane = 0, lanes = 1;
    constexpr int width = 1;
    const int world = (int)((unsigned)index / THREADS);
    const auto wait = []() {};
    const auto any = [](bool x) { return x; };
    const auto lower = [](int* at, int value) { *at = value < *at ? value : *at; };
    const auto add = [](int* at, int value) {
        const int before = *at;
        *at += value;
        return before;
    };
    const auto wait_of_warp = []() {};
    const auto alike = [](int) -> unsigned { return 1u; };
    const auto first_of = [](unsigned) -> int { return 0; };
#endif
    if (world >= worlds) return;
    const int rows = p.nefc.data[world] < most_rows ? p.nefc.data[world] : most_rows;
    const size_t first_row = (size_t)world * most_rows, first_tree = (size_t)world * trees;
#if defined(__CUDA_ARCH__)
    int* const label = rows <= HELD_ROWS ? held_labels : p.labels.data + first_row;
    const bool held = trees <= HELD_TREES;
    int* const root = held ? held_roots : p.roots.data + first_tree;
    // Of each island: rows, constraints, numbers of its Hessians; later those that are listed already.
    int* const tallies = held ? held_tallies : p.tallies.data + 3 * first_tree;
#else
    int* const label = p.labels.data + first_row;
    int* const root = p.roots.data + first_tree;
    int* const tallies = p.tallies.data + 3 * first_tree;
#endif
    int* const offset = p.offsets.data + first_tree;
    for (int t = lane; t < trees; t += lanes) {
        root[t] = t;
        for (int i = 0; i < 3; ++i) tallies[t * 3 + i] = 0;
    }
    if (lane == 0) p.iterations.data[world] = 0;

    // Of the first row of each constraint: its two trees, and how many rows it has.
    for (int r = lane; r < rows; r += lanes) {
        label[r] = -1;
        int count = 1;
        if (p.type.data[first_row + r] == CONTACT_ELLIPTIC) {
            const int contact = p.id.data[first_row + r];
            if (p.address.data[(size_t)contact * p.most_addresses] != r) continue;
            count = p.dimension.data[contact];
            if (r + count > rows) continue;
        }
        int low = trees, high = -1;
        if (sparse) {
            const size_t values = (size_t)world * most_values;
            const int from = p.row_start.data[first_row + r], size = p.row_size.data[first_row + r];
            if (from + size > most_values) continue;
            for (int k = 0; k < size; ++k) {
                const int tree = p.dof_tree.data[p.columns.data[values + from + k]];
                low = tree < low ? tree : low;
                high = tree > high ? tree : high;
            }
        } else {
            // Zeros are not stored apart: a tree may be in some rows of a contact only.
            const float* const first = p.jacobian.data + ((size_t)world * padded_rows + r) * padded_dofs;
            for (int k = 0; k < count; ++k) {
                const float* const row = first + (size_t)k * padded_dofs;
                for (int i = 0; i < dofs; ++i) {
                    if (row[i] == 0.0f) continue;
                    const int tree = p.dof_tree.data[i];
                    low = tree < low ? tree : low;
                    high = tree > high ? tree : high;
                }
            }
        }
        // 12 bits for each tree, the rest for the count.
        if (high >= 0) label[r] = low | high << 12 | count << 24;
    }
    wait();
    // Each constraint lowers both of its trees to the lesser of their islands, until none changes any more.
    bool changed = true;
    while (any(changed)) {
        changed = false;
        for (int r = lane; r < rows; r += lanes) {
            if (label[r] < 0) continue;
            const int low = label[r] & 4095, high = label[r] >> 12 & 4095;
            if (low == high) continue;
            const int one = root[low], other = root[high], least = one < other ? one : other;
            if (one == other) continue;
            changed = true;
            lower(root + low, least);
            lower(root + high, least);
        }
        wait();
    }

    // From now on, a row has its island in place of its lower tree.
    for (int r = lane; r < rows; r += lanes) {
        if (label[r] < 0) continue;
        const int island = root[label[r] & 4095], dim = label[r] >> 24;
        label[r] = label[r] & ~4095 | island;
        add(tallies + island * 3, dim);
        add(tallies + island * 3 + 1, 1);
        add(tallies + island * 3 + 2, dim * (dim + 1) / 2);
    }
    for (int t = lane; t < trees; t += lanes) p.roots.data[first_tree + t] = root[t];
    wait();

    // Each thread sizes its islands.
    for (int t = lane; t < trees; t += lanes) {
        if (root[t] != t) continue;
        int members = 0, n = 0, start = 0;
        for (int k = t; k < trees; ++k) {
            if (root[k] != t) continue;
            offset[k] = n;
            n += p.tree_size.data[k];
            ++members;
        }
        for (int k = 0; k < t; ++k) start += tallies[k * 3 + 1];  // only islands have any
        int* const numbers = p.islands.data + (first_tree + t) * TASK_NUMBERS;
        const int count = tallies[t * 3], units = tallies[t * 3 + 1];
        const int hessians = tallies[t * 3 + 2];
        numbers[0] = members;
        numbers[1] = n;
        numbers[2] = count;
        numbers[3] = units;
        numbers[4] = hessians;
        numbers[5] = start;
        if (units == 0) continue;
        const int size_class = FITTING_CLASS;
        const int place = add(p.counts.data + size_class, 1);
        p.tasks.data[(size_t)size_class * worlds * trees + place] = world * trees + t;
    }
    wait();
    for (int t = lane; t < trees; t += lanes) {
        if (root[t] != t) continue;
        tallies[t * 3] = tallies[t * 3 + 2] = 0;
        tallies[t * 3 + 1] = p.islands.data[(first_tree + t) * TASK_NUMBERS + 5];
    }
    wait();

    // One warp lists the constraints in the order of their rows: of each island those of 32 rows at a time.
    for (int begin = 0; lane < width && begin < rows; begin += width) {
        const int r = begin + lane, packed = r < rows ? label[r] : -1;
        const unsigned mine = alike(packed < 0 ? -1 : packed & 4095);
        int* const tally = tallies + (packed & 4095) * 3;
        const int dim = packed >> 24;
        int before = 0, place = 0, hessians = 0;
        if (packed >= 0) {
            before = tally[0];
            place = tally[1];
            hessians = tally[2];
            for (unsigned earlier = mine & (1u << lane) - 1u; earlier != 0u; earlier &= earlier - 1u) {
                const int other = label[begin + first_of(earlier)] >> 24;
                before += other;
                ++place;
                hessians += other * (other + 1) / 2;
            }
            int* const to = p.listed.data + 2 * (first_row + place);
            to[0] = r | dim << ROW_BITS;
            to[1] = (int)((unsigned)before | (unsigned)hessians << ROW_BITS);
        }
        wait_of_warp();
        if (packed >= 0 && mine >> lane == 1u) {  // the island's last of these rows
            tally[0] = before + dim;
            tally[1] = place + 1;
            tally[2] = hessians + dim * (dim + 1) / 2;
        }
        wait_of_warp();
    }

    // Trees without constraints move as without them.
    for (int i = lane; i < dofs; i += lanes) {
        const size_t at = (size_t)world * dofs + i;
        if (p.islands.data[(first_tree + root[p.dof_tree.data[i]]) * TASK_NUMBERS + 3] != 0) continue;
        p.acceleration.data[at] = p.smooth_acceleration.data[at];
        p.momentum.data[at] = p.smooth_force.data[at];
        p.constraint_force.data[at] = 0.0f;
    }
    for (int r = lane; r < rows; r += lanes) {
        p.force.data[first_row + r] = 0.0f;
        p.state.data[(size_t)world * padded_rows + r] = SATISFIED;
    }
"""
"""Native code of a block of threads."""
CODE = NEED_CODE + SIZES_CODE + SORT_CODE
"""Native code of the kernel."""


def fitting_class(sizes: Sequence[tuple[int, int]]) -> str:
    """Return the native expression of an island's size class.

    Args:
        sizes: Of each class, the numbers of shared memory of an island, 0: any, and the most degrees of
            freedom, 0: any, with the Hessian in shared memory.
    """
    # The last class takes whatever fits none before, so it has no test.
    *first, _ = sizes
    tests = [
        f"n <= {dofs} && small_need_of({dofs}, count, units, hessians) <= {slot} ? {k} : "
        if dofs
        else f"need_of(n, count, units, hessians) <= {slot} ? {k} : "
        for k, (slot, dofs) in enumerate(first)
    ]
    return f"{''.join(tests)}{len(first)}"
