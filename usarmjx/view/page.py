"""The live page: worlds in three dimensions in a browser, by viser.

Viser's own page is one file. Here it gets our name, colours, a loading state and a place for the scoreboard:
viser serves a copy of it, with a script and a style sheet, from a folder of its own.
"""

import atexit
import logging
import shutil
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

import numpy as np
import rich
import viser
from viser import infra as viser_infra

from usarmjx.base.backend import numpy_backend
from usarmjx.view.drawing import Drawing, Frame, FrameSource
from usarmjx.view.layers import LAYERS
from usarmjx.view.layers.base import Layer
from usarmjx.view.scoreboard import ScoreboardPanel
from usarmjx.view.stage import GROUND_MARGIN, Stage, StagedWorld, grid_offsets
from usarmjx.view.viewpoint import (
    DIRECTION,
    FOV,
    ROWS_DIRECTION,
    CameraPose,
    Viewer,
    ViewMode,
    bounds_of,
    fit_box,
    robot_on_ray,
)

if TYPE_CHECKING:
    from usarmjx.view.controls import WorldControls


LABEL_SCRIPT = """
(() => {
 const GAP = 2, STEADY = 6, LIFTS = 3;  // pixels, pixels, and places of a text: its own and those above
 const PIXELS = 40;  // of the library's unit of texts of constant size
 const lifted = new Map();
 // The library draws a rectangle behind each text; these meshes have all of them.
 const boards = scene => {
  const found = [];
  scene.traverse(one => {
   const uniforms = one.material?.uniforms;
   if (uniforms?.uLabelData && !uniforms.uAtlas && one.geometry.attributes.aRect) found.push(one);
  });
  return found;
 };
 const texts = (meshes, places, view, scale) => {
  const found = [];
  for (const {geometry} of meshes) {
   const {aLabelIndex, aRect, aParams} = geometry.attributes;
   for (let i = 0; i < aLabelIndex.count; i++) {
    const id = aLabelIndex.array[i], at = 4 * id, [x, y, z, shown] = places.slice(at, at + 4);
    const depth = -(view[2] * x + view[6] * y + view[10] * z + view[14]);
    if (!shown || !aParams.array[2 * i] || depth <= 0) continue;
    const [left, low, width, tall] = aRect.array.slice(4 * i, 4 * i + 4).map(
     one => one * aParams.array[2 * i + 1] * PIXELS);
    found.push({
     id, at, depth, width, tall,
     left: (view[0] * x + view[4] * y + view[8] * z + view[12]) / depth * scale + left,
     low: (view[1] * x + view[5] * y + view[9] * z + view[13]) / depth * scale + low,
    });
   }
  }
  return found.sort((a, b) => Math.abs(a.tall - b.tall) > .01 ? b.tall - a.tall : a.depth - b.depth);
 };
 const arrange = (scene, camera) => {
  const meshes = boards(scene);
  if (!meshes.length) return;
  const {uLabelData, uViewportHeight} = meshes[0].material.uniforms, places = uLabelData.value.image.data;
  const view = camera.matrixWorldInverse.elements;
  const scale = camera.projectionMatrix.elements[5] * uViewportHeight.value / 2, kept = [];
  for (const one of texts(meshes, places, view, scale)) {
   const before = lifted.get(one.id) ?? 0;
   const fits = lift => {
    const gap = lift < before ? STEADY : GAP, low = one.low + lift * (one.tall + GAP);
    return !kept.some(other =>
     one.left < other.left + other.width + gap && other.left < one.left + one.width + gap &&
     low < other.low + other.tall + gap && other.low < low + one.tall + gap);
   };
   let lift = 0;
   while (lift < LIFTS && !fits(lift)) lift++;
   lifted.set(one.id, lift);
   if (lift === LIFTS) { places[one.at + 3] = 0; continue; }
   const up = lift * (one.tall + GAP) * one.depth / scale;
   for (let axis = 0; axis < 3; axis++) places[one.at + axis] += up * view[4 * axis + 1];
   one.low += lift * (one.tall + GAP);
   kept.push(one);
  }
  uLabelData.value.needsUpdate = true;
 };
 const wait = setInterval(() => {
  const scene = window.__viserMutable?.scene;
  if (!scene) return;
  clearInterval(wait);
  scene.onBeforeRender = (renderer, same, camera) => arrange(same, camera);
 }, 100);
})();
"""
"""Before each picture, a text that would cover another one moves up by a line or two, or is hidden.

Larger texts keep their places before smaller ones, near ones before distant ones. A version of the library
with other names shows all texts where they are.
"""
PRODUCT = "usarmjx"
MARK = "<title>Viser</title>"
"""Text of viser's page that we replace; a version without it is served as it is."""
LIBRARY, HELD = "<script data-p=", '<script type="text/held" data-p='
"""Start of viser's script of 3 MB, and that of one which waits until ours runs it."""
BACKGROUND = "#e9eef2"
"""Colour of the page before anything is drawn, near that of the sky."""
ICON = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'%3E"
    "%3Crect width='32' height='32' rx='7' fill='%231f5fa8'/%3E%3Cpath d='M7 21h18l-3-9H10z' fill='white'/%3E"
    "%3Ccircle cx='11' cy='23' r='4' fill='%23ffc400'/%3E%3Ccircle cx='21' cy='23' r='4' fill='%23ffc400'/%3E"
    "%3C/svg%3E"
)
STYLE = """
html,body,#root>div,#root div[style*="background-color: rgb(255, 255, 255)"]{
 background:BACKGROUND!important;margin:0}
#root canvas{opacity:1!important}
#usarmjx-loading{position:fixed;inset:0;z-index:9999;display:flex;flex-direction:column;gap:.6em;
 align-items:center;justify-content:center;background:BACKGROUND;color:#23303d;
 font:600 1.6rem system-ui,sans-serif;transition:opacity .25s}
#usarmjx-loading small{font-weight:400;font-size:1rem;opacity:.75}
#usarmjx-head{position:fixed;top:.7em;left:.7em;z-index:9;width:max-content;max-width:calc(100vw - 1.4em);
 background:rgba(20,24,30,.82);color:#fff;border-radius:.5em;padding:.5em .8em;
 font:clamp(11.5px,.98vw,16px)/1.35 system-ui,sans-serif;max-height:38vh;overflow:auto;
 scrollbar-width:thin;scrollbar-color:#fff6 transparent}
#usarmjx-head:has(details[open]){max-height:calc(100vh - 6em)}
#usarmjx-head summary{font-weight:600;cursor:pointer}
#usarmjx-head table{border-collapse:collapse;margin-top:.4em;width:100%}
#usarmjx-head td,#usarmjx-head th{padding:.05em .7em .05em 0;white-space:nowrap;text-align:left}
#usarmjx-head td:first-child{opacity:.85}
#usarmjx-head th{font-weight:400;font-size:.85em;opacity:.65}
#usarmjx-head i{display:inline-block;width:.7em;height:.7em;border-radius:50%;margin-right:.45em}
#usarmjx-head b{display:inline-block;width:3em;height:.5em;background:#fff4;border-radius:.25em}
#usarmjx-head s{display:block;height:100%;border-radius:.25em}
#usarmjx-head ul{list-style:none;margin:.4em 0 0;padding:0;opacity:.9}
#usarmjx-head details{margin-top:.4em}
#usarmjx-head details summary{font-weight:400;opacity:.85}
.usarmjx-board{display:none}
.mantine-Notifications-root[data-position]{top:auto!important;bottom:1em}
button:has(.tabler-icon-adjustments){display:none!important}
@media (max-width:36em){
 [style*="max-height: 60%"],[style*="max-height: 60%"] [style*="width: 20em"]{width:100%!important}
 #usarmjx-head{font-size:12px;max-height:45vh}
 .mantine-Notifications-root[data-position]{bottom:4.5em}
}
"""
SCRIPT = """
(() => {
 const page = document.documentElement, phone = matchMedia('(max-width:36em)').matches;
 const wait = page.appendChild(document.createElement('div'));
 wait.id = 'usarmjx-loading';
 wait.innerHTML = 'PRODUCT<small>loading the world ...</small>';
 const PATIENCE = 20000, begun = performance.now();
 // The library's script keeps a browser busy for a second: it waits until the loading state is on the screen.
 const run = () => {
  const held = document.querySelector('script[type="text/held"]');
  if (!held) return;
  const script = document.createElement('script');
  Object.assign(script.dataset, held.dataset);
  script.textContent = held.textContent;
  held.replaceWith(script);
 };
 addEventListener('DOMContentLoaded', () => {
  requestAnimationFrame(() => setTimeout(run));
  setTimeout(run, 500);  // a window behind others draws nothing
 });
 // The library has its scene under these names, for tests of its own; without them time decides.
 const drawn = () => {
  const scene = window.__viserMutable?.scene, info = window.__viserTestpoints?.rendererInfo;
  let solids = 0;
  scene?.traverse(one => { if (one.isInstancedMesh || one.isInstancedMesh2) solids++; });
  return {solids, frames: info?.render.frame ?? 0};
 };
 let before = {solids: 0, frames: 0}, first = -1;
 const look = setInterval(() => {
  const now = drawn();
  if (now.solids > 0 && first < 0) first = now.frames;
  const whole = first >= 0 && now.frames > first && now.solids === before.solids;
  before = now;
  if (!whole && performance.now() - begun < PATIENCE) return;
  clearInterval(look);
  wait.style.opacity = 0;
  setTimeout(() => wait.remove(), 250);
 }, 100);
 let head, shut = false, told = false;
 const fill = (place, text) => { if (place.innerHTML !== text) place.innerHTML = text; };
 const show = board => {
  if (!head) {
   head = document.body.appendChild(document.createElement('details'));
   head.id = 'usarmjx-head';
   head.open = !phone;
   head.innerHTML = '<summary></summary><div></div><details><summary>legend</summary><div></div></details>';
  }
  const name = 'PRODUCT \\u00b7 ' + board.dataset.world;
  if (document.title !== name) document.title = head.firstChild.textContent = name;
  fill(head.children[1], board.firstChild.innerHTML);
  fill(head.lastChild.lastChild, board.lastChild.innerHTML);
  head.lastChild.hidden = !board.lastChild.childElementCount;
 };
 new MutationObserver(() => {
  const board = document.querySelector('.usarmjx-board');
  if (board) show(board);
  if (head) head.hidden = !board;  // a panel that is folded away has none, so nothing old stays
  if (phone && !shut && board) {
   const sheet = document.querySelector('[style*="max-height: 60%"] [style*="cursor: pointer"]');
   if (sheet) { shut = true; sheet.click(); }
  }
  if (!told) for (const one of document.querySelectorAll('.mantine-Notification-root')) {
   if (!one.textContent.startsWith('Software WebGL')) continue;
   told = true;
   setTimeout(() => one.querySelector('button')?.click(), 8000);
  }
 }).observe(page, {subtree: true, childList: true, characterData: true});
})();
"""


