"""Transforms between two frames for web clients, as tf2_web_republisher has them: its action and its service.

A client names a fixed frame and those that it wants to see from there. It hears them as feedback of the
action (`/tf2_web_republisher/goal`), or at a topic of its own that the service `/republish_tfs` names.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat, quat_from_mat
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion, json_object
from usarmjx.server.rosbridge.motion import quaternion, vector

ACTION = "/tf2_web_republisher"
GOAL, CANCEL, FEEDBACK = f"{ACTION}/goal", f"{ACTION}/cancel", f"{ACTION}/feedback"
REPUBLISH = "/republish_tfs"
LISTENED = {GOAL: "tf2_web_republisher/TFSubscriptionActionGoal", CANCEL: "actionlib_msgs/GoalID"}
"""Topics of the action that clients send to, and their types."""
FEEDBACK_TYPE = "tf2_web_republisher/TFSubscriptionActionFeedback"
ARRAY_TYPE = "tf2_web_republisher/TFArray"
MOST_GOALS, MOST_FRAMES = 16, 200
"""Most requests of a client, and most frames of a request."""
ACTIVE = 1
"""Status of a goal that is being carried out (actionlib_msgs/GoalStatus)."""
Pose = tuple[np.ndarray, np.ndarray]
"""Rotation (3, 3) and position [m] (3,)."""


@dataclass
class TransformRequest:
    """Frames that a client wants to see from another.

    Attributes:
        name: ID of the goal, or name of the topic.
        sources: The frames.
        target: The frame in which they are expressed.
        pause: Least time between two messages [s].
        due: Earliest time of the next message [s].
    """

    name: str
    sources: tuple[str, ...]
    target: str
    pause: float
    due: float = 0.0


@dataclass
class TransformRequests:
    """The requests of one client, by goal or topic.

    Attributes:
        goals: Those by action.
        topics: Those by service.
    """

    goals: dict[str, TransformRequest] = field(default_factory=dict[str, TransformRequest])
    topics: dict[str, TransformRequest] = field(default_factory=dict[str, TransformRequest])

    def take(self, topic: str, message: object) -> None:
        """Take a goal, or the cancellation of one.

        Raises:
            UsageError: It is none.
        """
        said = json_object(message) or {}
        if topic == CANCEL:
            name = said.get("id")
            if name:
                self.goals.pop(str(name), None)
            else:
                self.goals.clear()  # actionlib: no ID means all
            return
        head, goal = json_object(said.get("goal_id")), json_object(said.get("goal"))
        if head is None or goal is None:
            raise UsageError(f"a goal of {ACTION} has goal_id and goal")
        name = str(head.get("id", ""))[:200]
        if name not in self.goals and len(self.goals) >= MOST_GOALS:
            # The oldest yields: clients of this action often forget to cancel.
            self.goals.pop(next(iter(self.goals)))
        self.goals[name] = read_request(name, goal)

    def add_topic(self, name: str, args: Mapping[str, Any]) -> None:
        """Add a request by the service.

        Raises:
            UsageError: An argument is not valid.
        """
        while len(self.topics) >= MOST_GOALS:
            self.topics.pop(next(iter(self.topics)))
        self.topics[name] = read_request(name, args)


def read_request(name: str, args: Mapping[str, Any]) -> TransformRequest:
    """Return a request.

    Raises:
        UsageError: An argument is not valid.
    """
    given, target, rate = args.get("source_frames", []), args.get("target_frame", ""), args.get("rate", 10.0)
    sources = cast(list[object], given) if isinstance(given, list) else []
    # Older clients send names of tf, which begin with a slash; those of tf2 do not.
    frames = tuple(one.strip("/") for one in sources if isinstance(one, str))
    if not isinstance(given, list) or len(frames) < len(sources) or len(frames) > MOST_FRAMES:
        raise UsageError(f"source_frames are up to {MOST_FRAMES} names of frames")
    if not isinstance(target, str) or not target.strip("/"):
        raise UsageError("target_frame is the name of a frame")
    if type(rate) not in (int, float) or not 0 < rate <= 1000:
        raise UsageError("rate is a number above 0, up to 1000 [Hz]")
    return TransformRequest(name, frames, target.strip("/"), 1.0 / rate)


def resolve(transforms: Sequence[RosMessage], request: TransformRequest) -> list[tuple[str, Pose]]:
    """Return the frames of a request in its target frame; those that nothing connects are left out.

    Args:
        transforms: TransformStamped of all frames.
        request: The request.
    """
    # Frames form a tree, in which every frame has one parent.
    parents = {one["child_frame_id"]: one for one in transforms}
    here = _in_root(parents, request.target)
    found: list[tuple[str, Pose]] = []
    for source in request.sources:
        there = _in_root(parents, source)
        # Frames of different trees have no relation, as those of a world without a map frame.
        if here is None or there is None or here[0] != there[0]:
            continue
        (mat, pos), (other_mat, other_pos) = here[1], there[1]
        found.append((source, (mat.T @ other_mat, mat.T @ (other_pos - pos))))
    return found


def _in_root(parents: Mapping[str, RosMessage], frame: str) -> tuple[str, Pose] | None:
    """Return the root of a frame's tree and the frame's pose in it; None for an unknown frame."""
    known = frame in parents or any(one["header"]["frame_id"] == frame for one in parents.values())
    if not known:
        return None
    mat, pos = np.eye(3), np.zeros(3)
    # Bounded by the number of frames: a loop among parents must not hang the server.
    for _ in range(len(parents)):
        if frame not in parents:
            break
        one = parents[frame]
        turn, shift = _pose(one["transform"])
        # From the frame up to its root: each step puts the parent's transform in front.
        mat, pos = turn @ mat, turn @ pos + shift
        frame = one["header"]["frame_id"]
    return frame, (mat, pos)


def _pose(transform: RosMessage) -> Pose:
    turn, shift = transform["rotation"], transform["translation"]
    with numpy_backend():
        mat = np.asarray(mat_from_quat(np.array([turn[axis] for axis in "wxyz"], float)))
    return mat, np.array([shift[axis] for axis in "xyz"], float)


def transform_array(
    version: RosVersion, time: float, transforms: Sequence[RosMessage], request: TransformRequest
) -> RosMessage:
    """Return the TFArray of a request."""
    seen: list[RosMessage] = []
    for source, (mat, pos) in resolve(transforms, request):
        with numpy_backend():
            quat = np.asarray(quat_from_mat(mat))
        seen.append(
            {
                "header": version.header(time, request.target),
                "child_frame_id": source,
                "transform": {"translation": vector(pos), "rotation": quaternion(quat)},
            }
        )
    return {"transforms": seen}


def feedback(version: RosVersion, time: float, name: str, array: RosMessage) -> RosMessage:
    """Return the feedback of a goal."""
    status = {"goal_id": {"stamp": version.stamp(time), "id": name}, "status": ACTIVE, "text": ""}
    return {"header": version.header(time, ""), "status": status, "feedback": array}
