"""Native code that solves small islands, whose Hessian is in registers.

The method is that of `newton`. Each lane has whole rows of the mass matrix and Hessian, whose size is fixed
when the code is compiled; rows beyond an island's are those of the identity. All islands of a warp go through
the code together: those that have converged wait without work.
"""

from usarmjx.engines.block.islands import SIZES_CODE
from usarmjx.engines.block.newton import PLACE_CODE, ROWS_CODE, UNIT_CODE

GROUP_CODE = """
    struct alignas(16) Four { float x, y, z, w; };
#if defined(__CUDA_ARCH__)
#define UNROLL _Pragma("unroll")
    const int lane = (int)(threadIdx.x % LANES);
    constexpr int lanes = LANES;
    constexpr unsigned all = 0xffffffffu;
    const int group = (int)((unsigned)index / LANES);
    const int first_lane = (int)(threadIdx.x % 32 / LANES * LANES);
    const auto wait = []() { __syncwarp(all); };
    const auto any = [](bool x) -> bool { return __any_sync(all, x) != 0; };
    const auto broadcast = [&](float value, int owner) -> float {
        return __shfl_sync(all, value, first_lane + owner);
    };
    const auto sum = [](float value) -> float {
        for (int step = LANES / 2; step > 0; step /= 2) value += __shfl_xor_sync(all, value, step);
        return value;
    };
    const auto most_of = [](int* at, int value) { atomicMax(at, value); };
    alignas(16) __shared__ float held[BLOCK / LANES * SLOT];
    float* const memory = held + threadIdx.x / LANES * SLOT;
#else
#define UNROLL
    if ((unsigned)index % LANES != 0) return;
    const int lane = 0;
    constexpr int lanes = 1;
    const int group = (int)((unsigned)index / LANES);
    const auto wait = []() {};
    const auto any = [](bool x) -> bool { return x; };
    const auto broadcast = [](float value, int) -> float { return value; };
    const auto sum = [](float value) -> float { return value; };
    const auto most_of = [](int* at, int value) { *at = value > *at ? value : *at; };
    alignas(16) float memory[SLOT];
#endif
    constexpr int own = (DOFS + lanes - 1) / lanes;  // rows of a lane: lane, lane + lanes, ...
    const auto at = [](int i, int j) -> int { return i * (i + 1) / 2 + j; };  // j <= i
    const auto read = [](const float* from, float* to) {
        UNROLL
        for (int c = 0; c < DOFS / 4; ++c) {
            const Four four = ((const Four*)from)[c];
            to[4 * c] = four.x;
            to[4 * c + 1] = four.y;
            to[4 * c + 2] = four.z;
            to[4 * c + 3] = four.w;
        }
    };
"""
"""Native functions of the lanes that handle an island, and their memory."""

