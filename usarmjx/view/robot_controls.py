"""Controls of one robot for the user with the page's controls: a pad, sliders, switches, and taking over."""

import html
import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import viser

from usarmjx.models.compile.parts import part_name, parts_of
from usarmjx.models.drives.base import can_climb, drive_values
from usarmjx.models.effecters import effecters_of
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import Part, RobotSpec
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.view.controls import BY_PAGE, StartPoseChoice, WorldControls, WorldStatus
from usarmjx.view.drawing import Drawing, DrawnRobot, Frame

PIXEL = "data:image/gif;base64,R0lGODlhAQABAIAAAAAAAP///yH5BAEAAAAALAAAAAABAAEAAAIBRAA7"
"""A picture of one transparent pixel."""
PRESS_PERIOD = 300
"""Interval at which a page presses the button of a receipt [ms]."""
HOLD_RATE = 10.0
"""Rate of the page's messages while a button is held down [Hz]."""
HOLD_TIMEOUT = 0.35
"""Time without a message after which a direction counts as released [s]."""
DIRECTIONS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "ahead": ("\u25b2", ("ArrowUp", "KeyW"), "1 / 2"),
    "left": ("\u25c0", ("ArrowLeft", "KeyA"), "2 / 1"),
    "right": ("\u25b6", ("ArrowRight", "KeyD"), "2 / 3"),
    "back": ("\u25bc", ("ArrowDown", "KeyS"), "2 / 2"),
    "up": ("\u21e7", ("KeyR",), "1 / 4"),
    "down": ("\u21e9", ("KeyF",), "2 / 4"),
}
"""Sign, keys and grid area of each direction."""
CLIMBING = ("up", "down")
POINTER = 4242
"""Number of the synthetic pointer that holds the buttons down; no real pointer has it."""
SPEEDS: dict[str, float] = {
    **{f"x {factor:g}": factor for factor in (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)},
    "as fast as it can": 0.0,
}
"""Choices of speed, in simulated seconds per second; 0: as many as possible."""
ELSEWHERE = "at x, y"
"""Choice of a pose that is no start pose."""
FIRST_CLASS = "P2AT"
"""Robot class that the form begins with."""
HIDDEN_OPCODES = ("nop",)
"""Operations of effecters that have no button."""


def element_id(button: viser.GuiButtonHandle) -> str:
    """Return the id of a button in the page."""
    # Viser has no public name for the id that its page gives an element.
    return str(button._impl.uuid)  # pyright: ignore[reportPrivateUsage, reportUnknownMemberType]


def hidden_style(*buttons: str) -> str:
    """Return the style that hides buttons which scripts press, by their ids."""
    return ",".join(f'div:has(> [id="{button}"])' for button in buttons) + "{display:none}"


def receipt_html(button: str) -> str:
    """Return an invisible picture that presses a button, by its id, until that is gone.

    Viser's page sends one message in 50 ms, and only the last of those that wait: a single press may be lost.
    """
    press = (
        f"{{const press=()=>{{const b=document.getElementById('{button}');"
        f"if(b){{b.click();setTimeout(press,{PRESS_PERIOD})}}}};press()}}"
    )
    return f'<style>{hidden_style(button)}</style><img hidden alt="" src="{PIXEL}" onload="{press}">'


def when_taken(
    client: viser.ClientHandle, post: Callable[[Callable[[], None]], None], act: Callable[[], None]
) -> None:
    """Run an action once a user's browser has taken all that it was sent before.

    A browser that is slow, or behind another window, takes messages late.

    Args:
        client: Client of the user; no container of its GUI is open.
        post: Queues an action for the thread of the caller.
        act: The action; it runs once, or never if the user leaves.
    """
    parts: list[viser.GuiButtonHandle | viser.GuiHtmlHandle] = []

    def done() -> None:
        if parts:  # a panel that is folded and unfolded shows the picture again
            for part in parts:
                part.remove()
            parts.clear()
            act()

    with client.atomic():  # the button is never seen without its style
        button = client.gui.add_button("taken")
        button.on_click(lambda _: post(done))
        parts += [button, client.gui.add_html(receipt_html(element_id(button)))]


