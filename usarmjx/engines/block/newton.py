"""Native code that solves the islands of constraint rows, each by Newton's method to convergence.

The problem is MuJoCo's: the acceleration that minimises the deviation from the unconstrained one, weighted
by the mass matrix, plus a cost of each constraint (the "Computation" chapter of its documentation). Some
lanes of a warp, or a block of threads, handle an island; its rows, mass matrix and Hessian are in shared
memory. Sums have a fixed order; those of forces and of distances to constraints are in double precision. On
a CPU, the first lane handles the whole island.
"""

from usarmjx.engines.block import ROW_BITS
from usarmjx.engines.block.islands import SIZES_CODE

MOST_ITERATIONS = 40
"""Most Newton iterations of an island. Most islands take two to five."""
MOST_EVALUATIONS = 16
"""Most evaluations of a line search."""
STEP_TOLERANCE = 1e-5
"""Length of a Newton step, relative to the accelerations with and without constraints, all in the norm of the
Hessian or mass matrix, after which an island has converged."""
SLOPE_TOLERANCE = 0.01
"""Slope at the end of a line search, relative to that at its start."""

GROUP_CODE = """
#if defined(__CUDA_ARCH__)
    const int lane = (int)(threadIdx.x % LANES);
    constexpr int lanes = LANES;
    const int group = (int)((unsigned)index / LANES);
    const unsigned mask =
        LANES >= 32 ? 0xffffffffu : ((1u << LANES % 32) - 1u) << (threadIdx.x % 32 / LANES * LANES);
    const auto wait = [&]() { if (LANES > 32) __syncthreads(); else __syncwarp(mask); };
    const auto most_of = [](int* at, int value) { atomicMax(at, value); };
#if LANES > 32
    __shared__ float partial[LANES / 32];
    const auto sum = [&](float value) -> float {
        for (int step = 16; step > 0; step /= 2) value += __shfl_xor_sync(0xffffffffu, value, step);
        if (lane % 32 == 0) partial[lane / 32] = value;
        __syncthreads();
        float total = 0.0f;
        for (int k = 0; k < LANES / 32; ++k) total += partial[k];
        __syncthreads();
        return total;
    };
#else
    const auto sum = [&](float value) -> float {
        for (int step = LANES / 2; step > 0; step /= 2) value += __shfl_xor_sync(mask, value, step);
        return value;
    };
#endif
#if SLOT > 0
    __shared__ float held[BLOCK / LANES * SLOT];
    float* const memory = held + threadIdx.x / LANES * SLOT;
#endif
#else
    if ((unsigned)index % LANES != 0) return;
    const int lane = 0, lanes = 1;
    const int group = (int)((unsigned)index / LANES);
    const auto wait = []() {};
    const auto most_of = [](int* at, int value) { *at = value > *at ? value : *at; };
    const auto sum = [](float value) -> float { return value; };
#if SLOT > 0
    float memory[SLOT];
#endif
#endif
#if SLOT == 0
    float* const memory = p.scratch.data + (size_t)group * p.scratch_size;
#endif
    const auto at = [](int i, int j) -> int { return i * (i + 1) / 2 + j; };  // j <= i
"""
"""Native functions of the lanes that handle an island, and their memory."""

