"""The bodies of a robot's file, sorted by the part that they belong to."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.models.compile.geoms import Inertia, combine_inertias, described_inertia
from usarmjx.models.files.mesh_solids import hull_mesh, round_about
from usarmjx.models.files.mjcf_solids import (
    KINDS,
    Pose,
    agrees,
    geom_inertia,
    shape_of,
    usarsim_angles,
    usarsim_vector,
    volume,
)
from usarmjx.models.files.robot_source import place_of
from usarmjx.models.types.robot import CHASSIS, BodyInertia, Motor, Part, Spring
from usarmjx.models.types.shapes import Shape

NO_STIFFNESS = 1e-9
"""Stiffness of a joint that has a damper alone: our springs need some [N m/rad]."""
AXIS_TOLERANCE = 1e-6
"""Largest difference of an axis' length from 1: MuJoCo makes nothing of one that is infinite."""
UNBOUNDED_TURN = 4 * np.pi
"""Range of a hinge from which on it is taken for a wheel's [rad]."""
MASSLESS = BodyInertia(mass=1e-9, at=(0.0, 0.0, 0.0), moments=(1e-12, 1e-12, 1e-12, 0.0, 0.0, 0.0))
"""Inertia of a part between two joints of a body: MuJoCo needs some."""
MESH = mujoco.mjtGeom.mjGEOM_MESH
PartSolids = tuple[tuple[Shape, ...], BodyInertia | None]
"""Solids of a part; and its inertia, where the solids' masses do not account for it."""


