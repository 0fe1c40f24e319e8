"""Models, links, joints and frames of SDF files: includes, drives, and poses relative to any frame.

A robot's are also written as the elements of a URDF file, whose reader then makes a robot of them.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import flip_angles
from usarmjx.models.files.gazebo_sensors import DRIVE_PLUGINS
from usarmjx.models.files.mjcf_solids import Pose, mat_of, usarsim_angles
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.robot_source import listed
from usarmjx.models.files.xml_file import NO_POSE, LinedElement, numbers_of, pose_of, read_lined_xml

MAX_SDF_ELEMENTS = 200_000
"""Largest number of elements of a world, those of included models as often as they are included."""
MAX_SDF_DEPTH = 20
"""Largest depth of models in models, and of includes."""
MAX_FRAMES = 100
"""Largest number of frames from one to the model's own."""
SDF_ROOTS = ("sdf", "gazebo")
"""Tags of the root: SDF's, and that of Gazebo's first versions."""
WORLD = "world"
"""Name of the world's frame."""
MODEL_FRAME = "__model__"
"""Name of a model's own frame."""
REMOTE = re.compile(r"https?://[^/]+/(?:[^/]+/)*models/([^/]+)(?:/\d+|/tip)?(?:/files/(.*))?$")
"""Address of a model on a server: its name, and a file of it."""
FREE_TURN = 1e15
"""Limit of a joint from which it has none [rad or m]."""
MOVE_PLUGINS = ("planarmove", "multicoptermotor", "omnidrive", "trackedvehicle", "velocitycontrol")
"""Words in the names of plugins that move a robot otherwise."""


def inverse(pose: Pose) -> Pose:
    """Return the inverse of a pose."""
    return Pose(-pose.mat.T @ pose.pos, pose.mat.T)


def read_pose(element: LinedElement | None) -> Pose:
    """Return the pose of a `<pose>` element: angles in radians or degrees, or a quaternion x, y, z, w.

    Raises:
        ArenaFileError: It has other numbers; names file and line.
    """
    if element is None or not (element.text or "").strip():
        return NO_POSE
    words = (element.text or "").split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        # Refused below, with poses of another length.
        numbers = np.array([np.nan])
    is_quat = element.get("rotation_format", "") == "quat_xyzw"
    if len(numbers) != (7 if is_quat else 6) or not np.isfinite(numbers).all():
        wanted = "7 numbers, x y z qx qy qz qw" if is_quat else "6 numbers, x y z roll pitch yaw"
        raise element.error(f"<pose> has {(element.text or '')[:60]!r}, expected {wanted}")
    if is_quat:
        # SDF has w last, MuJoCo and `mat_of` have it first.
        x, y, z, w = numbers[3:]
        if np.linalg.norm(numbers[3:]) < 1e-9:
            raise element.error("<pose> has a quaternion of length 0")
        return Pose(numbers[:3], mat_of(np.array([w, x, y, z]) / np.linalg.norm(numbers[3:])))
    if element.get("degrees", "").strip().lower() in ("true", "1"):
        numbers[3:] = np.radians(numbers[3:])
    return pose_of(numbers)