LOAD_CODE = (
    """
        const bool given = place_of < count;
        const int task = given ? p.tasks.data[(size_t)SIZE_CLASS * worlds * trees + place_of] : 0;
        const int* const numbers = p.islands.data + (size_t)task * TASK_NUMBERS;
        const int world = task / trees, tree = task % trees;
        const int members = given ? numbers[0] : 0, n = given ? numbers[1] : 0, rows = given ? numbers[2] : 0;
        const int constraints = given ? numbers[3] : 0;
        const size_t first_row = (size_t)world * most_rows, first_tree = (size_t)world * trees;
        const size_t first_dof = (size_t)world * dofs, first_weight = (size_t)world * padded_rows;
        const int* const list = p.listed.data + 2 * (first_row + (given ? numbers[5] : 0));
        double* const accelerations = (double*)memory;
        float* const jac = memory + 2 * DOFS;
        float* const x = jac + rows * DOFS;  // J a - aref
        float* const v = x + rows;  // J search
        float* const weight = v + rows;
        float* const f = weight + rows;
        float* const aim = f + rows;  // aref
        float* const shape = aim + rows;  // bound or coefficients of friction
        int* const plan = (int*)(shape + rows);
        float* const hessian = (float*)(plan + 2 * constraints);
        float mass[own][DOFS], hess[own][DOFS], smooth[own], ma[own], ms[own], right[own], inverse[own];
        double a[own];
        int dof[own];

        // The mass matrix and the list of degrees of freedom pass through the memory of the rows.
        int* const dof_list = (int*)(jac + DOFS * DOFS);
        for (int k = lane; k < DOFS * DOFS; k += lanes) jac[k] = k % (DOFS + 1) == 0 && k / DOFS >= n;
        if (members == 1) {
            for (int i = lane; i < n; i += lanes) dof_list[i] = p.tree_start.data[tree] + i;
        } else if (given) {
            for (int k = tree + lane; k < trees; k += lanes) {
                if (p.roots.data[first_tree + k] != tree) continue;
                int* const mine = dof_list + p.offsets.data[first_tree + k];
                for (int i = 0; i < p.tree_size.data[k]; ++i) mine[i] = p.tree_start.data[k] + i;
            }
        }
        wait();
"""
    + PLACE_CODE
    + """
        float energy = 0.0f;
        UNROLL
        for (int o = 0; o < own; ++o) {
            const int i = lane + o * lanes;
            dof[o] = -1;
            a[o] = 0.0;
            smooth[o] = ma[o] = ms[o] = inverse[o] = 0.0f;
            if (i >= n) continue;
            const int row = dof_list[i], from = p.mass_start.data[row];
            const float* const values = p.inertia.data + (size_t)world * p.masses + from;
            for (int k = 0; k < p.mass_size.data[row]; ++k) {
                const int j = place(p.mass_columns.data[from + k]);
                jac[i * DOFS + j] = jac[j * DOFS + i] = values[k];
            }
            dof[o] = row;
            smooth[o] = p.smooth_force.data[first_dof + row];
            const float free = p.smooth_acceleration.data[first_dof + row];
            a[o] = p.warm ? p.warm_acceleration.data[first_dof + row] : free;
            energy += smooth[o] * free;
        }
        const float free_energy = max(sum(energy), LEAST_ENERGY);
        wait();
        UNROLL
        for (int o = 0; o < own; ++o) {
            const int i = lane + o * lanes;
            if (i < DOFS) {
                read(jac + i * DOFS, mass[o]);
                accelerations[i] = a[o];
            } else {
                UNROLL
                for (int c = 0; c < DOFS; ++c) mass[o][c] = 0.0f;
            }
        }
        wait();
        for (int k = lane; k < rows * DOFS; k += lanes) jac[k] = 0.0f;
        wait();
        constexpr int width = DOFS;
        const auto fill = [&](float* row, const float* values) {
            for (int k = 0; k < dofs; ++k) {
                const int owner = p.dof_tree.data[k];
                if (p.roots.data[first_tree + owner] == tree) row[place(k)] = values[k];
            }
        };
"""
    + ROWS_CODE
    + """
        // Sums of large terms that cancel: in single precision, stiff constraints would have wrong forces.
        const auto distance = [&](int r) -> float {
            double total = -aim[r];
            float row[DOFS];
            read(jac + r * DOFS, row);
            UNROLL
            for (int c = 0; c < DOFS; ++c) total += (double)row[c] * accelerations[c];
            return (float)total;
        };
        for (int r = lane; r < rows; r += lanes) x[r] = distance(r);
        int live = constraints;
        wait();
"""
)
"""Native code that reads an island."""

