"""Native code that sorts the constraint rows of each world by island.

Kinematic trees that a constraint couples are one island. A constraint is one row, or all rows of a contact
with an elliptic cone. A block of threads handles a world: its threads join the trees, then each thread lists
the constraints of its islands in the order of their rows.
"""

from collections.abc import Sequence

THREADS = 64
"""Threads of a block, which handles one world."""
HELD_ROWS, HELD_TREES = 1024, 256
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
    __shared__ int held_labels[HELD_ROWS], held_roots[HELD_TREES];
    const int lane = (int)threadIdx.x, lanes = THREADS;
    const int world = (int)((unsigned)index / THREADS);
    const auto wait = []() { __syncthreads(); };
    const auto any = [](bool x) { return __syncthreads_or(x) != 0; };
    const auto lower = [](int* at, int value) { atomicMin(at, value); };
    const auto take = [](int* at) { return atomicAdd(at, 1); };
#else
    if ((unsigned)index % THREADS != 0) return;
    const int lane = 0, lanes = 1;
    const int world = (int)((unsigned)index / THREADS);
    const auto wait = []() {};
    const auto any = [](bool x) { return x; };
    const auto lower = [](int* at, int value) { *at = value < *at ? value : *at; };
    const auto take = [](int* at) { return (*at)++; };
#endif
    if (world >= worlds) return;
    const int rows = p.nefc.data[world] < most_rows ? p.nefc.data[world] : most_rows;
    const size_t first_row = (size_t)world * most_rows, first_tree = (size_t)world * trees;
#if defined(__CUDA_ARCH__)
    int* const label = rows <= HELD_ROWS ? held_labels : p.labels.data + first_row;
    int* const root = trees <= HELD_TREES ? held_roots : p.roots.data + first_tree;
#else
    int* const label = p.labels.data + first_row;
    int* const root = p.roots.data + first_tree;
#endif
    int* const offset = p.offsets.data + first_tree;
    for (int t = lane; t < trees; t += lanes) root[t] = t;
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
        if (high >= 0) label[r] = low | high << 12 | count << 24;
    }
    wait();
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
    for (int r = lane; r < rows; r += lanes)
        if (label[r] >= 0) label[r] = label[r] & ~4095 | root[label[r] & 4095];
    for (int t = lane; t < trees; t += lanes) p.roots.data[first_tree + t] = root[t];
    wait();

    // Each thread sizes its islands.
    for (int t = lane; t < trees; t += lanes) {
        if (root[t] != t) continue;
        int members = 0, size = 0, count = 0, constraints = 0, hessians = 0;
        for (int k = t; k < trees; ++k) {
            if (root[k] != t) continue;
            offset[k] = size;
            size += p.tree_size.data[k];
            ++members;
        }
        for (int r = 0; r < rows; ++r) {
            const int packed = label[r];
            if (packed < 0 || (packed & 4095) != t) continue;
            const int dim = packed >> 24;
            ++constraints;
            count += dim;
            hessians += dim * (dim + 1) / 2;
        }
        int* const numbers = p.islands.data + (first_tree + t) * TASK_NUMBERS;
        numbers[0] = members;
        numbers[1] = size;
        numbers[2] = count;
        numbers[3] = constraints;
        numbers[4] = hessians;
    }
    wait();
    for (int t = lane; t < trees; t += lanes) {
        int* const numbers = p.islands.data + (first_tree + t) * TASK_NUMBERS;
        if (root[t] != t || numbers[3] == 0) continue;
        int start = 0;
        for (int k = 0; k < t; ++k)
            if (root[k] == k) start += p.islands.data[(first_tree + k) * TASK_NUMBERS + 3];
        numbers[5] = start;
        int* to = p.listed.data + 2 * (first_row + start);
        int before = 0, hessians = 0;
        for (int r = 0; r < rows; ++r) {
            const int packed = label[r];
            if (packed < 0 || (packed & 4095) != t) continue;
            const int dim = packed >> 24;
            *to++ = r | dim << ROW_BITS;
            *to++ = (int)((unsigned)before | (unsigned)hessians << ROW_BITS);
            before += dim;
            hessians += dim * (dim + 1) / 2;
        }
        const int n = numbers[1], count = numbers[2], units = numbers[3];
        const int size_class = FITTING_CLASS;
        const int place = take(p.counts.data + size_class);
        p.tasks.data[(size_t)size_class * worlds * trees + place] = world * trees + t;
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
