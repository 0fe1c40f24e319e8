"""Joints that bear their robot: those between its chassis and what reaches the ground, as of legs."""

import mujoco
import numpy as np

from usarmjx.models.files.body_tree import BodyTree
from usarmjx.models.files.robot_drive import MAX_LIFT, at_rest, lowest_point


def borne_inertias(tree: BodyTree) -> dict[int, float]:
    """Return the inertia that each bearing joint moves while its feet stand [kg m2 or kg], by part.

    A robot whose chassis reaches the ground is borne by that, and by no joint.
    """
    data, model = at_rest(tree), tree.model
    lows = {owner: lowest_point(tree, owner, data) for owner in tree.owners}
    ground = min(lows.values())
    feet = {owner for owner, low in lows.items() if low <= ground + MAX_LIFT}
    if tree.owners[0] in feet:
        return {}
    share = float(model.body_subtreemass[tree.owners[0]]) / len(feet)
    found: dict[int, float] = {}
    for foot in feet:
        place = np.mean([data.geom_xpos[geom] for geom in tree.touching_geoms(foot)], axis=0)
        up = data.xmat[tree.owners[0]].reshape(3, 3)[:, 2]
        place = place + up * (ground - float(up @ (place - data.xpos[tree.owners[0]])))
        owner = foot
        while owner != tree.owners[0]:
            joint = tree.joint_of(owner)
            lever = 1.0
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
                lever = float(np.linalg.norm(np.cross(data.xaxis[joint], place - data.xanchor[joint])))
            found[owner] = found.get(owner, 0.0) + share * lever**2
            owner = tree.holder_of(owner)
    return found
