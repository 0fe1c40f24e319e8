"""Robots in SDF files, as the elements of a URDF file: its reader then makes a robot of them."""

from collections.abc import Iterator
from pathlib import Path

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import flip_angles
from usarmjx.models.files.mjcf_solids import Pose, usarsim_angles
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.robot_source import listed
from usarmjx.models.files.sdf_tree import (
    FREE_TURN,
    WORLD,
    SdfFiles,
    SdfJoint,
    SdfLink,
    SdfModel,
    all_models,
    drive_plugins,
    inverse,
    joint_end,
    joints_of,
    links_of,
)
from usarmjx.models.files.xml_file import NO_POSE, LinedElement

MOVING = {"revolute": "revolute", "hinge": "revolute", "continuous": "continuous", "prismatic": "prismatic"}
"""URDF's types of joints by SDF's; all others but `fixed` are held."""
LINK_CHILDREN = ("pose", "inertial", "collision", "visual", "sensor")
"""Children of links that are read."""


def sdf_as_urdf(path: Path, resources: Resources) -> tuple[LinedElement, list[str]]:
    """Return the robot of an SDF file as a `<robot>` element, and what of the file is left out, in words.

    The robot is the first model with the plugin of a drive, else the only model. A link's frame becomes that
    of the joint that it hangs on, as in URDF.

    Args:
        path: The file.
        resources: Finder of the models and meshes that it names.

    Raises:
        ArenaFileError: An unreadable file, or one with no model or several, none of which drives.
    """
    files = SdfFiles(resources)
    world = files.world(path)
    model = _robot_model(path, world)
    writer = _UrdfWriter(model)
    robot = writer.robot()
    others = [one for one in world.models if one is not model]
    if others:
        names = listed([one.name for one in others])
        writer.notes.append(f"{others[0].place}: beside the robot {model.name!r} is left out: {names}")
    return robot, files.notes + writer.notes


def _robot_model(path: Path, world: SdfModel) -> SdfModel:
    driven = [model for model in world.models if next(drive_plugins(model), None) is not None]
    if driven:
        return driven[0]
    if len(world.models) != 1:
        names = listed([model.name for model in world.models]) or "none"
        raise ArenaFileError(
            f"{path}: a robot's file has one model, or one with the plugin of a drive; it has: {names}"
        )
    return world.models[0]


