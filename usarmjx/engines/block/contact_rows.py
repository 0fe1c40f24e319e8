"""Constraint rows of contacts beside solver `block`: one kernel in place of two of MuJoCo Warp's.

A thread handles a contact with an elliptic cone: it goes once along the degrees of freedom of both bodies,
for all rows of the contact, and then writes what the solver needs of each row. MuJoCo Warp has a thread for
each row, and two launches. Its own kernels take all other kinds of contacts.
"""

from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import warp as wp

from usarmjx.base.warp_functions import with_globals

_WARP: Any = wp  # more of it than it says of its types
wp.set_module_options({"enable_backward": False, "fast_math": False})

CONSTRAINT = "mujoco.mjx.third_party.mujoco_warp._src.constraint"
"""Private; the version of MJX is pinned."""
ALONE = True
"""Whether this kernel is used where it can be; to be compared."""
MOST_DIMENSIONS = 3
"""Most rows of a contact: rolling and spinning friction are left to MuJoCo Warp."""


@cache
def row_function() -> Any:  # noqa: ANN401 - Warp's functions have no type
    """Return the function that writes what the solver needs of a row, besides its Jacobian."""
    constraint = import_module(CONSTRAINT)
    row, impedance, vec5 = constraint._efc_row, constraint._contact_kbimp, constraint.types.vec5
    frictionless = int(constraint.ConstraintType.CONTACT_FRICTIONLESS)
    elliptic = int(constraint.ConstraintType.CONTACT_ELLIPTIC)

    # fmt: off
    def write_row(  # noqa: PLR0913 - its arguments are a kernel's buffers
        flags: int, world: int, con: int, efc: int, i: int, dim: int,
        step: float, scale: float, weight: float,
        pos: float, margin: float, speed: float, solref: wp.vec2, solreffriction: wp.vec2,
        friction: Any, solimp: Any,  # noqa: ANN401
        type_out: wp.array2d[int], id_out: wp.array2d[int], pos_out: wp.array2d[float],
        margin_out: wp.array2d[float], weight_out: wp.array2d[float], vel_out: wp.array2d[float],
        aref_out: wp.array2d[float], frictionloss_out: wp.array2d[float],
    ) -> None:
        # fmt: on
        row(
            flags, world, step, efc, wp.where(i > 0, 0.0, pos), pos, weight, solref, solimp, margin, speed,
            0.0, wp.where(dim == 1, frictionless, elliptic), con, False, 0.0, type_out, id_out, pos_out,
            margin_out, weight_out, vel_out, aref_out, frictionloss_out,
        )
        if i > 0:
            own = solreffriction[0] != 0.0 or solreffriction[1] != 0.0
            # Friction rows have their weights scaled by `impratio`, as in MuJoCo's mj_makeImpedance.
            ratio = scale * scale
            if i > 1:
                ratio = ratio * friction[0] * friction[0] / (friction[1] * friction[1])
            weight_out[world, efc] /= ratio
            reference = wp.vec2(
                wp.where(own, solreffriction[0], solref[0]), wp.where(own, solreffriction[1], solref[1])
            )
            aref_out[world, efc] = -impedance(flags, step, reference, solimp, pos, False)[1] * speed

    write_row.__annotations__ |= {"friction": vec5, "solimp": vec5}
    return wp.func(write_row)


@wp.func
def place_of(
    address: wp.array2d[int], starts: wp.array2d[int], world: int, con: int, i: int, dim: int
) -> int:
    """Return where the numbers of a contact's row begin in the Jacobian; -1: it has no such row."""
    if i >= dim or address[con, i] < 0:
        return -1
    return starts[world, address[con, i]]


