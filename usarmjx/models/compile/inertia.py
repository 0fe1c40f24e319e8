"""Mass and inertia of bodies: those that a description states, combined with those of further solids."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import flip_vector
from usarmjx.models.compile.geoms import add_geom
from usarmjx.models.types.robot import BodyInertia
from usarmjx.models.types.shapes import Shape

BALANCE = 1.0 - 1e-9
"""Ratio of the largest moment to the sum of the others up to which MuJoCo surely accepts them."""


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass [kg], its centre [m] (3,), and inertia about that centre [kg m2] (3, 3), MuJoCo's axes."""

    mass: float
    centre: np.ndarray
    tensor: np.ndarray


def combine_inertias(parts: Sequence[Inertia]) -> Inertia:
    """Return the inertia of several rigidly joined bodies."""
    mass = sum(part.mass for part in parts)
    if mass <= 0:
        return Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
    centre = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for part in parts:
        arm = part.centre - centre
        tensor += part.tensor + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertia(mass, centre, tensor)


def stated_inertia(stated: BodyInertia) -> Inertia:
    """Return a description's inertia in MuJoCo's axes."""
    xx, yy, zz, xy, xz, yz = stated.moments
    # The axes differ by half a turn about x: products of x with y or z change their sign.
    tensor = np.array([[xx, -xy, -xz], [-xy, yy, yz], [-xz, yz, zz]])
    return Inertia(stated.mass, np.array(flip_vector(stated.at)), tensor)


def described_inertia(found: Inertia) -> BodyInertia:
    """Return an inertia in MuJoCo's axes as a description's."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (np.asarray(found.tensor) + 0.0).tolist()
    x, y, z = flip_vector(tuple((np.asarray(found.centre) + 0.0).tolist()))
    return BodyInertia(mass=float(found.mass), at=(x, y, z), moments=(xx, yy, zz, -xy, -xz, yz))


def arena_inertia(stated: BodyInertia) -> Inertia:
    """Return the inertia of a loose object, whose description has MuJoCo's axes."""
    xx, yy, zz, xy, xz, yz = stated.moments
    return Inertia(stated.mass, np.array(stated.at), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def described_in_arena(found: Inertia) -> BodyInertia:
    """Return an inertia as that of a loose object's description."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (np.asarray(found.tensor) + 0.0).tolist()
    x, y, z = (np.asarray(found.centre) + 0.0).tolist()
    return BodyInertia(mass=float(found.mass), at=(x, y, z), moments=(xx, yy, zz, xy, xz, yz))


def set_inertia(body: mujoco.MjsBody, stated: Inertia, shapes: Sequence[Shape]) -> None:
    """Give a body its stated inertia, and that of the solids that have a mass of their own.

    Args:
        body: The body.
        stated: Its inertia.
        shapes: Its solids, MuJoCo's axes.

    Raises:
        SpecError: It is not finite, as that of masses too far apart.
    """
    heavy = [shape for shape in shapes if shape.mass > 0]
    whole = combine_inertias([stated, *([_inertia_of_solids(heavy)] if heavy else [])])
    if not np.isfinite(whole.tensor).all():
        raise SpecError(f"the inertia of {body.name} is not finite: masses and distances are too large")
    moments, axes = np.linalg.eigh(whole.tensor)
    # eigh may return a left-handed frame, which is no rotation.
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    moments[2] = min(moments[2], (moments[0] + moments[1]) / BALANCE)
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.inertia = whole.mass, whole.centre, quat, moments


def _inertia_of_solids(shapes: Sequence[Shape]) -> Inertia:
    """Return the inertia of solids that have masses, by MuJoCo."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_freejoint()
    for i, shape in enumerate(shapes):
        add_geom(spec, body, str(i), replace(shape, material="opaque"))
    model = spec.compile()
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    axes = turn.reshape(3, 3)
    return Inertia(
        float(model.body_mass[1]), model.body_ipos[1].copy(), axes @ np.diag(model.body_inertia[1]) @ axes.T
    )
