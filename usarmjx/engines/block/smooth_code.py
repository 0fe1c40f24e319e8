"""Native code of smooth dynamics: what MuJoCo computes of the bodies before contacts.

A block of threads handles a chunk of a world: whole subtrees of bodies below the world. It goes through
MuJoCo's stages one after another (kinematics, inertia, velocities, forces), with all between them in shared
memory; on a CPU, one thread does. Vectors of six are rotation first, about the subtree's centre of mass.
"""

CHUNK_NUMBERS = 16
"""Numbers of a chunk: first and last (exclusive) of its bodies, joints, degrees of freedom, geoms, numbers of
the mass matrix, actuators, levels of bodies, and subtrees."""
BODY_NUMBERS = 7
"""Numbers of a body: parent, root, number of joints, first joint, mocap body or -1, number of degrees of
freedom, the first of them."""
JOINT_NUMBERS = 4
"""Numbers of a joint: type, body, first of its coordinates and of its degrees of freedom."""
DOF_NUMBERS = 5
"""Numbers of a degree of freedom: body, coordinate of a hinge or slide or -1, joint, first and last actuator
in `pushing`."""
ACTUATOR_NUMBERS = 10
"""Numbers of an actuator: index, coordinate, degree of freedom, control or -1, whether that is limited,
whether its force is limited, activation or -1, and kinds of dynamics, gain and bias."""

SETUP_CODE = """
#if defined(__CUDA_ARCH__)
#define ROLLED _Pragma("unroll 1")
    __shared__ float memory[CAPACITY];
    const int lane = (int)threadIdx.x;
    constexpr int lanes = THREADS, width = 32;
    const auto wait = []() { __syncthreads(); };
#else
#define ROLLED
    if ((unsigned)index % THREADS != 0) return;
    float memory[CAPACITY];
    constexpr int lane = 0, lanes = 1, width = 1;
    const auto wait = []() {};
#endif
    const int which = (int)((unsigned)index / THREADS), world = which / p.chunks;
    if (world >= p.worlds) return;
    const int* const c = p.chunk.data + (which - world * p.chunks) * CHUNK_NUMBERS;
    const int b0 = c[0], nb = c[1] - b0, j0 = c[2], nj = c[3] - j0, v0 = c[4], nv = c[5] - v0;
    const int g0 = c[6], ng = c[7] - g0, m0 = c[8], nm = c[9] - m0, a0 = c[10], na = c[11] - a0;
    const int slots = nb + 1;  // the first is the world's body
    float* const pos = memory;
    float* const quat = pos + 3 * slots;
    float* const anchor = quat + 4 * slots;
    float* const axis = anchor + 3 * nj;
    float* const speed = axis + 3 * nj;
    float* const acting = speed + nv;
    float* const ipos = acting + na;
    float* const com = ipos + 3 * slots;
    float* const force = com + 3 * slots;
    float* const inertia = force + 6 * slots;
    float* const composite = inertia + 10 * slots;
    float* const cdof = composite + 10 * slots;
    float* const turn = cdof + 6 * nv;
    float* const vel = memory;  // in place of poses, which are read no more then
    float* const outer = composite;  // likewise
    float* const stage = inertia + lane / width * width * 9;  // of a warp, before there are inertias
"""
"""Native code that finds a block's chunk and lays out its memory."""

