"""Links, joints and frames of a URDF file, for its readers as an arena and as a robot."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.files.robot_source import listed
from usarmjx.models.files.xml_lines import NO_POSE, LinedElement, attribute_numbers, pose_of, read_lined_xml

MAX_LISTED_LINKS = 20
"""Largest number of links in a message."""


def read_urdf(path: Path, text: bytes | None = None) -> LinedElement:
    """Return the `<robot>` element of a URDF file.

    Args:
        path: The file.
        text: Text to read instead of the file's content.

    Raises:
        ArenaFileError: See `read_lined_xml`; or another root.
    """
    root = read_lined_xml(path, text)
    if root.tag != "robot":
        raise ArenaFileError(f"{path}: its root is <{root.tag}>; a URDF file's is <robot>")
    return root


VECTORS = {"xyz": 3, "rpy": 3, "scale": 3, "size": 3}
"""Attributes of URDF with several numbers, and how many."""
MAX_STEERING = 3.0
"""Largest limit of a continuous joint that counts [rad]: wheels are limited to half a turn by mistake."""
VALUES = ("mu1", "mu2", "mu")
"""Elements of `<gazebo>` whose number some files have in an attribute."""


def mend_urdf(root: LinedElement) -> list[str]:
    """Change what other readers of URDF accept to the format; return notes, with file and line.

    Commas between numbers, more numbers than there are axes, numbers of `<gazebo>` in an attribute, and
    limits of continuous joints within which no wheel turns.
    """
    notes: list[str] = []
    for element in root.iter():
        assert isinstance(element, LinedElement)
        for key, count in VECTORS.items():
            text = element.get(key)
            if text is None:
                continue
            words = text.replace(",", " ").split()
            if "," not in text and len(words) <= count:
                continue
            said = "commas" if "," in text else f"{len(words)} numbers"
            notes.append(
                f"{element.place}: <{element.tag} {key}> has {said}: {' '.join(words[:count])} counts"
            )
            element.set(key, " ".join(words[:count]))
        if element.tag in VALUES and not (element.text or "").strip() and (value := element.get("value")):
            element.text = value
        if element.tag == "joint" and element.get("type") == "continuous" and _is_limited(element):
            notes.append(
                f"{element.place}: joint {element.get('name')!r} is continuous and has limits: they hold"
            )
            element.set("type", "revolute")
    return notes


def _is_limited(joint: LinedElement) -> bool:
    """Return whether a continuous joint has limits of less than half a turn to each side."""
    limit = joint.first("limit")
    if limit is None:
        return False
    try:
        low, high = float(limit.get("lower", "0")), float(limit.get("upper", "0"))
    except ValueError:
        return False  # its reader says so
    return -MAX_STEERING < low < high < MAX_STEERING


def joints_by_parent(root: LinedElement, links: Collection[str]) -> dict[str, list[LinedElement]]:
    """Return the joints of a file by the link that they hang on, in the file's order.

    Args:
        root: Its `<robot>` element.
        links: Names of its links.

    Raises:
        ArenaFileError: A joint without a name or between links that do not exist, or a link on two joints.
    """
    found: dict[str, list[LinedElement]] = {}
    owners: dict[str, LinedElement] = {}
    for joint in root.all("joint"):
        name = joint.get("name")
        if name is None:
            raise joint.error("a joint has no name")
        for end in ("parent", "child"):
            if link_at(joint, end) not in links:
                raise joint.error(
                    f"joint {name!r}: its {end} {link_at(joint, end)!r} is no link; "
                    f"known: {listed([*links], MAX_LISTED_LINKS)}"
                )
        child = link_at(joint, "child")
        if child in owners:
            raise joint.error(f"joint {name!r}: link {child!r} hangs on {owners[child].get('name')!r} too")
        owners[child] = joint
        found.setdefault(link_at(joint, "parent"), []).append(joint)
    return found


def link_at(joint: LinedElement, end: str) -> str:
    """Return the link at an end of a joint, `parent` or `child`; empty: the joint names none."""
    found = joint.first(end)
    return "" if found is None else found.get("link", "")


def frame_of(element: LinedElement) -> Pose:
    """Return the frame of an element's `<origin>`."""
    origin = element.first("origin")
    if origin is None:
        return NO_POSE
    xyz, rpy = (attribute_numbers(origin, key, 3, "0 0 0") for key in ("xyz", "rpy"))
    return pose_of(np.concatenate([xyz, rpy]))


def lengths_of(form: LinedElement, key: str, count: int) -> np.ndarray:
    """Return the lengths in an attribute [m] (count,).

    Raises:
        ArenaFileError: It is missing, or has others.
    """
    lengths = attribute_numbers(form, key, count)
    if lengths.min() <= 0:
        raise form.error(f"<{form.tag} {key}> has {lengths.tolist()}, expected lengths above zero [m]")
    return lengths


def form_of(solid: LinedElement) -> LinedElement | None:
    """Return the box, sphere or other form of a `<collision>` or `<visual>`; None: it has no geometry."""
    geometry = solid.first("geometry")
    return None if geometry is None else next(iter(geometry.children()), None)