UNIT_CODE = """
        // Of a constraint: its first row here, its number of rows, and its kind.
        const auto begin_of = [&](int u) -> int { return plan[2 * u] & 0xffff; };
        const auto size_of = [&](int u) -> int { return plan[2 * u] >> 16 & 15; };
        const auto kind_of = [&](int u) -> int { return plan[2 * u] >> 20; };

        // State of a constraint, as its force and Hessian show it.
        const auto state_of = [&](int u) -> int {
            const int r = begin_of(u), kind = kind_of(u);
            const float curve = hessian[plan[2 * u + 1]];
            if (curve == 0.0f)
                return kind != KIND_FRICTION ? SATISFIED : f[r] > 0.0f ? LINEAR_NEGATIVE : LINEAR_POSITIVE;
            return kind == KIND_CONE && curve != weight[r] ? SLIDING : QUADRATIC;
        };
        // Forces of a constraint, and the Hessian of its cost.
        const auto assess_one = [&](int u) {
            const int r = begin_of(u), dim = size_of(u), kind = kind_of(u);
            float* const h = hessian + plan[2 * u + 1];
            if (kind != KIND_CONE) {
                const float value = x[r], stiff = weight[r];
                float push = -stiff * value, curve = stiff;
                if (kind == KIND_FRICTION) {
                    const float most = shape[r];
                    if (push > most || push < -most) { push = push > 0.0f ? most : -most; curve = 0.0f; }
                } else if (kind == KIND_ONE_SIDED && value >= 0.0f) {
                    push = 0.0f;
                    curve = 0.0f;
                }
                f[r] = push;
                h[0] = curve;
                return;
            }
            const float mu = shape[r], normal = x[r] * mu;
            float square = 0.0f;
            for (int j = 1; j < dim; ++j) {
                const float part = x[r + j] * shape[r + j];
                square += part * part;
            }
            const float slip = sqrt(square);
            // MuJoCo's zones of a cone: above it no force, in its dual below a quadratic cost, sliding
            // between them.
            const bool open = normal >= mu * slip, stuck = !open && mu * normal + slip <= 0.0f;
            if (open || stuck) {
                for (int j = 0, k = 0; j < dim; ++j) {
                    f[r + j] = open ? 0.0f : -weight[r + j] * x[r + j];
                    for (int i = 0; i <= j; ++i, ++k) h[k] = open || i != j ? 0.0f : weight[r + j];
                }
                return;
            }
            // MuJoCo's Dm: weight of the distance from the cone.
            const float stiff = weight[r] / (mu * mu * (1.0f + mu * mu));
            const float gap = normal - mu * slip, along = 1.0f / max(slip, TINY);
            f[r] = -stiff * gap * mu;
            h[0] = stiff * mu * mu;
            for (int j = 1, k = 1; j < dim; ++j) {
                const float one = x[r + j] * shape[r + j] * along;  // of the direction of slip
                f[r + j] = stiff * gap * mu * one * shape[r + j];
                h[k++] = -stiff * mu * mu * one * shape[r + j];
                for (int i = 1; i <= j; ++i, ++k) {
                    const float other = x[r + i] * shape[r + i] * along;
                    const float across = (i == j ? 1.0f : 0.0f) - one * other;
                    const float both = mu * one * other - gap * along * across;
                    h[k] = stiff * mu * both * shape[r + i] * shape[r + j];
                }
            }
        };
        // The same of all constraints; whether the state of one of the lane's has changed.
        const auto assess = [&]() -> bool {
            bool changed = false;
            for (int u = lane; u < live; u += lanes) {
                const int before = state_of(u);
                assess_one(u);
                changed |= state_of(u) != before;
            }
            return changed;
        };

        // First and second derivative of a constraint's cost along the search direction.
        const auto bend = [&](int u, float alpha, float& first, float& second) {
            const int r = begin_of(u), dim = size_of(u), kind = kind_of(u);
            if (kind != KIND_CONE) {
                const float value = x[r] + alpha * v[r], stiff = weight[r], pull = stiff * value;
                if (kind == KIND_FRICTION && (pull > shape[r] || pull < -shape[r])) {
                    first += (pull > 0.0f ? shape[r] : -shape[r]) * v[r];
                } else if (kind != KIND_ONE_SIDED || value < 0.0f) {
                    first += pull * v[r];
                    second += stiff * v[r] * v[r];
                }
                return;
            }
            const float mu = shape[r], normal = (x[r] + alpha * v[r]) * mu, rate = v[r] * mu;
            float square = 0.0f, mixed = 0.0f, speed = 0.0f;
            for (int j = 1; j < dim; ++j) {
                const float part = (x[r + j] + alpha * v[r + j]) * shape[r + j];
                const float change = v[r + j] * shape[r + j];
                square += part * part;
                mixed += part * change;
                speed += change * change;
            }
            const float slip = sqrt(square);
            if (normal >= mu * slip) return;
            if (mu * normal + slip <= 0.0f) {
                for (int j = 0; j < dim; ++j) {
                    first += weight[r + j] * (x[r + j] + alpha * v[r + j]) * v[r + j];
                    second += weight[r + j] * v[r + j] * v[r + j];
                }
                return;
            }
            const float stiff = weight[r] / (mu * mu * (1.0f + mu * mu));
            const float gap = normal - mu * slip, along = 1.0f / max(slip, TINY);
            const float turn = mixed * along, close = rate - mu * turn;
            first += stiff * gap * close;
            second += stiff * (close * close - gap * mu * max(speed - turn * turn, 0.0f) * along);
        };
        const auto slope = [&](float alpha, float linear, float square, float& first, float& second) {
            float one = 0.0f, two = 0.0f;
            for (int u = lane; u < live; u += lanes) bend(u, alpha, one, two);
            first = linear + alpha * square + sum(one);
            second = square + sum(two);
        };
"""
"""Native functions of the costs of an island's constraints."""