HESSIAN_CODE = """
            // Rows of the Hessian, and of the negative gradient on their right.
            UNROLL
            for (int o = 0; o < own; ++o) {
                double total = 0.0;
                UNROLL
                for (int c = 0; c < DOFS; ++c) {
                    hess[o][c] = mass[o][c];
                    total += (double)mass[o][c] * accelerations[c];
                }
                ma[o] = (float)total;
                total = smooth[o] - total;
                const int i = lane + o * lanes;
                if (i < DOFS)
                    for (int r = 0; r < live_rows; ++r) total += (double)jac[r * DOFS + i] * f[r];
                right[o] = (float)total;
            }
            const auto add = [&](int u, int dim) {
                const float* const h = hessian + plan[2 * u + 1];
                const float* const first = jac + begin_of(u) * DOFS;
                for (int k = 0; k < dim; ++k) {
                    float along[own], row[DOFS];
                    UNROLL
                    for (int o = 0; o < own; ++o) along[o] = 0.0f;
                    for (int l = 0; l < dim; ++l) {
                        const float part = l < k ? h[at(k, l)] : h[at(l, k)];
                        UNROLL
                        for (int o = 0; o < own; ++o) {
                            const int i = lane + o * lanes;
                            along[o] += part * first[l * DOFS + (i < DOFS ? i : 0)];
                        }
                    }
                    read(first + k * DOFS, row);
                    UNROLL
                    for (int o = 0; o < own; ++o) {
                        UNROLL
                        for (int c = 0; c < DOFS; ++c) hess[o][c] += along[o] * row[c];
                    }
                }
            };
            for (int u = 0; u < live; ++u) {
                if (hessian[plan[2 * u + 1]] == 0.0f) continue;
                if (size_of(u) == 3) { add(u, 3); continue; }  // unrolled
                add(u, size_of(u));
            }
"""
"""Native code of the Hessian and gradient."""

ELIMINATION_CODE = """
            // Elimination of the rows below each; the rows are those of Cholesky's factor but for a scale.
            float least[own], fall = 0.0f, search[DOFS];
            UNROLL
            for (int o = 0; o < own; ++o) {
                least[o] = 0.0f;
                UNROLL
                // Bounds and indices that are known to the compiler: others would put the rows out of
                // registers.
                for (int k = o * lanes; k < (o + 1) * lanes && k < DOFS; ++k)
                    if (lane == k - o * lanes) least[o] = 1e-7f * hess[o][k];
            }
            UNROLL
            for (int k = 0; k < DOFS; ++k) {
                const int owner = k % lanes, slot = k / lanes;
                const float scale = broadcast(1.0f / max(hess[slot][k], least[slot]), owner);
                if (lane == owner) inverse[slot] = scale;
                float part[own];
                UNROLL
                for (int o = 0; o < own; ++o) part[o] = lane + o * lanes > k ? hess[o][k] * scale : 0.0f;
                UNROLL
                for (int c = k + 1; c < DOFS; ++c) {
                    const float value = broadcast(hess[slot][c], owner);
                    UNROLL
                    for (int o = slot; o < own; ++o) hess[o][c] -= part[o] * value;
                }
                const float value = broadcast(right[slot], owner);
                UNROLL
                for (int o = slot; o < own; ++o) right[o] -= part[o] * value;
            }
            UNROLL
            for (int o = 0; o < own; ++o) fall += right[o] * right[o] * inverse[o];
            fall = sum(fall);
            UNROLL
            for (int k = DOFS - 1; k >= 0; --k) {
                const int owner = k % lanes, slot = k / lanes;
                const float value = broadcast(right[slot] * inverse[slot], owner);
                search[k] = value;
                UNROLL
                for (int o = 0; o <= slot; ++o) right[o] -= lane + o * lanes < k ? hess[o][k] * value : 0.0f;
                if (lane == owner) right[slot] = value;
            }
"""
"""Native code of the linear equations. Afterwards each lane has the whole solution, and its own part."""