class DrivePad:
    """Direction pad of one user; its elements go into the present container of the GUI.

    Args:
        gui: The user's GUI.
        steer: Function of ahead, left and up [-1, 1], called again and again while any direction is held,
            and with 0, 0, 0 after the last release; in viser's thread.
        climbs: Whether there are buttons for up and down.
    """

    def __init__(
        self, gui: viser.GuiApi, steer: Callable[[float, float, float], None], *, climbs: bool = False
    ) -> None:
        self._steer = steer
        self._held: dict[str, float] = {}
        names = [name for name in DIRECTIONS if climbs or name not in CLIMBING]
        buttons = {name: gui.add_button(f"drive {name}") for name in names}
        for name, button in buttons.items():
            self._listen(name, button)
        # The pad's own buttons press viser's hidden ones, which have no other name in the page than this id.
        gui.add_html(pad_html({name: element_id(button) for name, button in buttons.items()}))

    def _listen(self, name: str, button: viser.GuiButtonHandle) -> None:
        # Viser runs coroutines in order; plain callbacks go to a thread pool, where a release may overtake.
        async def hold(event: object) -> None:
            del event
            self.hold(name, time.monotonic())

        async def release(event: object) -> None:
            del event
            self.release(name, time.monotonic())

        button.on_hold(hold, callback_hz=HOLD_RATE)  # pyright: ignore[reportUnknownMemberType]
        button.on_click(release)

    def hold(self, name: str, now: float) -> None:
        """Record that a direction is held down at a time [s]."""
        # With its time: a direction lapses when no message confirms it.
        self._held[name] = now
        self._send(now)

    def release(self, name: str, now: float) -> None:
        """Record that a direction is released."""
        if self._held.pop(name, None) is not None:
            self._send(now)

    def _send(self, now: float) -> None:
        # A release may be lost with its message: a direction that nobody confirms any more counts as
        # released.
        self._held = {name: since for name, since in self._held.items() if now - since < HOLD_TIMEOUT}
        held = self._held.keys()
        self._steer(
            float(("ahead" in held) - ("back" in held)),
            float(("left" in held) - ("right" in held)),
            float(("up" in held) - ("down" in held)),
        )


def pad_html(buttons: Mapping[str, str]) -> str:
    """Return the HTML of the pad.

    Args:
        buttons: Ids of viser's buttons in the page, by direction.
    """
    keys = {code: buttons[name] for name in buttons for code in DIRECTIONS[name][1]}
    arrows = "".join(map(partial(_arrow, buttons), buttons))
    letters = "W A S D" + (", R and F for up and down" if "up" in buttons else "")
    on_key = (
        f"const k={_object(keys)}[event.code];"
        f"if(k){{event.preventDefault();event.stopPropagation();if(!event.repeat){{{_hold('k')}}}}}"
    )
    return (
        f"<style>{hidden_style(*buttons.values())}"
        f".drivepad{{grid-template-columns:repeat({4 if 'up' in buttons else 3},3.2em)}}"
        ".drivepad{display:grid;grid-auto-rows:3.2em;gap:.3em;"
        "justify-content:center;padding:.4em;margin:0 .6em .5em;border-radius:.5em;outline:1px solid #8888;"
        "touch-action:none;user-select:none;-webkit-user-select:none}"
        ".drivepad:focus{outline:2px solid #4a90e2}"
        ".drivepad button{font-size:1.4em;border:0;border-radius:.4em;background:#8883;color:inherit;"
        "touch-action:none}.drivepad button:active{background:#4a90e2}"
        ".drivepad small{grid-column:1 / -1;align-self:center;text-align:center;opacity:.7}</style>"
        f'<div class="drivepad" tabindex="0" aria-label="drive" '
        f'onkeydown="{_quoted(on_key)}">'
        f"{arrows}<small>Hold an arrow; or click here and hold arrow keys or {letters}.</small></div>"
    )