PLACE_CODE = """
        const int shift = members == 1 ? p.tree_start.data[tree] : 0;
        const auto place = [&](int i) -> int {
            if (members == 1) return i - shift;
            const int owner = p.dof_tree.data[i];
            return p.offsets.data[first_tree + owner] + i - p.tree_start.data[owner];
        };
"""
"""Native code of the column of a degree of freedom."""

ROWS_CODE = """
        for (int u = lane; u < constraints; u += lanes) {
            const int from = list[2 * u] & (1 << ROW_BITS) - 1, dim = list[2 * u] >> ROW_BITS;
            const int r = list[2 * u + 1] & (1 << ROW_BITS) - 1, what = p.type.data[first_row + from];
            const int kind = what == CONTACT_ELLIPTIC ? KIND_CONE
                : what == EQUALITY ? KIND_TWO_SIDED
                : what == FRICTION_DOF ? KIND_FRICTION : KIND_ONE_SIDED;
            plan[2 * u] = r | dim << 16 | kind << 20;
            plan[2 * u + 1] = (int)((unsigned)list[2 * u + 1] >> ROW_BITS);
            const size_t contact = kind == KIND_CONE ? p.id.data[first_row + from] : 0;
            const float* const rubs = (const float*)p.friction.data + contact * 5;
            for (int j = 0; j < dim; ++j) {
                weight[r + j] = p.weights.data[first_weight + from + j];
                aim[r + j] = p.reference.data[first_row + from + j];
                shape[r + j] = kind == KIND_FRICTION ? p.bound.data[first_row + from + j]
                    : kind != KIND_CONE ? 0.0f
                    : j > 0 ? rubs[j - 1] : rubs[0] * p.impedance.data[world % p.impedances];
                float* const row = jac + (r + j) * width;
                if (sparse) {
                    const size_t start = (size_t)world * most_values + p.row_start.data[first_row + from + j];
                    for (int k = 0; k < p.row_size.data[first_row + from + j]; ++k)
                        row[place(p.columns.data[start + k])] = p.jacobian.data[start + k];
                } else {
                    fill(row, p.jacobian.data + (first_weight + from + j) * padded_dofs);
                }
            }
        }
        wait();
"""
"""Native code that reads the rows of an island, which are `width` numbers long.

`fill` takes a row from all columns of a dense Jacobian.
"""