TOOLS_CODE = """
// Rows of a world: of the model, whose worlds may be alike, and of the data.
#define MODEL(name) ((const float*)((const char*)p.name.data + \\
    (p.name.shape[0] == 1 ? (size_t)0 : (size_t)(world % p.name.shape[0]) * (size_t)p.name.strides[0])))
#define DATA(name) ((float*)((char*)p.name.data + (size_t)world * (size_t)p.name.strides[0]))
    struct Vec { float x, y, z; };
    struct Quat { float w, x, y, z; };
    const auto slot = [&](int body) -> int { return body == 0 ? 0 : body - b0 + 1; };
    const auto vec = [](const float* a) -> Vec { return {a[0], a[1], a[2]}; };
    const auto quat_at = [](const float* a) -> Quat { return {a[0], a[1], a[2], a[3]}; };
    const auto put = [](float* a, Vec v) { a[0] = v.x; a[1] = v.y; a[2] = v.z; };
    const auto add = [](Vec a, Vec b) -> Vec { return {a.x + b.x, a.y + b.y, a.z + b.z}; };
    const auto sub = [](Vec a, Vec b) -> Vec { return {a.x - b.x, a.y - b.y, a.z - b.z}; };
    const auto times = [](Vec a, float s) -> Vec { return {a.x * s, a.y * s, a.z * s}; };
    const auto dot = [](Vec a, Vec b) -> float { return a.x * b.x + a.y * b.y + a.z * b.z; };
    const auto cross = [](Vec a, Vec b) -> Vec {
        return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    };
    const auto mul = [](Quat u, Quat v) -> Quat {
        return {
            u.w * v.w - u.x * v.x - u.y * v.y - u.z * v.z, u.w * v.x + u.x * v.w + u.y * v.z - u.z * v.y,
            u.w * v.y - u.x * v.z + u.y * v.w + u.z * v.x, u.w * v.z + u.x * v.y - u.y * v.x + u.z * v.w};
    };
    const auto unit = [](Quat q) -> Quat {
        const float length = wp::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
        if (length == 0.0f) return {0.0f, 0.0f, 0.0f, 1.0f};  // as Warp has it
        const float scale = 1.0f / length;
        return {q.w * scale, q.x * scale, q.y * scale, q.z * scale};
    };
    const auto rotate = [&](Vec v, Quat q) -> Vec {
        const Vec u = {q.x, q.y, q.z};
        const Vec r = add(times(u, 2.0f * dot(u, v)), times(v, q.w * q.w - dot(u, u)));
        return add(r, times(cross(u, v), 2.0f * q.w));
    };
    const auto matrix = [&](float* m, Quat q) {
        const float ww = q.w * q.w, xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
        const float wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z;
        const float xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z;
        put(m, {ww + xx - yy - zz, 2.0f * (xy - wz), 2.0f * (xz + wy)});
        put(m + 3, {2.0f * (xy + wz), ww - xx + yy - zz, 2.0f * (yz - wx)});
        put(m + 6, {2.0f * (xz - wy), 2.0f * (yz + wx), ww - xx - yy + zz});
    };
    // Products of spatial inertia and motion, and cross products of motions, and of a motion and a force.
    const auto inert = [](float* r, const float* i, const float* v) {
        r[0] = i[0] * v[0] + i[3] * v[1] + i[4] * v[2] - i[8] * v[4] + i[7] * v[5];
        r[1] = i[3] * v[0] + i[1] * v[1] + i[5] * v[2] + i[8] * v[3] - i[6] * v[5];
        r[2] = i[4] * v[0] + i[5] * v[1] + i[2] * v[2] - i[7] * v[3] + i[6] * v[4];
        r[3] = i[8] * v[1] - i[7] * v[2] + i[9] * v[3];
        r[4] = i[6] * v[2] - i[8] * v[0] + i[9] * v[4];
        r[5] = i[7] * v[0] - i[6] * v[1] + i[9] * v[5];
    };
    const auto cross_motion = [&](float* r, const float* u, const float* v) {
        put(r, cross(vec(u), vec(v)));
        put(r + 3, add(cross(vec(u + 3), vec(v)), cross(vec(u), vec(v + 3))));
    };
    const auto cross_force = [&](float* r, const float* v, const float* f) {
        put(r, add(cross(vec(v), vec(f)), cross(vec(v + 3), vec(f + 3))));
        put(r + 3, cross(vec(v), vec(f + 3)));
    };
    const auto dot_six = [](const float* a, const float* b) -> float {
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5];
    };
    const auto copy = [&](float* to, const float* from, int count) {
        ROLLED
        for (int i = lane; i < count; i += lanes) to[i] = from[i];
    };
    // Numbers of the items of a warp, one a lane, to global memory side by side; some may be left out.
    const auto store = [&](float* to, const float* value, int numbers, bool kept) {
#if defined(__CUDA_ARCH__)
        const int mine = lane % 32;
        const unsigned keeping = __ballot_sync(0xffffffffu, kept);
        for (int i = 0; i < numbers; ++i) stage[mine * numbers + i] = value[i];
        __syncwarp();
        for (int i = mine; i < 32 * numbers; i += 32)
            if (keeping >> i / numbers & 1u) to[i] = stage[i];
        __syncwarp();
#else
        if (kept)
            for (int i = 0; i < numbers; ++i) to[i] = value[i];
#endif
    };
    // Sum of the subtrees' numbers, each body's to its parent.
    const auto gather = [&](float* a, int numbers) {
        for (int k = lane; k < (c[15] - c[14]) * numbers; k += lanes) {
            const int* const range = p.subtree.data + 2 * (c[14] + k / numbers);
            const int i = k % numbers;
            ROLLED
            for (int b = range[1] - 1; b > range[0]; --b)
                a[slot(p.body.data[b * BODY_NUMBERS]) * numbers + i] += a[slot(b) * numbers + i];
        }
        wait();
    };
    // Sums along the way from the world to each body.
    const auto spread = [&](float* a) {
        for (int k = lane; k < (c[15] - c[14]) * 6; k += lanes) {
            const int* const range = p.subtree.data + 2 * (c[14] + k / 6);
            const int i = k % 6;
            ROLLED
            for (int b = range[0]; b < range[1]; ++b)
                a[slot(b) * 6 + i] += a[slot(p.body.data[b * BODY_NUMBERS]) * 6 + i];
        }
        wait();
    };
"""
"""Native functions of vectors, and of a block's threads."""