@dataclass(eq=False)
class SdfModel:
    """A model, its includes resolved.

    Attributes:
        element: Its `<model>` element, or the `<world>`.
        name: Its name.
        path: Names of the models that hold it, and its own, joined by `::`.
        pose: Its pose element: its own, or that of the include.
        placement: Frame of the model that the pose places; empty: its own.
        static: Whether it never moves; None: neither it nor its include says so.
        place: File and line that put it there.
        models: Models in it.
    """

    element: LinedElement
    name: str
    path: str
    pose: LinedElement | None
    placement: str
    static: bool | None
    place: str
    models: "list[SdfModel]" = field(default_factory=list["SdfModel"])

    @cached_property
    def _entities(self) -> dict[str, LinedElement]:
        kinds = ("link", "joint", "frame")
        # Reversed: of two of one name the first one in the file counts.
        return {one.get("name", ""): one for kind in kinds for one in reversed(self.element.all(kind))}

    @cached_property
    def _inner(self) -> "dict[str, SdfModel]":
        return {model.name: model for model in reversed(self.models)}

    def link(self, name: str) -> "tuple[SdfModel, LinedElement] | None":
        """Return a link of the model or of one in it, by a name as model::link; None: there is none."""
        first, _, rest = name.partition("::")
        if rest:
            inner = self._inner.get(first)
            return None if inner is None else inner.link(rest)
        found = self._entities.get(name)
        return None if found is None or found.tag != "link" else (self, found)

    def frame(self, name: str, seen: Sequence[str] = ()) -> Pose:
        """Return the pose of a link, joint, frame or inner model in the model.

        Args:
            name: Its name, as link or as model::link; empty: the model's own frame.
            seen: Names on the way, to find circles.

        Raises:
            ArenaFileError: There is no such frame, or it is relative to itself.
        """
        if name in ("", MODEL_FRAME) or (name == WORLD and self.element.tag == WORLD):
            return NO_POSE
        if name in seen or len(seen) > MAX_FRAMES:
            raise self.element.error(f"{self._called}: frame {name!r} is relative to itself")
        seen = (*seen, name)
        first, _, rest = name.partition("::")
        if first in self._inner:
            inner = self._inner[first]
            # `seen` begins anew inside: frames of an inner model cannot name those of the outer one.
            return self.pose_of_model(inner, seen).then(inner.frame(rest))
        found = self._entities.get(name)
        if found is None:
            known = ", ".join([*self._entities, *self._inner][:20]) or "none"
            raise self.element.error(f"{self._called}: there is no frame {name!r}; known: {known}")
        return self.placed(found.first("pose"), seen, self._base(found))

    @property
    def _called(self) -> str:
        return f"{self.element.tag} {self.name!r}"

    @staticmethod
    def _base(entity: LinedElement) -> str:
        """Return the frame that an entity's pose is relative to if it does not say so."""
        if entity.tag == "joint":
            # SDF places a joint in its child's frame, unlike URDF, which places it in the parent's.
            return entity.word("child")
        return entity.get("attached_to", "") if entity.tag == "frame" else ""

    def pose_of_model(self, inner: "SdfModel", seen: Sequence[str] = ()) -> Pose:
        """Return the pose of a model in this one."""
        pose = self.placed(inner.pose, seen)
        # The pose is that of the placement frame: the model's own follows by going back from there.
        return pose.then(inverse(inner.frame(inner.placement))) if inner.placement else pose

    def placed(self, pose: LinedElement | None, seen: Sequence[str] = (), base: str = "") -> Pose:
        """Return a pose element's pose in the model.

        Args:
            pose: The element; None: no offset.
            seen: Names on the way, to find circles.
            base: Frame that it is relative to if it does not say so; empty: the model's own.
        """
        if pose is not None:
            # `frame` is the attribute's name before SDF 1.7.
            base = pose.get("relative_to") or pose.get("frame") or base
        return self.frame(base, seen).then(read_pose(pose))