LOAD_CODE = (
    """
        const int* const numbers = p.islands.data + (size_t)task * TASK_NUMBERS;
        const int world = task / trees, tree = task % trees;
        const int members = numbers[0], n = numbers[1], rows = numbers[2];
        const int constraints = numbers[3], live = constraints, hessians = numbers[4];
        const size_t first_row = (size_t)world * most_rows, first_tree = (size_t)world * trees;
        const size_t first_dof = (size_t)world * dofs, first_weight = (size_t)world * padded_rows;
        const int* const list = p.listed.data + 2 * (first_row + numbers[5]);
        float* const jac = memory;
        float* const x = jac + rows * n;  // J a - aref
        float* const v = x + rows;  // J search
        float* const weight = v + rows;
        float* const f = weight + rows;
        float* const aim = f + rows;  // aref
        float* const shape = aim + rows;  // bound or coefficients of friction
        int* const plan = (int*)(shape + rows);
        float* const hessian = (float*)(plan + 2 * constraints);
        float* const factor = hessian + hessians;  // its last row is the right side of the linear equations
        float* const mass = factor + (n + 1) * (n + 2) / 2;
        float* const a = mass + n * (n + 1) / 2;
        float* const rest = a + n;  // of the accelerations, beyond single precision
        float* const ma = rest + n;
        float* const search = ma + n;
        float* const ms = search + n;  // M search
        float* const inverse = ms + n;  // of the diagonal of the factor
        float* const smooth = inverse + n;
        int* const dof = (int*)(smooth + n);
        float* const last = factor + at(n, 0);

        for (int k = lane; k < rows * n; k += lanes) jac[k] = 0.0f;
        for (int k = lane; k < n * (n + 1) / 2; k += lanes) mass[k] = 0.0f;
        if (members == 1) {
            for (int i = lane; i < n; i += lanes) dof[i] = p.tree_start.data[tree] + i;
        } else {
            for (int k = tree + lane; k < trees; k += lanes) {
                if (p.roots.data[first_tree + k] != tree) continue;
                int* const mine = dof + p.offsets.data[first_tree + k];
                for (int i = 0; i < p.tree_size.data[k]; ++i) mine[i] = p.tree_start.data[k] + i;
            }
        }
        wait();
"""
    + PLACE_CODE
    + """
        for (int i = lane; i < n; i += lanes) {
            const int row = dof[i], from = p.mass_start.data[row];
            const float* const values = p.inertia.data + (size_t)world * p.masses + from;
            for (int k = 0; k < p.mass_size.data[row]; ++k)
                mass[at(i, place(p.mass_columns.data[from + k]))] = values[k];
            rest[i] = 0.0f;
            a[i] = (p.warm ? p.warm_acceleration : p.smooth_acceleration).data[first_dof + row];
            smooth[i] = p.smooth_force.data[first_dof + row];
        }
        const int width = n;
        const auto fill = [&](float* row, const float* values) {
            for (int i = 0; i < n; ++i) row[i] = values[dof[i]];
        };
"""
    + ROWS_CODE
    + """
        const auto inertia = [&](int i, int j) -> float { return mass[i > j ? at(i, j) : at(j, i)]; };
        const auto times_row = [&](const float* vector, int r) -> float {
            float total = 0.0f;
            for (int i = 0; i < n; ++i) total += jac[r * n + i] * vector[i];
            return total;
        };
        const auto pushed = [&](int i) -> float {
            float total = 0.0f;
            for (int r = 0; r < rows; ++r) total += jac[r * n + i] * f[r];
            return total;
        };
        // Sums of large terms that cancel: in single precision, stiff constraints would have wrong forces.
        const auto distance = [&](int r) -> float {
            double total = -aim[r];
            for (int i = 0; i < n; ++i) total += (double)jac[r * n + i] * ((double)a[i] + rest[i]);
            return (float)total;
        };
        const auto descent = [&](int i) -> float {
            double total = 0.0;
            for (int j = 0; j < n; ++j) total += (double)inertia(i, j) * ((double)a[j] + rest[j]);
            ma[i] = (float)total;
            total = smooth[i] - total;
            for (int r = 0; r < rows; ++r) total += (double)jac[r * n + i] * f[r];
            return (float)total;
        };
        float free_energy = 0.0f;
        for (int i = lane; i < n; i += lanes)
            free_energy += smooth[i] * p.smooth_acceleration.data[first_dof + dof[i]];
        free_energy = max(sum(free_energy), LEAST_ENERGY);
        for (int r = lane; r < rows; r += lanes) x[r] = distance(r);
        wait();
"""
)
"""Native code that reads an island."""

