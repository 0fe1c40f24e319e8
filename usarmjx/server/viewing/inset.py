"""Pictures of robots' cameras beside the live page: what the raycaster sees, while somebody wants it."""

import html
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.cameras.picture import camera_viewpoint
from usarmjx.server.gamebots.console import NOT_ALLOWED, SpectatorCamera, SpectatorConsole
from usarmjx.server.pictures.render_thread import RenderThread, ViewImages
from usarmjx.server.pictures.views import CompositeView, all_robots_view, robot_view
from usarmjx.server.runtime.logs import LogTail
from usarmjx.server.worlds.served_world import ServedWorld, ViewpointRequest
from usarmjx.view.controls import ControlLock
from usarmjx.view.drawing import Drawing, Frame

if TYPE_CHECKING:
    from usarmjx.view.page import ViewerPage


MAX_SHOWN = 8000
"""So much of what the console has answered stays [characters]."""
MANY_UPDATES = 20
"""How many updates a second there are is told of the last so many."""
TAKE_THEM = "take the controls first"
SOMEBODY_ELSE = "this is for who has the controls, and that is somebody else"
STYLE = "font-size:.75em;margin:0 1em .5em;max-height:16em;overflow:auto;white-space:pre-wrap"


class ConsolePanel:
    """A `view.panel.Panel`: a console for each person at the page.

    Who has the controls may use all of it, the others may look: see `console.SpectatorConsole`.

    Args:
        page: The page.
        worlds: What it shows, by number.
        seat: Who has the controls.
        tail: The log; None: it is not kept.
    """

    def __init__(
        self,
        page: "ViewerPage",
        worlds: Sequence[ServedWorld],
        seat: ControlLock,
        tail: LogTail | None = None,
    ) -> None:
        self._page, self._worlds, self._seat, self._tail = page, worlds, seat, tail
        self._people: dict[int, UserConsole] = {}
        self._updates: deque[float] = deque(maxlen=MANY_UPDATES)

    def begin(self, drawing: Drawing) -> None:
        """What is shown makes no difference."""

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Give those who have come a console."""
        self._updates.append(time.monotonic())
        onlookers = self._page.onlookers
        for number in self._people.keys() - onlookers.keys():
            del self._people[number]
        for number, onlooker in onlookers.items():
            if number not in self._people:
                self._people[number] = UserConsole(
                    onlooker.client, partial(self.run, onlooker.client), self._page
                )

    def run(self, client: viser.ClientHandle, line: str) -> str:
        """Carry out a person's line, in the thread that runs the worlds; return what to show."""
        page = self._page
        console = SpectatorConsole(
            self._worlds[page.world],
            page.controls,
            number=page.world,
            camera=partial(self._camera, client),
            tail=self._tail,
            trusted=self._seat.allowed and self._seat.holder == client.client_id,
            refusal=self._refusal(),
        )
        return console.run(line)

    def _refusal(self) -> str:
        if not self._seat.allowed:
            return NOT_ALLOWED
        return SOMEBODY_ELSE if self._seat.holder is not None else TAKE_THEM

    def _camera(self, client: viser.ClientHandle) -> SpectatorCamera | None:
        """Return from where a person looks; None where worlds stand side by side."""
        if self._page.wall:
            return None
        spent = self._updates[-1] - self._updates[0] if self._updates else 0.0
        rate = (len(self._updates) - 1) / spent if spent else 0.0
        w, x, y, z = client.camera.wxyz
        # A camera of viser's looks along its z axis, and its y axis points down.
        right, down, ahead = Rotation.from_quat([x, y, z, w]).as_matrix().T
        return SpectatorCamera(np.array(client.camera.position), np.stack([ahead, -right, -down], 1), rate)


class UserConsole:
    """One person's console."""

    def __init__(self, client: viser.ClientHandle, run: partial[str], page: "ViewerPage") -> None:
        self._run, self._page, self._text = run, page, ""
        gui = client.gui
        with gui.add_folder("Console", expand_by_default=False, order=1000):
            self._line = gui.add_text("Line", "help", hint="help, showlog, showdebug, editactor, pause")
            gui.add_button("Run").on_click(lambda _: page.post(self.enter))
            self._shown = gui.add_html("")

    def enter(self) -> None:
        """Carry out the line."""
        line = self._line.value.strip()
        self._text = f"{self._text}> {line}\n{self._run(line)}\n"[-MAX_SHOWN:]
        self._shown.content = f'<pre style="{STYLE}">{html.escape(self._text)}</pre>'