def _arrow(buttons: Mapping[str, str], name: str) -> str:
    sign, _, area = DIRECTIONS[name]
    press = "event.preventDefault();this.parentNode.focus();this.setPointerCapture(event.pointerId);" + _hold(
        repr(buttons[name])
    )
    return (
        f'<button tabindex="-1" aria-label="{name}" style="grid-area:{area}" '
        f'onpointerdown="{_quoted(press)}" oncontextmenu="event.preventDefault()">{sign}</button>'
    )


def _hold(button: str) -> str:
    """Return the script that holds a button down until the key or pointer of the event is released.

    The window listens for the release: React makes the pad's elements anew whenever anything joins their
    folder, and ignores events meanwhile. Viser's page sends one message in 50 ms, and only the last of those
    that wait: a button that is not held sends none.
    """
    return (
        f"const b=document.getElementById({button});"
        f"if(b&&!b.held){{b.held=true;b.dispatchEvent({_pointer('pointerdown')});"
        "const ends=['keyup','pointerup','pointercancel','blur'],end=e=>{"
        "if(e.type==='blur'?e.target!==window:"
        "e.type==='keyup'?e.code!==event.code:e.pointerId!==event.pointerId)return;"
        "for(const kind of ends)window.removeEventListener(kind,end,true);"
        f"b.held=false;b.dispatchEvent({_pointer('pointerup')});b.click()}};"
        "for(const kind of ends)window.addEventListener(kind,end,true)}"
    )


def _pointer(kind: str) -> str:
    return f"new PointerEvent('{kind}',{{bubbles:true,button:0,pointerId:{POINTER}}})"


def _object(pairs: Mapping[str, str]) -> str:
    return "({" + ",".join(f"{key}:{value!r}" for key, value in pairs.items()) + "})"


def _quoted(script: str) -> str:
    return html.escape(script, quote=True)


class RunControls:
    """Pause, single step, speed and reset; they go into the present container of the GUI.

    Args:
        client: Client of the user.
        world: The number of the world.
        controls: Controls of the worlds.
        do: Runs an action if the user has the controls.
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
        """Show whether the world is paused."""
        if status.paused != self._paused:
            self._paused = status.paused
            self._pause.label = "Go on" if status.paused else "Pause"

    def _pause_or_go(self) -> None:
        # From the world and not from the button's label, which shows the last update.
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
                # Asked again: another user may have got the controls while the question was open.
                self._do(partial(self._controls.reset, self._world))

        confirm.on_click(partial(done, confirmed=True))
        cancel.on_click(partial(done, confirmed=False))


class SpawnForm:
    """Form for a new robot: class, name and pose; it goes into the present container of the GUI.

    Args:
        gui: GUI of the user.
        world: The number of the world.
        drawing: Its drawing.
        controls: Controls of the worlds.
        do: Runs an action if the user has the controls.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        world: int,
        drawing: Drawing,
        controls: WorldControls,
        do: Callable[[Callable[[], None]], None],
    ) -> None:
        self._world, self._controls = world, controls
        self._starts: Sequence[StartPoseChoice] = controls.starts(world)
        classes = tuple(controls.classes)
        self._class = gui.add_dropdown(
            "Class", classes, initial_value=FIRST_CLASS if FIRST_CLASS in classes else classes[0]
        )
        self._name = gui.add_text("Name", "", hint="Empty: one is found")
        tags = (*(start.tag for start in self._starts), ELSEWHERE)
        self._place = gui.add_dropdown("Place", tags, initial_value=tags[0])
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