KINEMATICS_CODE = """
    copy(speed, DATA(qvel) + v0, nv);
    if (lane == 0) {
        put(pos, {0.0f, 0.0f, 0.0f});
        quat[0] = 1.0f;
        quat[1] = quat[2] = quat[3] = 0.0f;
    }
    wait();
    // Poses in the parent's frame, then in the world's, a level after another.
    for (int k = lane; k < nb; k += lanes) {
        const int body = b0 + k;
        const int* const row = p.body.data + body * BODY_NUMBERS;
        const float* const qpos = DATA(qpos);
        const bool moved = row[4] >= 0;
        Vec x = vec(moved ? DATA(mocap_pos) + 3 * row[4] : MODEL(body_pos) + 3 * body);
        Quat q = quat_at(moved ? DATA(mocap_quat) + 4 * row[4] : MODEL(body_quat) + 4 * body);
        for (int j = row[3]; j < row[3] + row[2]; ++j) {
            const int type = p.joint.data[j * JOINT_NUMBERS], at = p.joint.data[j * JOINT_NUMBERS + 2];
            const Vec own = vec(MODEL(jnt_pos) + 3 * j), along = vec(MODEL(jnt_axis) + 3 * j);
            Vec hub = add(rotate(own, q), x), way = rotate(along, q);
            if (type == SLIDE) {
                x = add(x, times(way, qpos[at] - MODEL(qpos0)[at]));
            } else if (type == FREE) {
                hub = x = vec(qpos + at);
                way = along;
                q = quat_at(qpos + at + 3);
            } else {
                if (type == BALL) {
                    q = mul(q, unit(quat_at(qpos + at)));
                } else {
                    const float half = 0.5f * (qpos[at] - MODEL(qpos0)[at]), s = wp::sin(half);
                    q = mul(q, {wp::cos(half), along.x * s, along.y * s, along.z * s});
                }
                x = sub(hub, rotate(own, q));  // of an anchor off the body's origin
            }
            put(anchor + 3 * (j - j0), hub);
            put(axis + 3 * (j - j0), way);
        }
        q = unit(q);
        put(pos + 3 * (k + 1), x);
        quat[4 * (k + 1)] = q.w;
        put(quat + 4 * (k + 1) + 1, {q.x, q.y, q.z});
    }
    wait();
    for (int level = c[12] + 1; level < c[13]; ++level) {  // parents of the first are the world
        for (int k = p.level.data[level] + lane; k < p.level.data[level + 1]; k += lanes) {
            const int body = p.order.data[k], i = slot(body), parent = slot(p.body.data[body * BODY_NUMBERS]);
            const Quat base = quat_at(quat + 4 * parent), q = unit(mul(base, quat_at(quat + 4 * i)));
            put(pos + 3 * i, add(rotate(vec(pos + 3 * i), base), vec(pos + 3 * parent)));
            quat[4 * i] = q.w;
            put(quat + 4 * i + 1, {q.x, q.y, q.z});
        }
        wait();
    }
    for (int k = lane; k < nj; k += lanes) {
        const int body = p.joint.data[(j0 + k) * JOINT_NUMBERS + 1];
        const int parent = slot(p.body.data[body * BODY_NUMBERS]);
        const Quat base = quat_at(quat + 4 * parent);
        put(anchor + 3 * k, add(rotate(vec(anchor + 3 * k), base), vec(pos + 3 * parent)));
        put(axis + 3 * k, rotate(vec(axis + 3 * k), base));
    }
    wait();
    copy(DATA(xpos) + 3 * b0, pos + 3, 3 * nb);
    copy(DATA(xquat) + 4 * b0, quat + 4, 4 * nb);
    copy(DATA(xanchor) + 3 * j0, anchor, 3 * nj);
    copy(DATA(xaxis) + 3 * j0, axis, 3 * nj);
    for (int base = lane / width * width; base < nb; base += lanes) {
        const int k = base + lane % width, body = b0 + k, i = k + 1;
        const bool mine = k < nb;
        float m[9], own[9];
        if (mine) {
            const Quat q = quat_at(quat + 4 * i);
            const Vec middle = add(vec(pos + 3 * i), rotate(vec(MODEL(body_ipos) + 3 * body), q));
            put(ipos + 3 * i, middle);
            put(com + 3 * i, times(middle, MODEL(body_mass)[body]));
            matrix(m, q);
            matrix(own, mul(q, quat_at(MODEL(body_iquat) + 4 * body)));
        }
        store(DATA(xmat) + 9 * (b0 + base), m, 9, mine);
        store(DATA(ximat) + 9 * (b0 + base), own, 9, mine);
    }
    for (int base = lane / width * width; base < ng; base += lanes) {
        const int k = base + lane % width, geom = g0 + k;
        const bool mine = k < ng && p.geom.data[2 * geom + 1] != 0;
        float at[3], m[9];
        if (mine) {
            const int i = slot(p.geom.data[2 * geom]);
            const Quat q = quat_at(quat + 4 * i);
            put(at, add(vec(pos + 3 * i), rotate(vec(MODEL(geom_pos) + 3 * geom), q)));
            matrix(m, mul(q, quat_at(MODEL(geom_quat) + 4 * geom)));
        }
        store(DATA(geom_xpos) + 3 * (g0 + base), at, 3, mine);
        store(DATA(geom_xmat) + 9 * (g0 + base), m, 9, mine);
    }
    wait();
    copy(DATA(xipos) + 3 * b0, ipos + 3, 3 * nb);
"""
"""Native code of poses of bodies and geoms."""