class BodyTree:
    """A compiled file, its bodies sorted by the part that they belong to.

    Args:
        model: The file.
        spec: Its description, for densities.
        root: The chassis' body id.
        path: The file, for messages.
        slippery: Bodies whose solids slide like casters.

    Attributes:
        owners: Numbers of chassis and parts, parents first. A part has its body's number; of a body with
            several joints that is the part of the last one, and the others have numbers above all bodies'.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        spec: mujoco.MjSpec,
        root: int,
        path: Path,
        slippery: frozenset[str] = frozenset(),
    ) -> None:
        self.model, self._path = model, path
        self._slippery = slippery
        touching = (model.geom_contype | model.geom_conaffinity) > 0
        self._has_contacts = bool(np.any(touching & (model.geom_bodyid > 0)))
        self._described = {geom.id: geom for geom in spec.geoms}
        self._joint_info = {joint.id: joint.info for joint in spec.joints}
        self._owner = {root: root}
        self._frame = {root: Pose(np.zeros(3), np.eye(3))}  # of a body in the axes of its part
        self._joint: dict[int, int] = {}
        self._above: dict[int, tuple[int, Pose]] = {}  # the part that holds a part, and its pose there
        for body in range(root + 1, model.nbody):
            self._enter(body)
        self.owners = [root, *self._joint]

    def _enter(self, body: int) -> None:
        model, parent = self.model, int(self.model.body_parentid[body])
        if parent not in self._owner:
            return  # under the world beside the chassis
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        allowed = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        held = [joint for joint in joints if model.jnt_type[joint] not in allowed]
        if held:
            names = ", ".join(model.joint(joint).name or f"number {joint}" for joint in held)
            kind = mujoco.mjtJoint(model.jnt_type[held[0]]).name[6:].lower()
            raise SpecError(
                f"{self._place(held[0])}: body {model.body(body).name!r} has the joint {names}, which is of "
                f"kind {kind}; parts have hinges and slides"
            )
        holder = self._owner[parent]
        pose = self._frame[parent].compose(model.body_pos[body], model.body_quat[body])
        if not joints:
            self._owner[body], self._frame[body] = holder, pose
            return
        # MuJoCo turns a body about its first joint first: it holds the second one, and so on.
        for joint in joints:
            if not abs(float(np.linalg.norm(model.jnt_axis[joint])) - 1) < AXIS_TOLERANCE:
                raise SpecError(f"{self._place(joint)}: joint {model.joint(joint).name!r} has no axis")
            anchor = Pose(model.jnt_pos[joint], np.eye(3))
            part = body if joint == joints[-1] else model.nbody + joint
            self._joint[part] = joint
            self._above[part] = holder, pose.then(anchor)
            holder, pose = part, Pose(-model.jnt_pos[joint], np.eye(3))
        self._owner[body], self._frame[body] = body, pose

    def _place(self, joint: int) -> str:
        """Return file and line of a joint."""
        return place_of(self._path, self._joint_info[joint])

    def _members(self, owner: int) -> list[int]:
        return [body for body, mine in self._owner.items() if mine == owner]

    def name(self, owner: int) -> str:
        """Return the name of a part: its joint's, else its body's."""
        model = self.model
        if self.owners[0] == owner:
            return CHASSIS
        joint = self._joint[owner]
        body = int(model.jnt_bodyid[joint])
        name = model.joint(joint).name or (model.body(body).name if owner == body else "")
        if not name:
            raise SpecError(f"{self._place(joint)}: a joint of body number {body} has no name: give it one")
        return name

    def joint_of(self, owner: int) -> int:
        """Return the joint of a part's body."""
        return self._joint[owner]

    def holder_of(self, owner: int) -> int:
        """Return the part that holds a part."""
        return self._above[owner][0]

    def axis(self, owner: int) -> np.ndarray:
        """Return the axis of a part's joint in USARSim's axes of the part (3,)."""
        return np.array(usarsim_vector(self.model.jnt_axis[self._joint[owner]]))

    def is_limited(self, owner: int) -> bool:
        """Return whether the joint of a part has a lowest and a highest position, however far apart."""
        return bool(self.model.jnt_limited[self._joint[owner]])

    def turns_freely(self, owner: int) -> bool:
        """Return whether the joint of a part is a hinge that turns without end."""
        joint = self.joint_of(owner)
        if int(self.model.jnt_type[joint]) != int(mujoco.mjtJoint.mjJNT_HINGE):
            return False
        return not self.model.jnt_limited[joint] or np.ptp(self.model.jnt_range[joint]) >= UNBOUNDED_TURN

    def touching_geoms(self, owner: int) -> list[int]:
        """Return the geoms of a part that are more than looks."""
        return [geom for geom, _ in self._geoms(owner) if not self._only_looks(geom)]

    def locate(self, body: int) -> tuple[str, Pose] | None:
        """Return the part that a body belongs to, and the body's pose in it; None: to no part."""
        if body not in self._owner:
            return None
        return self.name(self._owner[body]), self._frame[body]

    def part(self, owner: int, motor: Motor | None, rolling: set[str]) -> Part:
        """Return the part of a body with a joint."""
        model, joint = self.model, self.joint_of(owner)
        name, (holder, at) = self.name(owner), self._above[owner]
        limits = None
        if model.jnt_limited[joint]:
            low, high = (model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]).tolist()
            limits = (low, high)
        hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        shapes, inertia = self.solids(owner, "wheel" if name in rolling else "hull")
        return Part(
            name=name,
            parent=self.name(holder),
            at=usarsim_vector(at.pos),
            rotation=usarsim_angles(at.mat),
            axis=usarsim_vector(model.jnt_axis[joint]),
            joint="hinge" if hinge else "slide",
            motor=motor,
            limits=limits,
            spring=self._spring(joint, driven=motor is not None),
            shapes=shapes,
            inertia=inertia,
            looks=self.looks(owner),
            is_wheel=name in rolling and motor is not None,
        )

    def _spring(self, joint: int, *, driven: bool) -> Spring | None:
        """Return a joint's spring and damper; without a spring the damper is part of the motor."""
        model, qposadr = self.model, self.model.jnt_qposadr[joint]
        stiffness = float(np.ravel(model.jnt_stiffness[joint])[0])
        damping = float(np.ravel(model.dof_damping[model.jnt_dofadr[joint]])[0])
        if stiffness == 0 and (damping == 0 or driven):
            return None
        rest = float(model.qpos_spring[qposadr] - model.qpos0[qposadr])
        return Spring(
            stiffness=stiffness or NO_STIFFNESS, damping=damping, load=-rest * (stiffness or NO_STIFFNESS)
        )

    def solids(self, owner: int, surface: str) -> PartSolids:
        """Return the solids of a part, with masses if these account for its inertia; else its inertia too.

        Raises:
            SpecError: A geom of a kind that robots cannot have, or a part without mass.
        """
        model = self.model
        if owner >= model.nbody:
            return (), MASSLESS
        whole = combine_inertias([self._inertia(body) for body in self._members(owner)])
        if whole.mass <= 0:
            named = "the chassis" if owner == self.owners[0] else self.name(owner)
            raise SpecError(f"{named} has no mass: give its body an inertial or its geoms a density")
        geoms = [pair for pair in self._geoms(owner) if not self._only_looks(pair[0])]
        light = [self._shape(owner, geom, frame, surface) for geom, frame in geoms]
        if all(mujoco.mjtGeom(model.geom_type[geom]) in KINDS for geom, _ in self._geoms(owner)):
            masses = [self._mass(geom) for geom, _ in geoms]
            own = [geom_inertia(model, *geom, mass) for geom, mass in zip(geoms, masses, strict=True)]
            if own and agrees(combine_inertias(own), whole):
                return tuple(replace(s, mass=mass) for s, mass in zip(light, masses, strict=True)), None
        return tuple(light), described_inertia(whole)

    def looks(self, owner: int) -> tuple[Shape, ...]:
        """Return the visuals of a part: its meshes without contacts; empty if it has none."""
        found = [
            self._shape(owner, geom, frame, "fixture")
            for geom, frame in self._geoms(owner)
            if self._only_looks(geom)
        ]
        return tuple(replace(shape, rgba=(*shape.rgba[:3], 1.0)) for shape in found)

    def _geoms(self, owner: int) -> list[tuple[int, Pose]]:
        """Return the geoms of a part, with the pose of each one's body in it."""
        first, count = self.model.body_geomadr, self.model.body_geomnum
        return [
            (geom, self._frame[body])
            for body in self._members(owner)
            for geom in range(first[body], first[body] + count[body])
        ]

    def grip(self, owner: int) -> bool:
        """Let the solids of a part grip the ground as wheels do; return whether they slid."""
        model = self.model
        slid = {model.body(body).name for body in self._members(owner)} & self._slippery
        self._slippery -= slid
        return bool(slid)

    def _only_looks(self, geom: int) -> bool:
        """Return whether a geom is a mesh for pictures, in a file whose other geoms collide."""
        model = self.model
        touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        return self._has_contacts and not touches and model.geom_type[geom] == MESH

    def _surface(self, geom: int, usual: str) -> str:
        """Return the surface of a geom."""
        model = self.model
        if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            return "fixture"
        return "caster" if model.body(model.geom_bodyid[geom]).name in self._slippery else usual

    def _shape(self, owner: int, geom: int, frame: Pose, surface: str) -> Shape:
        """Return a geom as a solid without mass: a mesh as its hull, or as a cylinder if it rolls."""
        model = self.model
        if model.geom_type[geom] != MESH:
            return shape_of(model, geom, frame, self._surface(geom, surface), 0.0)
        placed = frame.compose(model.geom_pos[geom], model.geom_quat[geom])
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        corners = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])].astype(float)
        red, green, blue, alpha = model.geom_rgba[geom].tolist()
        like = Shape(kind="mesh", surface=self._surface(geom, surface), rgba=(red, green, blue, alpha))
        if owner != self.owners[0] and self.turns_freely(owner):
            axis = np.array(model.jnt_axis[self.joint_of(owner)])
            drum = round_about(corners @ placed.mat.T + placed.pos, axis, np.zeros(3))
            if drum is not None:
                radius, half, middle = drum
                return replace(
                    like,
                    kind="cylinder",
                    size=(radius, half),
                    at=usarsim_vector(middle),
                    rotation=usarsim_angles(frame_along(axis)),
                )
        # Corners are in MuJoCo's axes, as those of all meshes; the shape's rotation brings them into ours.
        return replace(
            like,
            mesh=hull_mesh(np.ascontiguousarray(corners).tobytes()),
            at=usarsim_vector(placed.pos),
            rotation=usarsim_angles(placed.mat),
        )

    def _mass(self, geom: int) -> float:
        """Return the mass that a geom would contribute to its body."""
        described = self._described[geom]
        if np.isfinite(described.mass):
            return float(described.mass)
        return described.density * volume(self.model, geom)

    def _inertia(self, body: int) -> Inertia:
        model, frame = self.model, self._frame[body]
        placed = frame.compose(model.body_ipos[body], model.body_iquat[body])
        tensor = placed.mat @ np.diag(model.body_inertia[body]) @ placed.mat.T
        return Inertia(float(model.body_mass[body]), placed.pos, tensor)


def frame_along(axis: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) whose z axis is the given unit vector (3,)."""
    axis = np.asarray(axis, float)
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], -1)