NEWTON_CODE = """
        const int tiles = (n + 1) / 2;
        int iteration = 0, stalls = 0;
        float before = 0.0f;
        bool converged = false;
        for (;; ++iteration) {
            const bool changed = assess();
            wait();
            // However short a step is: one that changes states may leave forces far from their balance.
            if (converged && (++stalls > MOST_STALLS || !(sum(changed ? 1.0f : 0.0f) > 0.0f))) break;
            if (stalls > MOST_STALLS || iteration == MOST_ITERATIONS) break;
            // Hessian, two columns by two rows at a time; its last row is the negative gradient.
            for (int i = lane; i < n; i += lanes) last[i] = descent(i);
            for (int tile = lane; tile < tiles * (tiles + 1) / 2; tile += lanes) {
                // A tile's row by the root of the triangular number, which rounding may put one off.
                int high = (int)((sqrt(8.0f * (float)tile + 1.0f) - 1.0f) * 0.5f);
                while (high * (high + 1) / 2 > tile) --high;
                while ((high + 1) * (high + 2) / 2 <= tile) ++high;
                const int i0 = 2 * high, i1 = min(i0 + 1, n - 1);
                const int j0 = 2 * (tile - high * (high + 1) / 2), j1 = min(j0 + 1, n - 1);
                float h00 = mass[at(i0, j0)], h10 = mass[at(i1, j0)], h11 = mass[at(i1, j1)];
                float h01 = i0 > j0 ? mass[at(i0, j1)] : 0.0f;
                for (int u = 0; u < constraints; ++u) {
                    const int r = begin_of(u), dim = size_of(u);
                    const float* h = hessian + plan[2 * u + 1];
                    if (h[0] == 0.0f) continue;
                    const float* const row = jac + r * n;
                    for (int k = 0; k < dim; ++k) {
                        float w0 = 0.0f, w1 = 0.0f;
                        for (int l = 0; l < dim; ++l) {
                            const float part = l < k ? h[at(k, l)] : h[at(l, k)];
                            w0 += part * row[l * n + j0];
                            w1 += part * row[l * n + j1];
                        }
                        const float p0 = row[k * n + i0], p1 = row[k * n + i1];
                        h00 += p0 * w0;
                        h10 += p1 * w0;
                        h01 += p0 * w1;
                        h11 += p1 * w1;
                    }
                }
                factor[at(i0, j0)] = h00;
                if (i1 > i0) factor[at(i1, j0)] = h10;
                if (j1 > j0 && i0 > j0) factor[at(i0, j1)] = h01;
                if (j1 > j0 && i1 > i0) factor[at(i1, j1)] = h11;
            }
            wait();
            // Cholesky factor below the diagonal, column by column; the last row becomes half the solution.
            float fall = 0.0f;
            for (int k = 0; k < n; ++k) {
                const float* const pivot = factor + at(k, 0);
                float diagonal = pivot[k];
                // Roundings may leave nothing, or less, of a large diagonal.
                const float least = 1e-7f * diagonal;
                for (int j = 0; j < k; ++j) diagonal -= pivot[j] * pivot[j];
                const float scale = 1.0f / sqrt(max(diagonal, least));
                for (int i = k - k % lanes + lane; i <= n; i += lanes) {
                    if (i < k) continue;
                    if (i == k) { inverse[k] = scale; continue; }
                    float* const row = factor + at(i, 0);
                    float value = row[k];
                    for (int j = 0; j < k; ++j) value -= row[j] * pivot[j];
                    row[k] = value * scale;
                }
                wait();
            }
            for (int k = lane; k < n; k += lanes) fall += last[k] * last[k];
            fall = sum(fall);
            for (int k = n - 1; k >= 0; --k) {
                const float value = last[k] * inverse[k];
                for (int i = lane; i < k; i += lanes) last[i] -= factor[at(k, i)] * value;
                if (k % lanes == lane) search[k] = value;
                wait();
            }
            float linear = 0.0f, square = 0.0f, energy = 0.0f;
            for (int i = lane; i < n; i += lanes) {
                ms[i] = 0.0f;
                for (int j = 0; j < n; ++j) ms[i] += inertia(i, j) * search[j];
                linear += search[i] * (ma[i] - smooth[i]);
                square += search[i] * ms[i];
                energy += a[i] * ma[i];
            }
            for (int r = lane; r < rows; r += lanes) v[r] = times_row(search, r);
            linear = sum(linear);
            square = sum(square);
            const float enough = STEP_TOLERANCE * STEP_TOLERANCE * max(sum(energy), free_energy);
            wait();
            float alpha = 1.0f;
            // Near the end, steps that do not shrink are roundings. Numbers that are not finite end it, too.
            converged = !(fall > enough);
            if (!converged && iteration > 0 && fall < NEAR_END * enough && fall > 0.25f * before) ++stalls;
            before = fall;
            if (!converged) {
                float low = 0.0f, high = -1.0f;
                for (int turn = 0; turn < MOST_EVALUATIONS; ++turn) {
                    float first, second;
                    slope(alpha, linear, square, first, second);
                    if (abs(first) <= SLOPE_TOLERANCE * fall) break;
                    if (first < 0.0f) low = alpha; else high = alpha;
                    alpha -= first / second;
                    // A Newton step that leaves the bracket is halved; without an upper end the step doubles.
                    if (high >= 0.0f && !(alpha > low && alpha < high)) alpha = 0.5f * (low + high);
                    else if (!(alpha > low)) alpha = 2.0f * low;
                }
            }
            for (int i = lane; i < n; i += lanes) {
                const double value = (double)a[i] + rest[i] + (double)alpha * search[i];
                a[i] = (float)value;
                rest[i] = (float)(value - a[i]);
                ma[i] += alpha * ms[i];
            }
            wait();
            for (int r = lane; r < rows; r += lanes) x[r] = distance(r);
            wait();
        }
        for (int i = lane; i < n; i += lanes) {
            const size_t target = first_dof + dof[i];
            p.acceleration.data[target] = a[i];
            p.momentum.data[target] = ma[i];
            p.constraint_force.data[target] = pushed(i);
        }
        for (int u = lane; u < constraints; u += lanes) {
            const int from = list[2 * u] & (1 << ROW_BITS) - 1, r = begin_of(u), dim = size_of(u);
            const int row_state = state_of(u);
            for (int j = 0; j < dim; ++j) {
                p.force.data[first_row + from + j] = f[r + j];
                p.state.data[first_weight + from + j] = row_state;
            }
        }
        if (lane == 0) most_of(p.iterations.data + world, iteration);
        wait();
"""
"""Native code of Newton's method and of its results."""