NOTHING, ITS_VIEW, ALL_ROBOTS = "nothing", "its own view", "all robots"
"""What can be asked for beside each camera by its name: the robot's viewports, and the MultiView."""
SIZE = (320, 240)
"""Width and height of a picture [pixels]."""
PERIOD = 0.25
"""A picture is taken so often at most [s]."""


class CameraInset:
    """A `view.panel.Panel`: a camera's picture of the robot that was chosen last, else of the first one.

    Pictures are rendered only while one is asked for and somebody is at the page.

    Args:
        page: The page.
        worlds: What it shows, by number.

    Attributes:
        rendered: How many pictures have been taken.
    """

    def __init__(self, page: "ViewerPage", worlds: Sequence[ServedWorld]) -> None:
        self._page, self._worlds = page, worlds
        self._threads: dict[int, RenderThread] = {}
        self._due = 0.0
        self.rendered = 0
        gui = page.server.gui
        with gui.add_folder("Camera picture", expand_by_default=False):
            self._choice = gui.add_dropdown(
                "Show", [NOTHING, ITS_VIEW], hint="What a robot's camera sees, as clients get it"
            )
            self._caption = gui.add_markdown("")
            self._image = gui.add_image(
                np.zeros((*SIZE[::-1], 3), np.uint8), format="jpeg", jpeg_quality=80, visible=False
            )

    def begin(self, drawing: Drawing) -> None:
        """Offer the cameras that its robots have."""
        names = dict.fromkeys(
            camera.names[0] for robot in drawing.robots.values() for camera in robot.cameras
        )
        shared = [ALL_ROBOTS] if self._world.multi_view is not None else []
        options = (NOTHING, ITS_VIEW, *names, *shared)
        if tuple(self._choice.options) != options:
            now = self._choice.value
            self._choice.options = options
            self._choice.value = now if now in options else NOTHING

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Take a picture, if it is time for one."""
        wanted, now = self._choice.value, time.monotonic()
        if wanted == NOTHING:
            self._image.visible, self._caption.content = False, ""
            return
        thread = self._threads.setdefault(self._page.world, RenderThread(self._world))
        if now < self._due or not thread.is_ready(now):
            return
        self._due = now + PERIOD
        view, caption = self._view(wanted, drawing, frame)
        self._caption.content = caption
        if view is None:
            self._image.visible = False
            return
        thread.begin(self._show(thread, view))

    def close(self) -> None:
        """Render no more."""
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
        """Return what is to be seen and its caption."""
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
            return (view, name) if view.tiles else (None, f"{name} has no {camera}.")
        return self._unclaimed(slot, camera, drawing, frame), name

    def _unclaimed(self, slot: int, camera: str, drawing: Drawing, frame: Frame) -> CompositeView | None:
        """Return what a camera sees of a robot that no client has: the one of that name, or the first."""
        robot = drawing.robots[slot]
        names = [mount.names[0] for mount in robot.cameras]
        index = names.index(camera) if camera in names else 0
        group, _ = self._world.scene.group_of(slot)
        lens = cameras_of(self._world.scene.groups[group].robot)[index]
        own = slice(robot.body, robot.body + robot.num_bodies)
        turns = Rotation.from_quat(frame.quat[own], scalar_first=True).as_matrix()
        bodies = BodyPoses(pos=frame.pos[own], mat=turns.astype(np.float32))
        fov = np.asarray(frame.robots[slot].fovs[index], np.float32)
        eye = camera_viewpoint(lens, bodies, np.array(slot, np.int32), fov)
        width = SIZE[0] - SIZE[0] % len(lens.eye_offsets)
        return CompositeView(SIZE, ((ViewpointRequest(eye, width, SIZE[1]), 0, 0),))