class _UrdfWriter:
    """Writer of a model's links and joints as URDF's.

    Args:
        model: The model.
    """

    def __init__(self, model: SdfModel) -> None:
        self._model = model
        self.notes: list[str] = []
        self._links = dict(links_of(model, NO_POSE))
        self._short = {path: path.removeprefix(f"{model.path}::") for path in self._links}
        self._joints = [*self._movable()]
        above = {joint.child: joint for joint in self._joints}
        self._frames = {
            path: above[path].frame if path in above else one.pose for path, one in self._links.items()
        }

    def _movable(self) -> Iterator[SdfJoint]:
        """Yield the joints between two links, the first one above each link."""
        seen: set[str] = set()
        for joint in joints_of(self._model, NO_POSE):
            parent, child = (joint_end(joint, end, self._links) for end in ("parent", "child"))
            if joint.element.word("parent") == WORLD:
                self.notes.append(f"{joint.element.place}: joint {joint.name!r} to the world is left out")
            elif parent is None or child is None or child in seen:
                self.notes.append(f"{joint.element.place}: joint {joint.name!r} closes a loop or has no link")
            else:
                seen.add(child)
                yield SdfJoint(joint.name, joint.element, joint.model, joint.top, joint.prefix, parent, child)

    def robot(self) -> LinedElement:
        """Return the `<robot>` element."""
        root = _element("robot", self._model.element, name=self._model.name)
        for path, link in self._links.items():
            root.append(self._link(path, link))
            root.extend([*self._gazebo(path, link)])  # ElementTree hides what a generator raises
        for joint in self._joints:
            root.append(self._joint(joint))
        for model in all_models(self._model):
            for plugin in model.element.all("plugin"):
                gazebo = _element("gazebo", plugin)
                gazebo.append(plugin)
                root.append(gazebo)
        self._note_left_out()
        return root

    def _note_left_out(self) -> None:
        """Note the children of links that robots do not have, a line for each kind."""
        found: dict[str, list[LinedElement]] = {}
        for child in (child for link in self._links.values() for child in link.link.children()):
            if child.tag not in LINK_CHILDREN:
                found.setdefault(child.tag, []).append(child)
        self.notes += [
            f"{some[0].place}: {len(some)} <{tag}> of links left out" for tag, some in found.items()
        ]

    def _local(self, path: str, link: SdfLink, item: LinedElement) -> Pose:
        """Return the pose of something on a link in the link's URDF frame."""
        return inverse(self._frames[path]).then(link.pose).then(link.within(item))

    def _link(self, path: str, link: SdfLink) -> LinedElement:
        made = _element("link", link.link, name=self._short[path])
        inertial = link.link.first("inertial")
        if inertial is not None:
            made.append(self._inertial(path, link, inertial))
        for solid in (*link.link.all("collision"), *link.link.all("visual")):
            own = _element(solid.tag, solid, name=solid.get("name", ""))
            form = self._form(solid)
            if form is None:
                continue
            own.append(_origin(solid, self._local(path, link, solid)))
            geometry = _element("geometry", solid)
            geometry.append(form)
            own.append(geometry)
            made.append(own)
        return made

    def _inertial(self, path: str, link: SdfLink, inertial: LinedElement) -> LinedElement:
        made = _element("inertial", inertial)
        made.append(_origin(inertial, self._local(path, link, inertial)))
        made.append(_element("mass", inertial, value=repr(inertial.number("mass", 1.0))))
        keys = {"ixx": 1.0, "iyy": 1.0, "izz": 1.0, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}
        values = {key: repr(inertial.number(f"inertia/{key}", usual)) for key, usual in keys.items()}
        made.append(_element("inertia", inertial, **values))
        return made

    def _form(self, solid: LinedElement) -> LinedElement | None:
        """Return a solid's geometry as URDF's; None: it has none that robots have."""
        geometry = solid.first("geometry")
        form = None if geometry is None else next(iter(geometry.children()), None)
        if form is None:
            return None
        if form.tag == "box":
            return _element("box", form, size=form.word("size"))
        if form.tag == "sphere":
            return _element("sphere", form, radius=form.word("radius"))
        if form.tag in ("cylinder", "capsule"):
            return _element(form.tag, form, radius=form.word("radius"), length=form.word("length"))
        if form.tag == "mesh":
            return _element("mesh", form, filename=form.word("uri"), scale=form.word("scale", "1 1 1"))
        self.notes.append(
            f"{form.place}: <{solid.tag}> {solid.get('name', '')!r} is a <{form.tag}>: left out"
        )
        return None

    def _joint(self, joint: SdfJoint) -> LinedElement:
        element = joint.element
        kind = element.get("type", "")
        low, high = joint.limits or (0.0, 0.0)
        made_kind = MOVING.get(kind, "fixed" if kind == "fixed" else "floating")
        if made_kind == "revolute" and joint.limits is None:
            made_kind = "continuous"
        made = _element("joint", element, name=joint.name, type=made_kind)
        frame = inverse(self._frames[joint.parent]).then(self._frames[joint.child])
        made.append(_origin(element, frame))
        made.append(_element("parent", element, link=self._short[joint.parent]))
        made.append(_element("child", element, link=self._short[joint.child]))
        if element.first("axis") is None:
            return made
        axis = " ".join(repr(value) for value in (self._frames[joint.child].mat.T @ joint.axis).tolist())
        made.append(_element("axis", element, xyz=axis))
        limits = {"lower": repr(low), "upper": repr(high)}
        for key in ("effort", "velocity"):
            value = element.number(f"axis/limit/{key}", -1.0)
            limits[key] = repr(value if 0 < value < FREE_TURN else 0.0)
        made.append(_element("limit", element, **limits))
        damping, friction = (
            repr(max(element.number(f"axis/dynamics/{key}", 0.0), 0.0)) for key in ("damping", "friction")
        )
        made.append(_element("dynamics", element, damping=damping, friction=friction))
        return made

    def _gazebo(self, path: str, link: SdfLink) -> Iterator[LinedElement]:
        """Yield a link's sensors and friction as URDF's `<gazebo>` elements."""
        for sensor in link.link.all("sensor"):
            made = _element("sensor", sensor, **dict(sensor.attrib))
            made.extend(child for child in sensor.children() if child.tag != "pose")
            made.append(_pose(sensor, self._local(path, link, sensor)))
            yield self._about(path, made)
        friction = link.link.first("collision/surface/friction/ode/mu")
        if friction is not None:
            made = _element("mu1", friction)
            made.text = friction.text
            yield self._about(path, made)

    def _about(self, path: str, child: LinedElement) -> LinedElement:
        made = _element("gazebo", child, reference=self._short[path])
        made.append(child)
        return made


def _element(tag: str, like: LinedElement, **attributes: str) -> LinedElement:
    """Return an element with the place of another one."""
    made = LinedElement(tag, attributes)
    made.path, made.line = like.path, like.line
    return made


def _numbers(pose: Pose) -> tuple[str, str]:
    angles = flip_angles(usarsim_angles(pose.mat))
    return " ".join(map(repr, pose.pos.tolist())), " ".join(map(repr, angles))


def _origin(like: LinedElement, pose: Pose) -> LinedElement:
    xyz, rpy = _numbers(pose)
    return _element("origin", like, xyz=xyz, rpy=rpy)


def _pose(like: LinedElement, pose: Pose) -> LinedElement:
    made = _element("pose", like)
    made.text = " ".join(_numbers(pose))
    return made