CODE = (
    "    using wp::abs; using wp::max; using wp::min; using wp::sqrt;\n"
    + SIZES_CODE
    + GROUP_CODE
    + """
    const int count = p.counts.data[SIZE_CLASS];
    for (int place_of = group; place_of < count; place_of += groups) {
        const int task = p.tasks.data[(size_t)SIZE_CLASS * worlds * trees + place_of];
"""
    + LOAD_CODE
    + UNIT_CODE
    + NEWTON_CODE
    + "    }\n"
)
"""Native code of an island's lanes."""

KINDS = {"KIND_ONE_SIDED": 0, "KIND_TWO_SIDED": 1, "KIND_FRICTION": 2, "KIND_CONE": 3}
"""Kinds of constraints by the shape of their cost."""
MACROS = {
    **KINDS,
    "ROW_BITS": ROW_BITS,
    "MOST_ITERATIONS": MOST_ITERATIONS,
    "MOST_EVALUATIONS": MOST_EVALUATIONS,
    "STEP_TOLERANCE": f"{STEP_TOLERANCE}f",
    "SLOPE_TOLERANCE": f"{SLOPE_TOLERANCE}f",
    "NEAR_END": "1e4f",
    "MOST_STALLS": 3,
    "LEAST_ENERGY": "1e-6f",
    "TINY": "1e-15f",
}
"""Macros of the native code."""


def most_numbers(dofs: int, rows: int) -> int:
    """Return the most numbers that an island needs, given its world's degrees of freedom and rows."""
    # One constraint of six rows has 21 numbers of its Hessian.
    return rows * (dofs + 6 + 2 + 4) + (dofs + 1) * (dofs + 2) // 2 + dofs * (dofs + 1) // 2 + 8 * dofs