def page_text(original: str) -> str:
    """Return viser's page with our head; one that is not as known stays as it is."""
    # Another version of viser: its own page is better than a half changed one.
    if MARK not in original:
        return original
    style = STYLE.replace("BACKGROUND", BACKGROUND)
    script = SCRIPT.replace("PRODUCT", PRODUCT) + LABEL_SCRIPT
    head = f"<title>{PRODUCT}</title><style>{style}</style><script>{script}</script>"
    before, _, after = original.partition(MARK)
    # Written as in viser's file; a version with another line keeps its icon.
    first, _, rest = before.partition('<link\n      rel="icon"')
    if rest:
        before = f'{first}<link rel="icon" href="{ICON}" />' + rest.partition("/>")[2]
    # The script becomes a text that browsers do not run, until ours puts it in as a script.
    return before + head + after.replace(LIBRARY, HELD, 1)


@cache
def page_folder() -> Path:
    """Return the folder with the page, which goes when the program ends."""
    original = Path(viser.__file__).parent / "client" / "build" / "index.html"
    folder = Path(tempfile.mkdtemp(prefix="usarmjx-page-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "index.html").write_text(page_text(original.read_text(encoding="utf-8")), encoding="utf-8")
    return folder


log = logging.getLogger(__name__)

SIDE_BY_SIDE = "side by side"
NEXT, TOGGLE, FREE = "Next robot", "Over / camera", "Free"
ACTIONS: dict[str, Literal["N", "C", "F"]] = {NEXT: "N", TOGGLE: "C", FREE: "F"}
"""Actions of a view, and their keys."""
UPDATE_PERIOD = 1 / 20
"""Least interval between two updates of the page [s]."""
MAX_SIDE_BY_SIDE = 16
"""Most worlds side by side."""
WORLDS_AT_ONCE = 4
"""Worlds side by side that one update refreshes, in turn, beside the chosen one."""
NEAREST, NEAR_LIMITS = 1e-3, (0.02, 0.2)
"""Near plane as a share of the first view's distance, and its least and largest value [m]."""
BOARD_SHARE, BOARD_ASPECT = (0.25, 0.38), 0.8
"""Shares of a picture's width and height that the scoreboard covers, and aspect below which it is closed."""
NEW_ASPECT = 0.02
"""Change of a picture's aspect from which the first view is fitted again."""
OVER_PATH = "/over"
"""Root node of the layers, which moves to the chosen world."""
_start_lock = threading.Lock()
"""Viser's start sets a global console quiet: two starts at once would disturb each other."""


class WorldChoice:
    """Dropdown of the shown world; absent for a single world."""

    def __init__(self, page: "ViewerPage") -> None:
        self._page = page
        count = page.source.num_worlds
        if count < 2:
            return
        gui = page.server.gui
        # The page begins with world 0, so that is the value here.
        options = [SIDE_BY_SIDE, *(f"world {number}" for number in range(count))]
        self._choice = gui.add_dropdown(
            "World", options, initial_value=options[1], hint="Which world to look at"
        )
        self._choice.on_update(lambda _: page.post(self._chosen))

    def _chosen(self) -> None:
        value, page = self._choice.value, self._page
        if value == SIDE_BY_SIDE:
            page.choose_world(page.world, wall=True)
        else:
            page.choose_world(int(value.split()[1]))


class LayerSwitches:
    """Checkbox of each layer.

    Attributes:
        on: The layers that are on.
    """

    def __init__(self, page: "ViewerPage") -> None:
        self._page = page
        self.on = [layer for layer in page.layers.values() if layer.shown_at_first]
        self._boxes: dict[str, viser.GuiCheckboxHandle] = {}
        if not page.layers:
            return
        gui = page.server.gui
        with gui.add_folder("Show", expand_by_default=False):
            for layer in page.layers.values():
                box = gui.add_checkbox(layer.name, layer.shown_at_first, hint=layer.about)
                # Bound as a default: the loop's variable has moved on when the box is clicked.
                box.on_update(
                    lambda event, layer=layer: page.post(lambda: self.switch(layer, event.target.value))
                )
                self._boxes[layer.name] = box

    def turn_on(self, name: str) -> None:
        """Check a layer's box."""
        self._boxes[name].value = True

    def switch(self, layer: Layer, on: bool) -> None:
        """Show or hide a layer."""
        others = [other for other in self.on if other is not layer]
        self.on = [*others, layer] if on else others
        layer.show(on)
        if on:
            # A layer that is off misses frames, and would show an old one until the next update.
            layer.update(self._page.drawing, self._page.frame)


CAPTION_OFFSET = 0.05
"""Sort key of a caption after that of the buttons of views."""


class ViewButtons:
    """Buttons and keys that attach a user's view to robots, and a caption of the present view."""

    def __init__(self, page: "ViewerPage") -> None:
        self._page = page
        self._captions: dict[int, tuple[str, viser.GuiMarkdownHandle]] = {}
        gui = page.server.gui
        self._folder = gui.add_folder("View")
        with self._folder:
            self._actions = gui.add_button_group(
                "Look", tuple(ACTIONS), hint="Click a robot too; keys N, C and F"
            )
        # The buttons are the server's, for all users: each acts on the view of the one who clicked.
        self._actions.on_click(lambda event: self._do(event.target.value, event.client_id))
        for name in ACTIONS:
            command = gui.add_command(name, hotkey=ACTIONS[name])
            command.on_trigger(lambda event, name=name: self._do(name, event.client_id))

    def update(self) -> None:
        """Update each user's caption."""
        for number, viewer in self._page.viewers.items():
            text = self._caption(viewer)
            known = self._captions.get(number)
            if known is None:
                # Not in the folder: that is the server's, and would keep those of users who have just left.
                caption = viewer.client.gui.add_markdown(text, order=self._folder.order + CAPTION_OFFSET)
                self._captions[number] = text, caption
            elif known[0] != text:
                known[1].content = text
                self._captions[number] = text, known[1]
        for number in self._captions.keys() - self._page.viewers.keys():
            del self._captions[number]

    def _do(self, name: str, client: int | None) -> None:
        page = self._page

        # Looked up when it runs: the user may have left until then.
        def act() -> None:
            viewer = None if client is None else page.viewers.get(client)
            if viewer is None:
                return
            if name == NEXT:
                page.attach_next(viewer)
            elif name == FREE:
                viewer.free()
            else:
                viewer.toggle()

        page.post(act)

    def _caption(self, viewer: Viewer) -> str:
        robot = self._page.drawing.robots.get(-1 if viewer.robot is None else viewer.robot)
        if robot is None:
            return "You look **freely**: drag to turn, scroll to come closer."
        over = viewer.mode is ViewMode.OVER or not robot.cameras
        where = "over it" if over else f"through {robot.cameras[viewer.camera].names[0]}"
        return f"You are with **{robot.name}** ({robot.robot}), {where}."


class Panel(Protocol):
    """Part of the page's sidebar."""

    def begin(self, drawing: Drawing) -> None:
        """Start with a new drawing: another world, or other robots."""
        ...

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the present frame of the world."""
        ...


class LocalViserServer(viser.ViserServer):
    """A server that does not share its page: viser would send it through a public server on request."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Do nothing."""
        del verbose
        return None


def make_viser_server(host: str, port: int) -> viser.ViserServer:
    """Return a listening server.

    Args:
        host: Address to listen on.
        port: Port to listen on; 0: a free one.
    """
    with _start_lock:
        rich.get_console().quiet = True  # viser prints its address to the terminal, in a frame
        plain = viser_infra.WebsockServer

        def with_our_page(**options: Any) -> viser_infra.WebsockServer:  # noqa: ANN401 - viser's
            options["http_server_root"] = page_folder()
            return plain(**options)

        # Viser serves its own page, and takes no other folder.
        viser_infra.WebsockServer = with_our_page  # type: ignore[assignment, misc]
        try:
            return LocalViserServer(host, port, verbose=False)
        finally:
            viser_infra.WebsockServer = plain  # type: ignore[misc]


PanelMaker: TypeAlias = Callable[["ViewerPage"], Panel]
"""Makes a panel for a page."""


class ViewerPage:
    """A page that shows worlds; several users may watch it at once.

    The shown world and the layers are the same for all; each user has a viewpoint of their own.
    All methods but the constructor are for the thread that runs the worlds. Users' actions come
    in threads of viser's and wait in `post` for the next update.

    Args:
        source: Source of drawings and frames.
        host: Address to listen on.
        port: Port to listen on; 0: a free one.
        title: Title of the page.
        controls: Controls of the worlds; None: they are only shown.
        panels: Makers of the sidebar's panels.
        server: Server of the page; None for one of its own.

    Attributes:
        server: Viser's server.
        title: Title of the page.
        source: Source of drawings and frames.
        controls: Controls of the worlds.
        world: Number of the chosen world.
        wall: Whether others are shown beside it.
        drawing: Its drawing.
        frame: Its last frame.
        robot: Slot of the robot that any user chose last.
        viewers: Users of the page, by viser's client numbers.
        layers: Layers over the world, by name.
        after_last: Called when a user goes on from the last robot; shows a picture of all of them and returns
            True, or returns False: the first robot follows.
    """

    def __init__(
        self,
        source: FrameSource,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        title: str = "",
        controls: "WorldControls | None" = None,
        panels: Sequence[PanelMaker] = (),
        server: viser.ViserServer | None = None,
    ) -> None:
        self.server = server or make_viser_server(host, port)
        self.source, self.controls, self.world, self.wall = source, controls, 0, False
        self.robot: int | None = None
        self.viewers: dict[int, Viewer] = {}
        self.layers: dict[str, Layer] = {name: make() for name, make in LAYERS}
        self.after_last: Callable[[], bool] = lambda: False
        # Appending and popping at the ends of a deque need no lock between threads.
        self._posted: deque[Callable[[], None]] = deque()
        self._next_update, self._turn = 0.0, 0
        self._frames: list[Frame] = []
        self._over = self.server.scene.add_frame(OVER_PATH, show_axes=False)
        self._stage = Stage(self.server.scene)
        self.drawing: Drawing = source.drawing(self.world)
        self.frame: Frame = source.frame(self.world)
        self.title = title
        self.server.gui.set_panel_label(f"{PRODUCT} \u00b7 {title}" if title else PRODUCT)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        # A docked panel leaves the rest of the window to the picture, so that nothing lies behind it.
        self.server.gui.main_panel.dock_right()
        # The order of these is that of the sidebar.
        self._worlds = WorldChoice(self)
        self._buttons = ViewButtons(self)
        self.panels: list[Panel] = [*(make(self) for make in panels), ScoreboardPanel(self)]
        self._switches = LayerSwitches(self)
        with numpy_backend():
            self._begin(self._drawings())
        self.server.on_client_connect(self._on_connect)
        self.server.on_client_disconnect(self._on_disconnect)
        self.server.scene.on_click()(self._on_click)
        self.server.scene.on_click(modifier="shift")(self._on_shift_click)

    def update(self) -> None:
        """Show the present frames, at most once in `UPDATE_PERIOD`."""
        now = time.monotonic()
        if now < self._next_update:
            return
        self._next_update = now + UPDATE_PERIOD
        if self.is_watched:
            self.refresh()

    @property
    def is_watched(self) -> bool:
        """Whether a user watches, or has just come or gone."""
        # Without users, nothing is fetched from the device and nothing is drawn.
        return bool(self._posted or self.server.get_clients())

    def refresh(self) -> None:
        """Show the present frames at once."""
        # One group of messages, so that browsers never draw half an update.
        with numpy_backend(), self.server.atomic():
            # Actions first: they may choose another world, which is drawn below.
            while self._posted:
                self._guarded(self._posted.popleft())
            drawings = self._drawings()
            shown = [cell.drawing for cell in self._stage.cells]
            # By identity: a source makes a new drawing only when something has changed.
            if len(drawings) != len(shown) or any(a is not b for a, b in zip(drawings, shown, strict=True)):
                self._begin(drawings)
            self._take_frames()
            self._stage.update(self._frames)
            for layer in self._switches.on:
                self._guarded(lambda layer=layer: layer.update(self.drawing, self.frame))
            for panel in self.panels:
                self._guarded(lambda panel=panel: panel.update(self.drawing, self.frame))
        self._buttons.update()
        for viewer in list(self.viewers.values()):
            self._guarded(lambda viewer=viewer: viewer.update(self.drawing, self.frame, self._cell.offset))
            # The picture gets narrower when the panel docks beside it, and on a phone that is turned. A slow
            # browser may go to the page's initial camera after it has got the view of its user.
            other_shape = abs(viewer.client.camera.aspect / viewer.aspect - 1) > NEW_ASPECT
            if viewer.is_untouched and (other_shape or not viewer.is_fitted):
                self._frame_all(viewer)

    def close(self) -> None:
        """Disconnect all users and free the port; panels with a `close` are closed, too."""
        for panel in self.panels:
            # `Panel` demands no such method: most panels hold nothing.
            getattr(panel, "close", lambda: None)()
        self.server.stop()

    def post(self, action: Callable[[], None]) -> None:
        """Queue an action for the next update; for all threads."""
        self._posted.append(action)

    def choose_world(self, world: int, wall: bool = False) -> None:
        """Show another world, or several side by side of which it is the chosen one."""
        self.world, self.wall = world, wall
        self._begin(self._drawings())
        for viewer in list(self.viewers.values()):
            viewer.free()
            self._frame_all(viewer)

    def choose_robot(self, client: int, robot: int | None) -> None:
        """Attach a user's view to a robot, or free it."""
        viewer = self.viewers.get(client)
        if viewer is None:
            return
        if robot is None:
            viewer.free()
        else:
            viewer.attach(robot)
            self.robot = robot

    def attach_next(self, viewer: Viewer) -> None:
        """Attach a user's view to the next robot; after the last one, free it for what `after_last` shows."""
        last = max(self.drawing.robots.keys() & self.frame.robots.keys(), default=None)
        if viewer.robot is not None and viewer.robot == last and self.after_last():
            viewer.free()
        else:
            viewer.attach_next(self.drawing, self.frame)
        self.robot = viewer.robot

    @property
    def layers_on(self) -> list[Layer]:
        """The layers that are shown."""
        return list(self._switches.on)

    def show_layers(self, names: Sequence[str]) -> None:
        """Show layers, for all users.

        Raises:
            UnknownNameError: There is none of that name; lists those there are.
        """
        for name in names:
            self._switches.turn_on(LAYERS.get(name).name)

    def first_pose(self, aspect: float = 1.6) -> CameraPose:
        """Return the pose from which all shown worlds fill a picture of some aspect."""
        bounds = [np.array(bounds_of(cell.drawing)) + cell.offset for cell in self._stage.cells]
        low, high = np.min(bounds, axis=0)[0], np.max(bounds, axis=0)[1]
        several = len(self._stage.cells) > 1
        if several:
            low = low - (0.0, GROUND_MARGIN, 0.0)  # there are the names
        corner = BOARD_SHARE if aspect > BOARD_ASPECT else (0.0, 0.0)
        return fit_box(low, high, aspect, corner, ROWS_DIRECTION if several else DIRECTION)

    @property
    def _cell(self) -> StagedWorld:
        """Stage cell of the chosen world."""
        return self._stage.cells[self._numbers().index(self.world)]

    def _numbers(self) -> list[int]:
        """Return the numbers of the worlds on the stage."""
        if not self.wall:
            return [self.world]
        # Whole pages of worlds: choosing a neighbour keeps the same ones on the stage.
        first = self.world // MAX_SIDE_BY_SIDE * MAX_SIDE_BY_SIDE
        return list(range(first, min(first + MAX_SIDE_BY_SIDE, self.source.num_worlds)))

    def _drawings(self) -> list[Drawing]:
        return [self.source.drawing(number) for number in self._numbers()]

    def _begin(self, drawings: Sequence[Drawing]) -> None:
        """Show other drawings."""
        numbers = self._numbers()
        offsets = grid_offsets(drawings) if self.wall else [np.zeros(3)]
        names = [f"world {number}" for number in numbers]
        self._stage.begin([StagedWorld(*one) for one in zip(drawings, offsets, names, strict=True)])
        self._frames = [self.source.frame(number) for number in numbers]
        self.drawing, self.frame = self._cell.drawing, self._frames[numbers.index(self.world)]
        self._stage.update(self._frames)
        if self.robot not in self.drawing.robots:
            self.robot = None
        # Layers draw in the world's own coordinates, below this node.
        self._over.position = self._cell.offset
        # Layers that are off, too: one that is switched on later must know the drawing.
        for layer in self.layers.values():
            layer.alone = len(drawings) == 1
            self._guarded(lambda layer=layer: layer.begin(self.server.scene, self.drawing, OVER_PATH))
        for panel in self.panels:
            self._guarded(lambda panel=panel: panel.begin(self.drawing))
        camera, pose = self.server.initial_camera, self.first_pose()
        camera.position, camera.look_at, camera.fov = pose.pos, pose.look_at, FOV
        # A distant near plane gives the depth buffer more resolution: far surfaces flicker otherwise.
        camera.near = float(np.clip(np.linalg.norm(pose.pos - pose.look_at) * NEAREST, *NEAR_LIMITS))

    def _take_frames(self) -> None:
        """Fetch the frame of the chosen world, and of some beside it."""
        numbers = self._numbers()
        chosen = numbers.index(self.world)
        others = [n for n in range(len(numbers)) if n != chosen]
        now = (
            {others[(self._turn + n) % len(others)] for n in range(WORLDS_AT_ONCE)} if others else set[int]()
        )
        self._turn += WORLDS_AT_ONCE
        # The others in turn: fetching all frames at each update would take time from the worlds' steps.
        for n in {chosen, *now}:
            self._frames[n] = self.source.frame(numbers[n])
        self.frame = self._frames[chosen]

    def _guarded(self, action: Callable[[], None]) -> None:
        """Run an action whose failure must not stop the world."""
        try:
            action()
        except Exception:
            log.exception("a part of the page could not be brought up to date")

    def _on_connect(self, client: viser.ClientHandle) -> None:
        def join() -> None:
            # viser calls this in a thread of its own: who stays briefly may have left, and not leave again.
            if client.client_id not in self.server.get_clients():
                return
            self.viewers[client.client_id] = viewer = Viewer(client)
            # The browser begins at this camera: that is no move of its user's.
            viewer.framed.append(np.asarray(self.server.initial_camera.position))
            self._frame_all(viewer)

        self.post(join)

    def _on_disconnect(self, client: viser.ClientHandle) -> None:
        self.post(lambda: self.viewers.pop(client.client_id, None) and None)

    def _frame_all(self, viewer: Viewer) -> None:
        """Let a user see all shown worlds."""
        aspect = viewer.client.camera.aspect
        viewer.frame(self.first_pose(aspect), aspect)

    def _on_click(self, event: viser.SceneClickEvent) -> None:
        """Attach the view to the robot under the pointer, or to the next one."""

        def attach() -> None:
            viewer = self.viewers.get(event.client_id)
            if viewer is None:
                return
            # The ray is in the stage's coordinates, frames are in the world's.
            start = np.array(event.ray_origin) - self._cell.offset
            robot = robot_on_ray(self.drawing, self.frame, start, np.array(event.ray_direction))
            if robot is None:
                self.attach_next(viewer)
            else:
                viewer.attach(robot)
                self.robot = robot

        self.post(attach)

    def _on_shift_click(self, event: viser.SceneClickEvent) -> None:
        self.post(lambda: self.choose_robot(event.client_id, None))
