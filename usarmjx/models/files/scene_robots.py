"""Robots in MJCF scenes, which arenas leave out."""

from pathlib import Path
from typing import Any

import mujoco

from usarmjx.models.files.robot_source import left_out

TRANSMISSIONS: Any = mujoco.mjtTrn  # its stubs lack some


def leave_out_robots(path: Path, spec: Any) -> list[str]:  # noqa: ANN401
    """Delete the robots of a scene from its description; return notes that name them.

    A robot is a body of the world with motors on joints, sites or bodies of it, and with several joints or a
    free one: a door that a motor turns stays a door. Tendons, constraints, sensors and pairs of its parts go
    with it.

    Args:
        path: The file, for the notes.
        spec: The scene, which is changed.
    """
    driven = {(int(one.trntype), one.target) for one in spec.actuators}
    driven |= _driven_by_tendons(spec)
    robots: list[Any] = []
    for body in spec.worldbody.bodies:
        parts = _subtree(body)
        joints = [joint for part in parts for joint in part.joints]
        named = {(int(kind), joint.name) for joint in joints for kind in JOINT_TRANSMISSIONS}
        sites = [site for part in parts for site in part.sites]
        named |= {(int(kind), site.name) for site in sites for kind in SITE_TRANSMISSIONS}
        named |= {(int(TRANSMISSIONS.mjTRN_BODY), part.name) for part in parts}
        free = any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in joints)
        if driven & named and (free or len(joints) > 1):
            robots.append(body)
    if not robots:
        return []
    note = left_out(path, "robots", robots)
    for body in robots:
        _delete_with_references(spec, body)
    for key in [*spec.keys]:
        spec.delete(key)  # its numbers are those of the joints that are gone
    return [note]


JOINT_TRANSMISSIONS: tuple[Any, ...] = (TRANSMISSIONS.mjTRN_JOINT, TRANSMISSIONS.mjTRN_JOINTINPARENT)
"""Transmissions of actuators to joints."""
SITE_TRANSMISSIONS: tuple[Any, ...] = (TRANSMISSIONS.mjTRN_SITE, TRANSMISSIONS.mjTRN_SLIDERCRANK)
"""Transmissions of actuators to sites."""


def _driven_by_tendons(spec: Any) -> set[tuple[int, str]]:  # noqa: ANN401
    """Return the joints and sites on tendons that an actuator pulls, as targets of actuators."""
    pulled = {one.target for one in spec.actuators if one.trntype == TRANSMISSIONS.mjTRN_TENDON}
    found: set[tuple[int, str]] = set()
    for tendon in spec.tendons:
        if tendon.name in pulled:
            for wrap in tendon.path:
                name = getattr(wrap.target, "name", "")
                found |= {(int(kind), name) for kind in (*JOINT_TRANSMISSIONS, *SITE_TRANSMISSIONS)}
    return found


def _subtree(body: Any) -> list[Any]:  # noqa: ANN401
    """Return a body and all below it."""
    found = [body]
    for one in found:
        found += list(one.bodies)
    return found


def _delete_with_references(spec: Any, body: Any) -> None:  # noqa: ANN401
    """Delete a body and all elements that refer to it or to what is on it."""
    parts = _subtree(body)
    gone = {part.name for part in parts}
    for part in parts:
        gone |= {one.name for kind in (part.joints, part.sites, part.geoms, part.cameras) for one in kind}
    gone.discard("")
    tendons = [one for one in spec.tendons if _wrapped(one) & gone]
    gone |= {one.name for one in tendons if one.name}
    actuators = [one for one in spec.actuators if one.target in gone]
    gone |= {one.name for one in actuators if one.name}
    doomed: list[Any] = [one for one in spec.sensors if {one.objname, one.refname} & gone]
    doomed += [one for one in spec.equalities if {one.name1, one.name2} & gone]
    doomed += [one for one in spec.pairs if {one.geomname1, one.geomname2} & gone]
    doomed += [one for one in spec.excludes if {one.bodyname1, one.bodyname2} & gone]
    for one in (*doomed, *actuators, *tendons, body):
        spec.delete(one)


def _wrapped(tendon: Any) -> set[str]:  # noqa: ANN401 - mujoco.MjsTendon
    return {getattr(wrap.target, "name", "") for wrap in tendon.path}
