"""What the person with the controls has for a world: pause, single step, speed, reset, and new robots."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import viser

from usarmjx.view.controls import StartPlace, WorldControls, WorldStatus
from usarmjx.view.drawing import Drawing

SPEEDS: dict[str, float] = {
    **{f"x {factor:g}": factor for factor in (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)},
    "as fast as it can": 0.0,
}
ELSEWHERE = "at x, y"
FIRST_CLASS = "P2AT"


class RunControls:
    """Pause, single step, speed and reset; they go where the present container of the GUI is.

    Args:
        client: Whose page.
        world: The number of the world.
        controls: What may be done to it.
        do: Does something if that person may.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        world: int,
        controls: WorldControls,
        do: Callable[[Callable[[], None]], None],
    ) -> None:
        self._client, self._world, self._controls, self._do = client, world, controls, do
        self._paused: bool | None = None
        gui = client.gui
        self._pause = gui.add_button("Pause")
        self._pause.on_click(lambda _: do(self._pause_or_go))
        gui.add_button("Single step", hint="One control step").on_click(lambda _: do(controls.step))
        self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="x 1")
        self._speed.on_update(lambda _: do(lambda: controls.set_speed(SPEEDS[self._speed.value])))
        gui.add_button("Reset", hint=controls.reset_about).on_click(lambda _: do(self._ask_reset))

    def update(self, status: WorldStatus) -> None:
        """Show whether the world stands still."""
        if status.paused != self._paused:
            self._paused = status.paused
            self._pause.label = "Go on" if status.paused else "Pause"

    def _pause_or_go(self) -> None:
        self._controls.pause(not self._controls.status(self._world).paused)

    def _ask_reset(self) -> None:
        modal = self._client.gui.add_modal("Reset the world?")
        with modal:
            self._client.gui.add_markdown(self._controls.reset_about)
            confirm = self._client.gui.add_button("Reset it", color="red")
            cancel = self._client.gui.add_button("Leave it")

        def done(_: object, confirmed: bool) -> None:
            modal.close()
            if confirmed:
                self._do(partial(self._controls.reset, self._world))

        confirm.on_click(partial(done, confirmed=True))
        cancel.on_click(partial(done, confirmed=False))


class SpawnForm:
    """A form for a new robot: its class, its name, and where; it goes where the present container is.

    Args:
        gui: Whose page.
        world: The number of the world.
        drawing: What it looks like.
        controls: What may be done to it.
        do: Does something if that person may.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        world: int,
        drawing: Drawing,
        controls: WorldControls,
        do: Callable[[Callable[[], None]], None],
    ) -> None:
        self._world, self._controls, self._floor = world, controls, drawing.floor
        self._starts: Sequence[StartPlace] = controls.starts(world)
        classes = tuple(controls.classes)
        self._class = gui.add_dropdown(
            "Class", classes, initial_value=FIRST_CLASS if FIRST_CLASS in classes else classes[0]
        )
        self._name = gui.add_text("Name", "", hint="Empty: one is found")
        places = (*(start.tag for start in self._starts), ELSEWHERE)
        self._place = gui.add_dropdown("Place", places, initial_value=places[0])
        middle = drawing.extent.mean(axis=1)
        self._xy = gui.add_vector2("x, y [m]", (float(middle[0]), float(middle[1])), step=0.1)
        self._height = gui.add_number(
            "Ground [m]", float(drawing.floor), step=0.1, hint="Height of the ground there"
        )
        self._yaw = gui.add_slider("Direction [deg]", -180, 180, 5, 0)
        self._place.on_update(lambda _: self._show_fields())
        self._show_fields()
        gui.add_button("Spawn").on_click(lambda _: do(self._spawn))

    def _show_fields(self) -> None:
        for field in (self._xy, self._height, self._yaw):
            field.visible = self._place.value == ELSEWHERE

    def _spawn(self) -> None:
        start = next((start for start in self._starts if start.tag == self._place.value), None)
        if start is None:
            x, y = self._xy.value
            pos, yaw = (float(x), float(y), float(self._height.value)), math.radians(self._yaw.value)
        else:
            pos, yaw = start.pos, start.yaw
        self._controls.spawn(self._world, self._class.value, self._name.value, pos, yaw)