@cache
def rows_kernel() -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel."""
    constraint, write_row = import_module(CONSTRAINT), row_function()
    vec5, counts = constraint.types.vec5, int(constraint.ContactType.CONSTRAINT)

    # fmt: off
    def contact_rows(  # noqa: PLR0913 - as above
        timestep: wp.array[float], flags: int, impratio: wp.array[float], weights: wp.array2d[wp.vec2],
        geom_body: wp.array[int], weld: wp.array[int], root: wp.array[int], dof_count: wp.array[int],
        dof_first: wp.array[int], dof_parent: wp.array[int], ancestor: wp.array2d[int],
        qvel: wp.array2d[float], com: wp.array2d[wp.vec3], cdof: wp.array2d[wp.spatial_vector],
        address: wp.array2d[int], sizes: wp.array2d[int], starts: wp.array2d[int], count: wp.array[int],
        dist: wp.array[float], dims: wp.array[int], margin: wp.array[float], worlds: wp.array[int],
        geoms: wp.array[wp.vec2i], position: wp.array[wp.vec3], frame: wp.array[wp.mat33],
        friction: Any, solref: wp.array[wp.vec2], solreffriction: wp.array[wp.vec2], solimp: Any,  # noqa: ANN401
        kind: wp.array[int], columns_out: wp.array3d[int], jacobian_out: wp.array3d[float],
        jqvel_out: wp.array2d[float], type_out: wp.array2d[int], id_out: wp.array2d[int],
        pos_out: wp.array2d[float], margin_out: wp.array2d[float], weight_out: wp.array2d[float],
        vel_out: wp.array2d[float], aref_out: wp.array2d[float], frictionloss_out: wp.array2d[float],
    ) -> None:
        con = wp.tid()
        if con >= count[0] or address[con, 0] < 0:  # the launch covers the whole buffer
            return
        world, dim, pair = worlds[con], dims[con], geoms[con]
        one, other = weld[geom_body[pair[0]]], weld[geom_body[pair[1]]]
        first, second = dof_first[one] + dof_count[one] - 1, dof_first[other] + dof_count[other] - 1
        arm_one, arm_other = position[con] - com[world, root[one]], position[con] - com[world, root[other]]
        speeds, places = wp.vec3(0.0, 0.0, 0.0), wp.vec3i(-1, -1, -1)
        basis = _WARP.mat33(frame[con])  # once: a compiler cannot know that the loop's writes leave it alone
        for i in range(3):
            places[i] = place_of(address, starts, world, con, i, dim)
        for k in range(sizes[world, address[con, 0]]):
            dof = wp.max(first, second)  # so a joint of both chains comes up once
            turn, shift = wp.spatial_top(cdof[world, dof]), wp.spatial_bottom(cdof[world, dof])
            jump = float(ancestor[other, dof]) * (shift + wp.cross(turn, arm_other))
            jump -= float(ancestor[one, dof]) * (shift + wp.cross(turn, arm_one))
            parts = basis * jump
            speeds += qvel[world, dof] * parts
            for i in range(3):
                if places[i] >= 0:
                    columns_out[world, 0, places[i] + k] = dof
                    jacobian_out[world, 0, places[i] + k] = parts[i]
            first = wp.where(first == dof, dof_parent[wp.max(first, 0)], first)
            second = wp.where(second == dof, dof_parent[wp.max(second, 0)], second)
        of_body = world % weights.shape[0]
        weight = weights[of_body, geom_body[pair[0]]][0] + weights[of_body, geom_body[pair[1]]][0]
        step, scale = timestep[world % timestep.shape[0]], impratio[world % impratio.shape[0]]
        for i in range(wp.min(dim, 3)):  # no constant: the code of a row is long, and here once
            if address[con, i] >= 0:
                jqvel_out[world, address[con, i]] = speeds[i]
                if (kind[con] & counts) != 0:
                    write_row(
                        flags, world, con, address[con, i], i, dim, step, scale, weight,
                        dist[con] - margin[con], margin[con], speeds[i],
                        solref[con], solreffriction[con], friction[con], solimp[con],
                        type_out, id_out, pos_out, margin_out, weight_out, vel_out, aref_out,
                        frictionloss_out)
    # fmt: on
    contact_rows.__annotations__ |= {"friction": (five := _WARP.array(dtype=vec5)), "solimp": five}
    return _WARP.kernel(contact_rows, enable_backward=False, grid_stride=False, module="unique")


def covers(m: Any) -> bool:  # noqa: ANN401 - MuJoCo Warp's
    """Return whether the kernel takes all contacts of a model."""
    cones = import_module(CONSTRAINT).types.ConeType
    plain = not (m.nflex or m.flg_adhesion or m.flg_surfacevel)
    return (
        ALONE and plain and m.is_sparse and m.opt.cone == cones.ELLIPTIC and m.nmaxcondim <= MOST_DIMENSIONS
    )


def launch_rows(m: Any, d: Any) -> None:  # noqa: ANN401
    """Launch the kernel for all contacts, whose rows have places already."""
    efc, contact = d.efc, d.contact
    bodies = [m.body_invweight0, m.geom_bodyid, m.body_weldid, m.body_rootid, m.body_dofnum, m.body_dofadr]
    dofs = [m.dof_parentid, m.body_isdofancestor, d.qvel, d.subtree_com, d.cdof]
    rows = [contact.efc_address, efc.J_rownnz, efc.J_rowadr, d.nacon]
    places = [contact.dist, contact.dim, contact.includemargin, contact.worldid, contact.geom, contact.pos]
    rest = [
        contact.frame,
        contact.friction,
        contact.solref,
        contact.solreffriction,
        contact.solimp,
        contact.type,
    ]
    inputs = [
        m.opt.timestep,
        m.opt.disableflags,
        m.opt.impratio_invsqrt,
        *bodies,
        *dofs,
        *rows,
        *places,
        *rest,
    ]
    jacobian = [efc.J_colind, efc.J, efc.Jqvel]
    outputs = [efc.type, efc.id, efc.pos, efc.margin, efc.D, efc.vel, efc.aref, efc.frictionloss]
    wp.launch(rows_kernel(), dim=d.naconmax, inputs=inputs, outputs=[*jacobian, *outputs])


def make_constraint(m: Any, d: Any) -> None:  # noqa: ANN401
    """List the constraint rows of all worlds as MuJoCo Warp's function of that name does."""
    constraint = import_module(CONSTRAINT)
    make = constraint.make_constraint.__wrapped__
    if covers(m):
        jacobian = constraint._efc_contact_jac_sparse(m.opt.cone)
        update = constraint._efc_contact_update(m.opt.cone, m.flg_adhesion, False)

        def launch(kernel: object, *args: object, **kwargs: object) -> None:
            # One kernel takes the place of two: Jacobian and update are launched where the update would be.
            if kernel is update:
                launch_rows(m, d)
            elif kernel is not jacobian:
                wp.launch(kernel, *args, **kwargs)

        make = with_globals(make, wp=SimpleNamespace(**vars(wp) | {"launch": launch}))
    make(m, d)