NEWTON_CODE = (
    """
        int iteration = 0, stalls = 0;
        float before = 0.0f;
        bool converged = false, done = !given;
        for (;;) {
            const bool changed = sum(assess() ? 1.0f : 0.0f) > 0.0f;
            // However short a step is: one that changes states may leave forces far from their balance.
            if (converged && (++stalls > MOST_STALLS || !changed)) done = true;
            if (stalls > MOST_STALLS || iteration == MOST_ITERATIONS) done = true;
            if (!any(!done)) break;
            live = done ? 0 : constraints;
            const int live_rows = done ? 0 : rows;
            wait();
"""
    + HESSIAN_CODE
    + ELIMINATION_CODE
    + """
            float linear = 0.0f, square = 0.0f, motion = 0.0f;
            UNROLL
            for (int o = 0; o < own; ++o) {
                ms[o] = 0.0f;
                UNROLL
                for (int c = 0; c < DOFS; ++c) ms[o] += mass[o][c] * search[c];
                linear += right[o] * (ma[o] - smooth[o]);
                square += right[o] * ms[o];
                motion += (float)a[o] * ma[o];
            }
            for (int r = lane; r < live_rows; r += lanes) {
                float row[DOFS], total = 0.0f;
                read(jac + r * DOFS, row);
                UNROLL
                for (int c = 0; c < DOFS; ++c) total += row[c] * search[c];
                v[r] = total;
            }
            linear = sum(linear);
            square = sum(square);
            const float enough = STEP_TOLERANCE * STEP_TOLERANCE * max(sum(motion), free_energy);
            wait();
            float alpha = 1.0f;
            if (!done) {
                // Near the end, steps that do not shrink are roundings. NaN ends it, too.
                converged = !(fall > enough);
                const bool near = iteration > 0 && fall < NEAR_END * enough;
                if (!converged && near && fall > 0.25f * before) ++stalls;
                before = fall;
            }
            float low = 0.0f, high = -1.0f;
            bool searching = !done && !converged;
            for (int turn = 0; turn < MOST_EVALUATIONS && any(searching); ++turn) {
                float first, second;
                live = searching ? constraints : 0;
                slope(alpha, linear, square, first, second);
                if (!searching) continue;
                if (abs(first) <= SLOPE_TOLERANCE * fall) { searching = false; continue; }
                if (first < 0.0f) low = alpha; else high = alpha;
                alpha -= first / second;
                if (high >= 0.0f && !(alpha > low && alpha < high)) alpha = 0.5f * (low + high);
                else if (!(alpha > low)) alpha = 2.0f * low;
            }
            live = done ? 0 : constraints;
            UNROLL
            for (int o = 0; o < own; ++o) {
                const int i = lane + o * lanes;
                if (done || i >= n) continue;
                a[o] += (double)alpha * right[o];
                ma[o] += alpha * ms[o];
                accelerations[i] = a[o];
            }
            wait();
            for (int r = lane; r < live_rows; r += lanes) x[r] = distance(r);
            if (!done) ++iteration;
            wait();
        }
        UNROLL
        for (int o = 0; o < own; ++o) {
            if (dof[o] < 0) continue;
            float total = 0.0f;
            for (int r = 0; r < rows; ++r) total += jac[r * DOFS + lane + o * lanes] * f[r];
            const size_t target = first_dof + dof[o];
            p.acceleration.data[target] = (float)a[o];
            p.momentum.data[target] = ma[o];
            p.constraint_force.data[target] = total;
        }
        for (int u = lane; u < constraints; u += lanes) {
            const int from = list[2 * u] & (1 << ROW_BITS) - 1, r = begin_of(u), dim = size_of(u);
            const int row_state = state_of(u);
            for (int j = 0; j < dim; ++j) {
                p.force.data[first_row + from + j] = f[r + j];
                p.state.data[first_weight + from + j] = row_state;
            }
        }
        if (lane == 0 && given) most_of(p.iterations.data + world, iteration);
        wait();
"""
)
"""Native code of Newton's method and of its results."""

CODE = (
    "    using wp::abs; using wp::max; using wp::min; using wp::sqrt;\n"
    + SIZES_CODE
    + GROUP_CODE
    + """
    const int count = p.counts.data[SIZE_CLASS];
    for (int place_of = group; any(place_of < count); place_of += groups) {
"""
    + LOAD_CODE
    + UNIT_CODE
    + NEWTON_CODE
    + "    }\n#undef UNROLL\n"
)
"""Native code of an island's lanes."""