INERTIA_CODE = """
    gather(com, 3);
    for (int k = lane; k < nb; k += lanes) {
        const float mass = MODEL(body_subtreemass)[b0 + k];
        if (mass == 0.0f) continue;
        for (int n = 0; n < 3; ++n) com[3 * (k + 1) + n] /= mass;
    }
    wait();
    copy(DATA(subtree_com) + 3 * b0, com + 3, 3 * nb);
    for (int k = lane; k < nb; k += lanes) {
        const int body = b0 + k, i = k + 1;
        float m[9];
        matrix(m, mul(quat_at(quat + 4 * i), quat_at(MODEL(body_iquat) + 4 * body)));
        const Vec d = sub(vec(ipos + 3 * i), vec(com + 3 * slot(p.body.data[body * BODY_NUMBERS + 1])));
        const float* const main = MODEL(body_inertia) + 3 * body;
        const float mass = MODEL(body_mass)[body];
        float r[10];
        const auto part = [&](int a, int b) -> float {
            return m[3 * a] * main[0] * m[3 * b] + m[3 * a + 1] * main[1] * m[3 * b + 1]
                + m[3 * a + 2] * main[2] * m[3 * b + 2];
        };
        r[0] = part(0, 0) + mass * (d.y * d.y + d.z * d.z);
        r[1] = part(1, 1) + mass * (d.x * d.x + d.z * d.z);
        r[2] = part(2, 2) + mass * (d.x * d.x + d.y * d.y);
        r[3] = part(0, 1) - mass * d.x * d.y;
        r[4] = part(0, 2) - mass * d.x * d.z;
        r[5] = part(1, 2) - mass * d.y * d.z;
        put(r + 6, times(d, mass));
        r[9] = mass;
        for (int n = 0; n < 10; ++n) inertia[10 * i + n] = composite[10 * i + n] = r[n];
    }
    for (int k = lane; k < nj; k += lanes) {
        const int* const row = p.joint.data + (j0 + k) * JOINT_NUMBERS;
        const int type = row[0], i = slot(row[1]);
        float* to = cdof + 6 * (row[3] - v0);
        const Vec way = vec(axis + 3 * k);
        const Vec arm = sub(vec(com + 3 * slot(p.body.data[row[1] * BODY_NUMBERS + 1])), vec(anchor + 3 * k));
        if (type == SLIDE) {
            put(to, {0.0f, 0.0f, 0.0f});
            put(to + 3, way);
        } else if (type == HINGE) {
            put(to, way);
            put(to + 3, cross(way, arm));
        } else {
            if (type == FREE) {
                // Translations of a free joint are along the world's axes: three rows of the identity.
                for (int n = 0; n < 18; ++n) to[n] = n == 3 || n == 10 || n == 17 ? 1.0f : 0.0f;
                to += 18;
            }
            float m[9];
            matrix(m, quat_at(quat + 4 * i));
            for (int n = 0; n < 3; ++n) {
                const Vec column = {m[n], m[3 + n], m[6 + n]};
                put(to + 6 * n, column);
                put(to + 6 * n + 3, cross(column, arm));
            }
        }
    }
    wait();
    copy(DATA(cdof) + 6 * v0, cdof, 6 * nv);
    // Each body with all that hangs on it, as the mass matrix needs it (composite rigid bodies).
    gather(composite, 10);
    for (int k = lane; k < nv; k += lanes)
        inert(turn + 6 * k, composite + 10 * slot(p.dof.data[(v0 + k) * DOF_NUMBERS]), cdof + 6 * k);
    wait();
    for (int k = m0 + lane; k < m0 + nm; k += lanes) {
        const int row = p.mass.data[2 * k], column = p.mass.data[2 * k + 1];
        float value = dot_six(cdof + 6 * (column - v0), turn + 6 * (row - v0));
        if (row == column) value += MODEL(dof_armature)[row];
        DATA(M)[k] = value;
    }
    wait();
"""
"""Native code of centres of mass, inertias, axes of motion and the mass matrix."""