class SdfFiles:
    """Reader of SDF files and of the models that they include.

    Args:
        resources: Folders of models.
    """

    def __init__(self, resources: Resources) -> None:
        self.resources = resources
        self.notes: list[str] = []
        self._read: dict[Path, LinedElement] = {}
        self._elements = 0

    def root(self, path: Path) -> LinedElement:
        """Return the first `<world>` of a file, else its first `<model>`.

        Raises:
            ArenaFileError: An unreadable file, or one with neither.
        """
        # A world includes one model many times: its file is parsed once.
        if path not in self._read:
            self._read[path] = read_lined_xml(path)
        root = self._read[path]
        if root.tag not in SDF_ROOTS:
            raise ArenaFileError(f"{path}: its root is <{root.tag}>; an SDF file's is <sdf>")
        for tag in (WORLD, "model"):
            found = root.all(tag)
            if len(found) > 1:
                self.notes.append(
                    f"{found[1].place}: the file has {len(found)} of <{tag}>; the first is taken"
                )
            if found:
                return found[0]
        raise ArenaFileError(f"{path}: has neither a <world> nor a <model>")

    def world(self, path: Path) -> SdfModel:
        """Return the world of a file; a model by itself stands at its pose in an empty one."""
        root = self.root(path)
        if root.tag == "model":
            # An empty element stands for the world, so that both kinds of file have one form from here on.
            world = LinedElement(WORLD)
            world.path, world.line = path, 1
            made = SdfModel(world, path.stem, "", None, "", None, root.place)
            made.models = [self._model(root, made, ())]
            return made
        made = SdfModel(root, root.get("name", path.stem), "", None, "", None, root.place)
        made.models = [*self._models(root, made, (path.resolve(),))]
        return made

    def _models(self, element: LinedElement, owner: SdfModel, above: tuple[Path, ...]) -> Iterator[SdfModel]:
        """Yield the models and includes in an element."""
        for child in element.children():
            if child.tag == "model":
                yield self._model(child, owner, above)
            elif child.tag == "include":
                found = self._include(child, owner, above)
                if found is not None:
                    yield found

    def _model(self, element: LinedElement, owner: SdfModel, above: tuple[Path, ...]) -> SdfModel:
        if len(above) > MAX_SDF_DEPTH or owner.path.count("::") > MAX_SDF_DEPTH:
            raise element.error(f"models are nested more than {MAX_SDF_DEPTH} deep")
        # Counted with every inclusion: a few lines that include each other can stand for millions of
        # elements.
        self._elements += 1 + sum(1 for _ in element.iter())
        if self._elements > MAX_SDF_ELEMENTS:
            raise element.error(f"more than {MAX_SDF_ELEMENTS} elements with all that is included")
        name = element.get("name") or "model"
        static = _truth(element.first("static"))
        path = f"{owner.path}::{name}" if owner.path else name
        made = SdfModel(
            element,
            name,
            path,
            element.first("pose"),
            element.get("placement_frame", ""),
            owner.static if static is None else static,
            element.place,
        )
        made.models = [*self._models(element, made, above)]
        return made

    def _include(self, include: LinedElement, owner: SdfModel, above: tuple[Path, ...]) -> SdfModel | None:
        """Return an included model with what the include says; None: it is left out, with a note."""
        uri = include.word("uri")
        if not uri:
            raise include.error("<include> has no <uri>")
        file = self._model_file(uri, include.path)
        if file is None:
            # Only now: a user's own copy of such a model comes first.
            if content := BUILTIN.get(_last_word(uri)):
                return self._included(self._model(_builtin(content, include), owner, above), include)
            self.notes.append(
                f"{include.place}: model {uri} is not there and left out; --packages or GZ_SIM_RESOURCE_PATH "
                "name folders to search"
            )
            return None
        # Links are resolved: a model may include itself under another name of its folder.
        if file.resolve() in above:
            raise include.error(f"{uri} includes itself")
        root = self.root(file)
        if root.tag == WORLD:
            raise include.error(f"{uri} is a world, and no model")
        return self._included(self._model(root, owner, (*above, file.resolve())), include)

    @staticmethod
    def _included(made: SdfModel, include: LinedElement) -> SdfModel:
        """Return a model with what its include says."""
        name = include.word("name")
        if name:
            # The path first: it ends in the old name.
            made.path = f"{made.path.removesuffix(made.name)}{name}"
            made.name = name
        pose = include.first("pose")
        if pose is not None:
            made.pose, made.placement = pose, include.word("placement_frame")
        static = _truth(include.first("static"))
        if static is not None:
            # For inner models, too: they have taken over the value that the include replaces.
            _set_static(made, static)
        made.place = include.place
        return made

    def _model_file(self, uri: str, origin: Path) -> Path | None:
        """Return the file of a model, by its address; None: it is not there."""
        found = self.file(uri, origin)
        if found is None and "://" not in uri:
            # A bare name counts as that of a model.
            found = self.file(f"model://{uri}", origin)
        if found is None or found.is_file():
            return found
        return self._main_file(found)

    def _main_file(self, folder: Path) -> Path | None:
        """Return the newest SDF file of a model's folder, as its model.config or its names say."""
        config = folder / "model.config"
        if config.is_file():
            try:
                named = read_lined_xml(config).all("sdf")
            except ArenaFileError as error:
                self.notes.append(f"{error}; model.sdf is taken")
                named = []
            files = [(_version(one.get("version", "")), folder / (one.text or "").strip()) for one in named]
            there = [(version, file) for version, file in files if file.is_file()]
            if there:
                # Gazebo takes the newest version that it reads.
                return max(there, key=lambda pair: pair[0])[1]
        found = folder / "model.sdf"
        return found if found.is_file() else None

    def file(self, uri: str, origin: Path) -> Path | None:
        """Return the file or folder that an address means within a file; None: it is not there."""
        remote = REMOTE.match(uri.strip())
        if remote is not None:
            name, inside = unquote(remote[1]), remote[2] or ""
            # Gazebo's own store spells names with blanks; downloads are folders in any of these forms.
            names = (name, name.lower(), name.replace(" ", "_"))
            # Nothing is downloaded: an address counts as the name of a folder on this machine.
            tries = [f"model://{known}/{inside}".rstrip("/") for known in names]
            return next((found for one in tries if (found := self.resources.file(one, origin))), None)
        return self.resources.file(uri.strip(), origin)


