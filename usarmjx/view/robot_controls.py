"""What the person with the controls has for one robot: a pad, sliders, switches, and who drives it."""

import math
from collections.abc import Callable
from functools import partial

import viser

from usarmjx.cameras.mounts import cameras_of
from usarmjx.models.build.parts import part_name, parts_of
from usarmjx.models.effecters import effecters_of
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.robot import Part, RobotSpec
from usarmjx.models.steering import can_climb, drive_values
from usarmjx.view.controls import BY_PAGE, WorldControls, WorldStatus
from usarmjx.view.drawing import DrawnRobot, Frame
from usarmjx.view.drive_pad import DrivePad

IDLE_ORDERS = ("nop",)
"""Operations of effecters that have no button."""


class RobotControls:
    """Controls of a robot; they go where the present container of the GUI is.

    Args:
        client: Whose page.
        robot: The robot.
        frame: The world now.
        world: Its number.
        controls: What may be done to it.
        may: Whether that person has the controls still; asked at every event.
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
        self._known: tuple[str | None, bool] | None = None
        gui = client.gui
        self._take = gui.add_button("Take over", hint="Drive it in place of its client or policy")
        self._take.on_click(lambda _: self._do(self._take_over))
        spec = ROBOTS.get(robot.robot) if robot.robot in ROBOTS else None
        if spec is not None:
            self._add_driving(gui, spec)
            self._add_cameras(gui, spec, frame)
            self._add_joints(gui, spec, frame)
            self._add_effecters(gui, spec)
        gui.add_button("Remove", color="red").on_click(lambda _: self._do(self._remove))

    def update(self, status: WorldStatus) -> None:
        """Show who drives the robot now."""
        slot = self._robot.slot
        known = status.drivers.get(slot), slot in status.taken_over
        if known == self._known:
            return
        self._known = known
        driver, taken = known
        self._take.label = "Give it back" if taken else "Take over"
        self._take.visible = taken or driver != BY_PAGE

    def _do(self, act: Callable[[], None]) -> None:
        """Do something, if that person may."""
        if self._may():
            act()

    def _take_over(self) -> None:
        taken = self._known is not None and self._known[1]
        self._controls.take_over(self._world, self._robot.slot, on=not taken)

    def _remove(self) -> None:
        """Take the robot out of the world; ask first, if it is a client's."""
        remove = partial(self._controls.remove, self._world, self._robot.slot)
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
                self._do(partial(remove, anyones=True))

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
                values = dict.fromkeys(keys, 0.0)
            self._do(lambda: self._controls.drive(world, slot, values))

        DrivePad(gui, steer, climbs=can_climb(keys))

    def _add_cameras(self, gui: viser.GuiApi, spec: RobotSpec, frame: Frame) -> None:
        now = frame.robots.get(self._robot.slot)
        for index, camera in enumerate(cameras_of(spec)):
            if camera.max_fov <= camera.min_fov:
                continue
            name, fov = camera.mount.name, camera.default_fov if now is None else float(now.fovs[index])
            low, high = (round(math.degrees(limit), 1) for limit in (camera.min_fov, camera.max_fov))
            slider = gui.add_slider(
                f"{name} zoom [deg]", low, high, 0.1, _within(low, high, math.degrees(fov), 1)
            )

            def zoom(_: object, name: str = name, slider: viser.GuiSliderHandle[float] = slider) -> None:
                fov = math.radians(slider.value)
                self._do(lambda: self._controls.zoom(self._world, self._robot.slot, name, fov))

            slider.on_update(zoom)

    def _add_joints(self, gui: viser.GuiApi, spec: RobotSpec, frame: Frame) -> None:
        """Add a slider for each joint that DRIVE and effecters leave alone, by mission packages."""
        others = {control.joint for control in spec.drive.joint_controls}
        others |= {joint for effecter in effecters_of(spec) for joint in effecter.joints}
        free = {
            part.name: part
            for part in parts_of(spec)
            if part.motor is not None and not part.is_wheel and part.name not in others
        }
        for package in spec.packages:
            names = [part_name(package, link) for link in package.links]
            self._add_sliders(gui, package.name, [free.pop(name) for name in names if name in free], frame)
        self._add_sliders(gui, "Joints", list(free.values()), frame)

    def _add_sliders(self, gui: viser.GuiApi, title: str, parts: list[Part], frame: Frame) -> None:
        if not parts:
            return
        now = frame.robots.get(self._robot.slot)
        with gui.add_folder(title):
            for part in parts:
                low, high = part.limits or (-math.pi, math.pi)
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
                    if opcode.name.lower() in IDLE_ORDERS:
                        continue
                    value = None
                    if opcode.takes_value:
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
    """Return a value as a slider of those limits can show it."""
    return max(low, min(high, round(value, digits)))