VELOCITY_CODE = """
    if (lane == 0) {
        const float* const pull = MODEL(gravity);
        for (int n = 0; n < 6; ++n) {
            vel[n] = 0.0f;
            // The world accelerates against gravity, which gives every body its weight.
            force[n] = n >= 3 && p.weight != 0 ? -pull[n - 3] : 0.0f;
        }
    }
    for (int k = lane; k < nb; k += lanes) {
        const int* const row = p.body.data + (b0 + k) * BODY_NUMBERS;
        float v[6] = {};
        ROLLED
        for (int d = row[6] - v0; d < row[6] - v0 + row[5]; ++d)
            for (int n = 0; n < 6; ++n) v[n] += cdof[6 * d + n] * speed[d];
        for (int n = 0; n < 6; ++n) vel[6 * (k + 1) + n] = v[n];
    }
    wait();
    spread(vel);
    for (int k = lane; k < nb; k += lanes) {
        const int* const row = p.body.data + (b0 + k) * BODY_NUMBERS;
        const int parent = slot(row[0]);
        float v[6], a[6] = {};
        for (int n = 0; n < 6; ++n) v[n] = vel[6 * parent + n];
        ROLLED
        for (int j = row[3]; j < row[3] + row[2]; ++j) {
            const int type = p.joint.data[j * JOINT_NUMBERS];
            int d = p.joint.data[j * JOINT_NUMBERS + 3] - v0;
            if (type == FREE) {
                // Axes of translation do not turn.
                for (int n = 0; n < 18; ++n) turn[6 * d + n] = 0.0f;
                for (int n = 0; n < 3; ++n) v[3 + n] += speed[d + n];
                d += 3;
            }
            const int end = d + (type == FREE || type == BALL ? 3 : 1);  // these turn together
            float sum[6] = {};
            ROLLED
            for (; d < end; ++d) {
                cross_motion(turn + 6 * d, v, cdof + 6 * d);
                for (int n = 0; n < 6; ++n) {
                    a[n] += turn[6 * d + n] * speed[d];
                    sum[n] += cdof[6 * d + n] * speed[d];
                }
            }
            for (int n = 0; n < 6; ++n) v[n] += sum[n];
        }
        for (int n = 0; n < 6; ++n) force[6 * (k + 1) + n] = a[n];
    }
    wait();
    spread(force);
    copy(DATA(cvel) + 6 * b0, vel + 6, 6 * nb);
    copy(DATA(cdof_dot) + 6 * v0, turn, 6 * nv);
    for (int k = lane; k < nb; k += lanes) {
        const int i = k + 1;
        float f[6], g[6];
        inert(f, inertia + 10 * i, vel + 6 * i);
        cross_force(g, vel + 6 * i, f);
        inert(f, inertia + 10 * i, force + 6 * i);
        for (int n = 0; n < 6; ++n) force[6 * i + n] = f[n] + g[n];
        const float* const given = DATA(xfrc_applied) + 6 * (b0 + k);
        const Vec root = vec(com + 3 * slot(p.body.data[(b0 + k) * BODY_NUMBERS + 1]));
        const Vec push = vec(given);
        put(outer + 6 * i, add(vec(given + 3), cross(sub(vec(ipos + 3 * i), root), push)));
        put(outer + 6 * i + 3, push);
    }
"""
"""Native code of velocities, and of the forces that bodies need and get."""