BUILTIN = {
    "ground_plane": "<link name='link'><collision name='plane'><geometry><plane><normal>0 0 1</normal>"
    "<size>100 100</size></plane></geometry></collision></link>",
    "sun": "<link name='link'><light type='directional' name='sun'/></link>",
}
"""Models that come with Gazebo and are therefore rarely beside a world."""


def _builtin(content: str, include: LinedElement) -> LinedElement:
    text = f"<model name='{_last_word(include.word('uri'))}'><static>true</static>{content}</model>"
    model = read_lined_xml(include.path, text)
    for element in model.iter():
        if isinstance(element, LinedElement):
            # Built-in models have no file: messages name the line that includes them.
            element.line = include.line
    return model


def _last_word(uri: str) -> str:
    words = [word for word in uri.replace("\\", "/").split("/") if word]
    return unquote(words[-1]).lower().replace(" ", "_") if words else ""


def _version(text: str) -> float:
    try:
        version = float(text)
    except ValueError:
        return 0.0
    return version if math.isfinite(version) else 0.0


def _truth(element: LinedElement | None) -> bool | None:
    """Return a truth value; None: there is no element, or it says neither."""
    word = "" if element is None else (element.text or "").strip().lower()
    return {"1": True, "true": True, "0": False, "false": False}.get(word)


def _set_static(model: SdfModel, static: bool) -> None:
    model.static = static
    for inner in model.models:
        _set_static(inner, static)


@dataclass(frozen=True, eq=False)
class SdfLink:
    """A link in the world.

    Attributes:
        name: Its name with its models.
        model: Its model.
        link: Its element.
        own: Its pose in its model.
        pose: Its pose in the world.
    """

    name: str
    model: SdfModel
    link: LinedElement
    own: Pose
    pose: Pose

    @property
    def base(self) -> str:
        """Name of its frame in its model."""
        return self.link.get("name", "")

    def within(self, item: LinedElement) -> Pose:
        """Return the pose of something on the link in its axes."""
        return inverse(self.own).then(self.model.placed(item.first("pose"), (), self.base))


@dataclass(frozen=True, eq=False)
class SdfJoint:
    """A joint with its model and the model's pose in the world, and its links by their names with models."""

    name: str
    element: LinedElement
    model: SdfModel
    top: Pose
    prefix: str
    parent: str = ""
    child: str = ""

    @property
    def frame(self) -> Pose:
        """Its frame in the world."""
        return self.top.then(self.model.frame(self.name))

    @property
    def axis(self) -> np.ndarray:
        """Its axis in the world (3,), of any length."""
        xyz = self.element.first("axis/xyz")
        way = np.array([0.0, 0.0, 1.0]) if xyz is None else numbers_of(xyz, xyz.text, 3)
        base = "" if xyz is None else xyz.get("expressed_in", "")
        if self.element.word("axis/use_parent_model_frame").lower() in ("1", "true"):
            # Before SDF 1.7, instead of `expressed_in`.
            base = MODEL_FRAME
        return (self.top.then(self.model.frame(base)) if base else self.frame).mat @ way

    @property
    def limits(self) -> tuple[float, float] | None:
        """Its limits [rad or m]; None: it has none on one side or on both."""
        low = self.element.number("axis/limit/lower", -FREE_TURN)
        high = self.element.number("axis/limit/upper", FREE_TURN)
        return (low, high) if max(-low, high) < FREE_TURN else None


def all_models(model: SdfModel) -> Iterator[SdfModel]:
    """Yield a model and all models in it."""
    yield model
    for inner in model.models:
        yield from all_models(inner)


def drive_plugins(model: SdfModel) -> Iterator[LinedElement]:
    """Yield the plugins of a model that drive it."""
    for one in all_models(model):
        for plugin in one.element.all("plugin"):
            called = f"{plugin.get('name', '')} {plugin.get('filename', '')}".lower()
            # ROS, Gazebo Classic and the later Gazebo spell the same plugins in several ways.
            plain = called.replace("_", "").replace("-", "")
            if any(word in plain for word in (*DRIVE_PLUGINS, *MOVE_PLUGINS)):
                yield plugin


def links_of(model: SdfModel, pose: Pose) -> Iterator[tuple[str, SdfLink]]:
    """Yield the links of a model and of those in it, by their names with models."""
    for link in model.element.all("link"):
        name = link.get("name", "")
        own = model.frame(name)
        path = f"{model.path}::{name}"
        yield path, SdfLink(path, model, link, own, pose.then(own))
    for inner in model.models:
        yield from links_of(inner, pose.then(model.pose_of_model(inner)))


