"""Links, joints and drives of SDF's models, with their poses in the world."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from usarmjx.models.files.gazebo_sensors import DRIVE_PLUGINS
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.files.sdf_tree import MODEL_FRAME, SdfModel, inverse
from usarmjx.models.files.xml_lines import LinedElement, numbers_of

FREE_TURN = 1e15
"""Limit of a joint from which it has none [rad or m]."""
MOVE_PLUGINS = ("planarmove", "multicoptermotor", "omnidrive", "trackedvehicle", "velocitycontrol")
"""Words in the names of plugins that move a robot otherwise."""


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
    for _ in range(len(frames) + 1):
        if joint.prefix + name in frames:
            return joint.prefix + name
        frame = next((one for one in joint.model.element.all("frame") if one.get("name") == name), None)
        if frame is None or not frame.get("attached_to"):
            break
        name = frame.get("attached_to", "")
    inner = [path for path in frames if path.startswith(f"{joint.prefix}{name}::")]
    return inner[0] if inner else None