FORCE_CODE = """
    for (int k = lane; k < na; k += lanes) {
        const int* const row = p.actuator.data + (a0 + k) * ACTUATOR_NUMBERS;
        const int id = row[0];
        const float gear = MODEL(actuator_gear)[6 * id];
        const float length = DATA(qpos)[row[1]] * gear, rate = gear * speed[row[2] - v0];
        const float* const gains = MODEL(actuator_gainprm) + 10 * id;
        const float* const biases = MODEL(actuator_biasprm) + 10 * id;
        float drive = 0.0f;
        if (row[3] >= 0) {
            drive = DATA(ctrl)[row[3]];
            if (row[4]) {
                const float* const range = MODEL(actuator_ctrlrange) + 2 * row[3];
                drive = wp::min(wp::max(drive, range[0]), range[1]);
            }
        }
        if (row[6] >= 0) {
            const float act = DATA(act)[row[6]];
            float change = 0.0f;
            if (row[7] == DYN_INTEGRATOR) change = drive;
            if (row[7] == DYN_FILTER || row[7] == DYN_FILTEREXACT)
                change = (drive - act) / wp::max(MODEL(actuator_dynprm)[10 * id], TINY);
            DATA(act_dot)[row[6]] = change;
            drive = act;
        }
        float gain = gains[0], bias = 0.0f;
        if (row[8] == GAIN_AFFINE) gain += gains[1] * length + gains[2] * rate;
        if (row[9] == BIAS_AFFINE) bias = biases[0] + biases[1] * length + biases[2] * rate;
        float push = gain * drive + bias;
        if (row[5]) {
            const float* const range = MODEL(actuator_forcerange) + 2 * id;
            push = wp::min(wp::max(push, range[0]), range[1]);
        }
        DATA(actuator_length)[id] = length;
        DATA(actuator_velocity)[id] = rate;
        DATA(actuator_force)[id] = push;
        acting[k] = gear * push;
    }
    wait();
    gather(force, 6);
    gather(outer, 6);
    for (int k = lane; k < nv; k += lanes) {
        const int d = v0 + k;
        const int* const row = p.dof.data + d * DOF_NUMBERS;
        const int i = slot(row[0]);
        const float* const way = cdof + 6 * k;
        const float bias = dot_six(way, force + 6 * i), outside = dot_six(way, outer + 6 * i);
        const float v = speed[k], size = v < 0.0f ? -v : v;
        float passive = 0.0f, driven = 0.0f;
        if (row[1] >= 0 && p.springs != 0) {
            const float* const poly = MODEL(jnt_stiffnesspoly) + 2 * row[2];
            const float off = DATA(qpos)[row[1]] - MODEL(qpos_spring)[row[1]];
            passive -= off * (MODEL(jnt_stiffness)[row[2]] + poly[0] * off + poly[1] * off * off);
        }
        if (p.dampers != 0) {
            const float* const poly = MODEL(dof_dampingpoly) + 2 * d;
            passive -= v * (MODEL(dof_damping)[d] + poly[0] * size + poly[1] * size * size);
        }
        for (int n = row[3]; n < row[4]; ++n) driven += acting[p.pushing.data[n]];
        if (p.limited.data[row[2]]) {
            const float* const range = MODEL(jnt_actfrcrange) + 2 * row[2];
            driven = wp::min(wp::max(driven, range[0]), range[1]);
        }
        DATA(qfrc_bias)[d] = bias;
        DATA(qfrc_passive)[d] = passive;
        DATA(qfrc_actuator)[d] = driven;
        DATA(qfrc_smooth)[d] = passive - bias + driven + DATA(qfrc_applied)[d] + outside;
    }
#undef MODEL
#undef DATA
#undef ROLLED
"""
"""Native code of generalized forces."""

CODE = SETUP_CODE + TOOLS_CODE + KINEMATICS_CODE + INERTIA_CODE + VELOCITY_CODE + FORCE_CODE
"""Native code of the kernel."""
