"""Pictures of robots' cameras beside the live page, rendered while a user asks for them."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.cameras.picture import camera_viewpoint
from usarmjx.server.pictures.views import CompositeView, RenderThread, ViewImages, all_robots_view, robot_view
from usarmjx.server.worlds.served_world import ServedWorld, ViewpointRequest
from usarmjx.view.drawing import Drawing, Frame

if TYPE_CHECKING:
    from usarmjx.view.page import ViewerPage

NOTHING, ITS_VIEW, ALL_ROBOTS = "nothing", "its own view", "all robots"
"""Choices beside the names of cameras: no picture, the robot's viewports, and the MultiView."""
SIZE = (320, 240)
"""Width and height of a picture [pixels]."""
PERIOD = 1 / 20
"""Least interval between two pictures [s]."""


class CameraInset:
    """A `view.page.Panel`: a camera's picture of the last chosen robot, else of the first one.

    Pictures are rendered only while a user asks for one. A user who goes on from the last robot gets the
    picture of all robots, if the world has one, as in the original's viewing client (manual 3.2.6.2).

    Args:
        page: The page.
        worlds: The worlds of the page, by number.

    Attributes:
        rendered: Number of rendered pictures.
    """

    def __init__(self, page: "ViewerPage", worlds: Sequence[ServedWorld]) -> None:
        self._page, self._worlds = page, worlds
        self._threads: dict[int, RenderThread] = {}
        self._due = 0.0
        self._before_all: str | None = None
        self.rendered = 0
        page.after_last = self._show_all
        gui = page.server.gui
        with gui.add_folder("Camera picture"):
            self._choice = gui.add_dropdown(
                "Show", [NOTHING, ITS_VIEW], hint="What a robot's camera sees, as clients get it"
            )
            self._caption = gui.add_markdown("")
            self._image = gui.add_image(
                np.zeros((*SIZE[::-1], 3), np.uint8), format="jpeg", jpeg_quality=80, visible=False
            )

    def begin(self, drawing: Drawing) -> None:
        """Offer the cameras of the robots."""
        names = dict.fromkeys(
            camera.names[0] for robot in drawing.robots.values() for camera in robot.cameras
        )
        shared = [ALL_ROBOTS] if self._world.multi_view is not None else []
        options = (NOTHING, ITS_VIEW, *names, *shared)
        # Setting the same options again would close the dropdown under the user's mouse.
        if tuple(self._choice.options) != options:
            now = self._choice.value
            self._choice.options = options
            self._choice.value = now if now in options else NOTHING

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Render a picture, if one is due."""
        # The user has chosen a robot again: the choice from before the picture of all robots is back.
        if self._before_all is not None and self._page.robot is not None:
            self._choice.value, self._before_all = self._before_all, None
        wanted, now = self._choice.value, time.monotonic()
        if wanted == NOTHING:
            self._image.visible, self._caption.content = False, ""
            return
        if self._page.world not in self._threads:
            self._threads[self._page.world] = RenderThread(self._world)
        thread = self._threads[self._page.world]
        if now < self._due or not thread.is_ready(now):
            return
        self._due = now + PERIOD
        view, caption = self._view(wanted, drawing, frame)
        self._caption.content = caption
        if view is None:
            self._image.visible = False
            return
        thread.begin(self._show(thread, view))

    def _show_all(self) -> bool:
        """Show all robots until a user chooses one; return whether the world has such a picture."""
        if ALL_ROBOTS not in self._choice.options:
            return False
        if self._choice.value != ALL_ROBOTS:
            self._before_all, self._choice.value = self._choice.value, ALL_ROBOTS
        return True

    def close(self) -> None:
        """Stop rendering."""
        for thread in self._threads.values():
            thread.close()

    @property
    def _world(self) -> ServedWorld:
        return self._worlds[self._page.world]

    async def _show(self, thread: RenderThread, view: CompositeView) -> None:
        def put_up(images: ViewImages) -> None:
            self._image.image = images[view]  # encoded here, in the thread
            self._image.visible = True

        await thread.render([view], put_up)
        self.rendered += 1

    def _view(self, wanted: str, drawing: Drawing, frame: Frame) -> tuple[CompositeView | None, str]:
        """Return the requested view and its caption."""
        if wanted == ALL_ROBOTS:
            return all_robots_view(self._world, SIZE), "All robots"
        with_cameras = [slot for slot in sorted(frame.robots) if drawing.robots[slot].cameras]
        slot = self._page.robot if self._page.robot in with_cameras else next(iter(with_cameras), None)
        if slot is None:
            return None, "No robot here has a camera."
        name = drawing.robots[slot].name
        camera = "" if wanted == ITS_VIEW else wanted
        robot = self._world.robots.get(slot)
        if robot is not None:
            view = robot_view(robot, camera, SIZE)
            # Without a tile the picture would be black, and a user would take that for what the camera sees.
            return (view, name) if view.tiles else (None, f"{name} has no {camera}.")
        return self._unclaimed(slot, camera, drawing, frame), name

    def _unclaimed(self, slot: int, camera: str, drawing: Drawing, frame: Frame) -> CompositeView | None:
        """Return the view of a robot without a client: the camera of that name, or the first."""
        robot = drawing.robots[slot]
        names = [mount.names[0] for mount in robot.cameras]
        index = names.index(camera) if camera in names else 0
        group, _ = self._world.scene.group_of(slot)
        lens = cameras_of(self._world.scene.groups[group].robot)[index]
        own = slice(robot.body, robot.body + robot.num_bodies)
        # Frames have w first, as MuJoCo; SciPy has it last by default.
        turns = Rotation.from_quat(frame.quat[own], scalar_first=True).as_matrix()
        bodies = BodyPoses(pos=frame.pos[own], mat=turns.astype(np.float32))
        fov = np.asarray(frame.robots[slot].fovs[index], np.float32)
        eye = camera_viewpoint(lens, bodies, np.array(slot, np.int32), fov)
        # Eyes share the width: it must divide among them.
        width = SIZE[0] - SIZE[0] % len(lens.eye_offsets)
        return CompositeView(SIZE, ((ViewpointRequest(eye, width, SIZE[1]), 0, 0),))