def joints_of(model: SdfModel, pose: Pose) -> Iterator[SdfJoint]:
    """Yield the joints of a model and of those in it, with the models' poses in the world."""
    for joint in model.element.all("joint"):
        yield SdfJoint(joint.get("name", ""), joint, model, pose, f"{model.path}::")
    for inner in model.models:
        yield from joints_of(inner, pose.then(model.pose_of_model(inner)))


def joint_end(joint: SdfJoint, end: str, frames: dict[str, SdfLink]) -> str | None:
    """Return the link at an end of a joint, also one that a frame is attached to; None: there is none."""
    name = joint.element.word(end) or joint.element.word(f"{end}/link")
    # Bounded: frames may be attached to each other in a circle.
    for _ in range(len(frames) + 1):
        if joint.prefix + name in frames:
            return joint.prefix + name
        frame = next((one for one in joint.model.element.all("frame") if one.get("name") == name), None)
        if frame is None or not frame.get("attached_to"):
            break
        name = frame.get("attached_to", "")
    # A model in the model may stand for its first link.
    inner = [path for path in frames if path.startswith(f"{joint.prefix}{name}::")]
    return inner[0] if inner else None


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
        # URDF has no frame of a link beside its joint's: the link's origin moves to the joint.
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
            # URDF describes trees: a second joint above a link cannot be written.
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
                # URDF has no plugins of its own: they are Gazebo's, within its element.
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
        # `repr` writes a float so that it reads back to the bit.
        made.append(_element("mass", inertial, value=repr(inertial.number("mass", 1.0))))
        # SDF's defaults [kg m2]; URDF has none.
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
        # URDF's reader holds floating joints, and says so.
        made_kind = MOVING.get(kind, "fixed" if kind == "fixed" else "floating")
        # A revolute joint of URDF demands limits.
        if made_kind == "revolute" and joint.limits is None:
            made_kind = "continuous"
        made = _element("joint", element, name=joint.name, type=made_kind)
        # URDF has a joint's frame relative to that of the parent.
        frame = inverse(self._frames[joint.parent]).then(self._frames[joint.child])
        made.append(_origin(element, frame))
        made.append(_element("parent", element, link=self._short[joint.parent]))
        made.append(_element("child", element, link=self._short[joint.child]))
        if element.first("axis") is None:
            return made
        # URDF has the axis in the joint's frame, which is the child's.
        axis = " ".join(repr(value) for value in (self._frames[joint.child].mat.T @ joint.axis).tolist())
        made.append(_element("axis", element, xyz=axis))
        limits = {"lower": repr(low), "upper": repr(high)}
        for key in ("effort", "velocity"):
            value = element.number(f"axis/limit/{key}", -1.0)
            # 0 in URDF is no limit, for which SDF has -1 or a huge number.
            limits[key] = repr(value if 0 < value < FREE_TURN else 0.0)
        made.append(_element("limit", element, **limits))
        # Negative ones would feed energy into the joint.
        damping, friction = (
            repr(max(element.number(f"axis/dynamics/{key}", 0.0), 0.0)) for key in ("damping", "friction")
        )
        made.append(_element("dynamics", element, damping=damping, friction=friction))
        return made

    def _gazebo(self, path: str, link: SdfLink) -> Iterator[LinedElement]:
        """Yield a link's sensors and friction as URDF's `<gazebo>` elements."""
        for sensor in link.link.all("sensor"):
            made = _element("sensor", sensor, **dict(sensor.attrib))
            # SDF's pose is relative to its own frame of the link: one in URDF's takes its place.
            made.extend(child for child in sensor.children() if child.tag != "pose")
            made.append(_pose(sensor, self._local(path, link, sensor)))
            yield self._about(path, made)
        friction = link.link.first("collision/surface/friction/ode/mu")
        if friction is not None:
            # ODE's `mu` is called mu1 in Gazebo's extension of URDF.
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
    # Flipped back: SDF and URDF have z up, as MuJoCo, and USARSim's angles have z down.
    angles = flip_angles(usarsim_angles(pose.mat))
    return " ".join(map(repr, pose.pos.tolist())), " ".join(map(repr, angles))


def _origin(like: LinedElement, pose: Pose) -> LinedElement:
    xyz, rpy = _numbers(pose)
    return _element("origin", like, xyz=xyz, rpy=rpy)


def _pose(like: LinedElement, pose: Pose) -> LinedElement:
    made = _element("pose", like)
    made.text = " ".join(_numbers(pose))
    return made