class RobotControls:
    """Controls of a robot; they go into the present container of the GUI.

    Args:
        client: Client of the user.
        robot: The robot.
        frame: Present frame of the world.
        world: The number of the world.
        controls: Controls of the worlds.
        may: Whether the user still has the controls; called at every event.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        robot: DrawnRobot,
        frame: Frame,
        world: int,
        controls: WorldControls,
        may: Callable[[], bool],
    ) -> None:
        self._client, self._robot, self._world = client, robot, world
        self._controls, self._may = controls, may
        # Driver, and whether the page has taken the robot over.
        self._known: tuple[str | None, bool] | None = None
        gui = client.gui
        self._take = gui.add_button("Take over", hint="Drive it in place of its client or policy")
        self._take.on_click(lambda _: self._do(self._take_over))
        # A caller's own description is in no registry: its robot can be taken over and removed only.
        spec = ROBOTS.get(robot.robot) if robot.robot in ROBOTS else None
        if spec is not None:
            self._add_driving(gui, spec)
            self._add_cameras(gui, spec, frame)
            self._add_joints(gui, spec, frame)
            self._add_effecters(gui, spec)
        gui.add_button("Remove", color="red").on_click(lambda _: self._do(self._remove))

    def update(self, status: WorldStatus) -> None:
        """Show the present driver of the robot."""
        slot = self._robot.slot
        known = status.drivers.get(slot), slot in status.taken_over
        # Each assignment to a button is a message to the browser, also of the value that it has.
        if known == self._known:
            return
        self._known = known
        driver, taken = known
        self._take.label = "Give it back" if taken else "Take over"
        # There is nobody to take the page's own robot from.
        self._take.visible = taken or driver != BY_PAGE

    def _do(self, act: Callable[[], None]) -> None:
        """Run an action, if the user has the controls."""
        if self._may():
            act()

    def _take_over(self) -> None:
        taken = self._known is not None and self._known[1]
        self._controls.take_over(self._world, self._robot.slot, on=not taken)

    def _remove(self) -> None:
        """Remove the robot from the world; ask first, if it is a client's."""
        remove = partial(self._controls.remove, self._world, self._robot.slot)
        # The page's own robot goes without a question; a client's removal costs its client the connection.
        if self._known == (BY_PAGE, False):
            remove()
            return
        modal = self._client.gui.add_modal(f"Remove {self._robot.name}?")
        with modal:
            self._client.gui.add_markdown(f"{self._robot.name} is a client's; its connection is closed.")
            confirm = self._client.gui.add_button("Remove it", color="red")
            cancel = self._client.gui.add_button("Leave it")

        def done(_: object, confirmed: bool) -> None:
            modal.close()
            if confirmed:
                self._do(partial(remove, any_owner=True))

        confirm.on_click(partial(done, confirmed=True))
        cancel.on_click(partial(done, confirmed=False))

    def _add_driving(self, gui: viser.GuiApi, spec: RobotSpec) -> None:
        world, slot = self._world, self._robot.slot
        light = gui.add_checkbox("Headlight", False)
        light.on_update(lambda _: self._do(lambda: self._controls.set_light(world, slot, light.value)))
        keys = spec.drive.full_scale
        if not keys:
            return
        speed = gui.add_slider("Speed [%]", 5, 100, 5, 50, hint="Of the most that it can")

        def steer(ahead: float, left: float, up: float) -> None:
            values = drive_values(keys, ahead, left, up, speed.value / 100)
            if not (ahead or left or up):
                # All keys, so that a robot stops in each of them, also in those that no direction sets.
                values = dict.fromkeys(keys, 0.0)
            self._do(lambda: self._controls.drive(world, slot, values))

        DrivePad(gui, steer, climbs=can_climb(keys))

    def _add_cameras(self, gui: viser.GuiApi, spec: RobotSpec, frame: Frame) -> None:
        now = frame.robots.get(self._robot.slot)
        for index, camera in enumerate(cameras_of(spec)):
            # A camera of a fixed field of view has nothing to zoom.
            if camera.max_fov <= camera.min_fov:
                continue
            name, fov = camera.mount.name, camera.default_fov if now is None else float(now.fovs[index])
            low, high = (round(math.degrees(limit), 1) for limit in (camera.min_fov, camera.max_fov))
            slider = gui.add_slider(
                f"{name} zoom [deg]", low, high, 0.1, _within(low, high, math.degrees(fov), 1)
            )

            # Bound as defaults: the loop's variables have moved on when the slider is used.
            def zoom(_: object, name: str = name, slider: viser.GuiSliderHandle[float] = slider) -> None:
                fov = math.radians(slider.value)
                self._do(lambda: self._controls.zoom(self._world, self._robot.slot, name, fov))

            slider.on_update(zoom)

    def _add_joints(self, gui: viser.GuiApi, spec: RobotSpec, frame: Frame) -> None:
        """Add a slider for each joint that neither DRIVE nor effecters move, by mission packages."""
        others = {control.joint for control in spec.drive.joint_controls}
        others |= {joint for effecter in effecters_of(spec) for joint in effecter.joints}
        free = {
            part.name: part
            for part in parts_of(spec)
            if part.motor is not None and not part.is_wheel and part.name not in others
        }
        for package in spec.packages:
            names = [part_name(package, link) for link in package.links]
            # Taken out: what is left belongs to no package.
            self._add_sliders(gui, package.name, [free.pop(name) for name in names if name in free], frame)
        self._add_sliders(gui, "Joints", list(free.values()), frame)

    def _add_sliders(self, gui: viser.GuiApi, title: str, parts: list[Part], frame: Frame) -> None:
        if not parts:
            return
        now = frame.robots.get(self._robot.slot)
        with gui.add_folder(title):
            for part in parts:
                # A joint without limits turns on and on; the slider covers one turn.
                low, high = part.limits or (-math.pi, math.pi)
                # Rounded outward, or the slider's steps would leave the limits out.
                low, high = math.floor(low * 100) / 100, math.ceil(high * 100) / 100
                index = self._robot.joints.index(part.name)
                present = 0.0 if now is None else float(now.joint_pos[index])
                unit = "rad" if part.joint == "hinge" else "m"
                slider = gui.add_slider(
                    f"{part.name} [{unit}]", low, high, 0.01, _within(low, high, present, 2)
                )

                def move(
                    _: object, name: str = part.name, slider: viser.GuiSliderHandle[float] = slider
                ) -> None:
                    goal = float(slider.value)
                    self._do(lambda: self._controls.set_joint(self._world, self._robot.slot, name, goal))

                slider.on_update(move)

    def _add_effecters(self, gui: viser.GuiApi, spec: RobotSpec) -> None:
        """Add a button for each operation of each effecter, with a slider where it takes a number."""
        for effecter in effecters_of(spec):
            with gui.add_folder(f"{effecter.kind} {effecter.mount.name}"):
                for opcode in effecter.opcodes:
                    if opcode.name.lower() in HIDDEN_OPCODES:
                        continue
                    value = None
                    if opcode.takes_value:
                        # A parameter that clients have to give has no default.
                        first = opcode.max_val if opcode.default_val is None else opcode.default_val
                        step = (opcode.max_val - opcode.min_val) / 100
                        value = gui.add_slider(opcode.name, opcode.min_val, opcode.max_val, step, first)
                    button = gui.add_button(opcode.name)

                    def act(
                        _: object,
                        name: str = effecter.mount.name,
                        operation: str = opcode.name,
                        value: viser.GuiSliderHandle[float] | None = value,
                    ) -> None:
                        number = None if value is None else float(value.value)
                        self._do(
                            lambda: self._controls.operate(
                                self._world, self._robot.slot, name, operation, number
                            )
                        )

                    button.on_click(act)


def _within(low: float, high: float, value: float, digits: int) -> float:
    """Return a value within a slider's limits, rounded to its digits."""
    # Viser refuses a slider that begins outside of its limits, where a joint may be by its contacts' give.
    return max(low, min(high, round(value, digits)))
