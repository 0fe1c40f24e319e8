"""What every page has beside its picture: which world, what is drawn over it, and from where one looks."""

from typing import TYPE_CHECKING, Literal

import viser

from usarmjx.view.layers.base import Layer
from usarmjx.view.viewpoint import Onlooker, ViewMode

if TYPE_CHECKING:
    from usarmjx.view.page import ViewerPage

SIDE_BY_SIDE = "side by side"
NEXT, TOGGLE, FREE = "Next robot", "Over / camera", "Free"
ACTIONS: dict[str, Literal["N", "C", "F"]] = {NEXT: "N", TOGGLE: "C", FREE: "F"}
"""What can be done with a view, and the keys that do it."""


class WorldChoice:
    """Which world is shown; nothing where there is but one."""

    def __init__(self, page: "ViewerPage") -> None:
        self._page = page
        count = page.source.num_worlds
        if count < 2:
            return
        gui = page.server.gui
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
    """A switch for each layer.

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
                box.on_update(
                    lambda event, layer=layer: page.post(lambda: self.switch(layer, event.target.value))
                )
                self._boxes[layer.name] = box

    def turn_on(self, name: str) -> None:
        """Switch a layer on as by its box."""
        self._boxes[name].value = True

    def switch(self, layer: Layer, on: bool) -> None:
        """Switch a layer on or off."""
        others = [other for other in self.on if other is not layer]
        self.on = [*others, layer] if on else others
        layer.show(on)
        if on:
            layer.update(self._page.drawing, self._page.frame)


class ViewButtons:
    """Buttons and keys with which people attach their view to robots; each has a line that says to which."""

    def __init__(self, page: "ViewerPage") -> None:
        self._page = page
        self._captions: dict[int, tuple[str, viser.GuiMarkdownHandle]] = {}
        gui = page.server.gui
        self._folder = gui.add_folder("View")
        with self._folder:
            self._actions = gui.add_button_group(
                "Look", tuple(ACTIONS), hint="Click a robot too; keys N, C and F"
            )
        self._actions.on_click(lambda event: self._do(event.target.value, event.client_id))
        for name in ACTIONS:
            command = gui.add_command(name, hotkey=ACTIONS[name])
            command.on_trigger(lambda event, name=name: self._do(name, event.client_id))

    def update(self) -> None:
        """Tell everybody what they look at."""
        for number, onlooker in self._page.onlookers.items():
            text = self._caption(onlooker)
            known = self._captions.get(number)
            if known is None:
                with self._folder:
                    self._captions[number] = text, onlooker.client.gui.add_markdown(text)
            elif known[0] != text:
                known[1].content = text
                self._captions[number] = text, known[1]
        for number in self._captions.keys() - self._page.onlookers.keys():
            del self._captions[number]

    def _do(self, name: str, client: int | None) -> None:
        page = self._page

        def act() -> None:
            onlooker = None if client is None else page.onlookers.get(client)
            if onlooker is None:
                return
            if name == NEXT:
                onlooker.attach_next(page.drawing, page.frame)
                page.robot = onlooker.robot
            elif name == FREE:
                onlooker.free()
            else:
                onlooker.toggle()

        page.post(act)

    def _caption(self, onlooker: Onlooker) -> str:
        robot = self._page.drawing.robots.get(-1 if onlooker.robot is None else onlooker.robot)
        if robot is None:
            return "You look **freely**: drag to turn, scroll to come closer."
        over = onlooker.mode is ViewMode.OVER or not robot.cameras
        where = "over it" if over else f"through {robot.cameras[onlooker.camera].names[0]}"
        return f"You are with **{robot.name}** ({robot.robot}), {where}."
