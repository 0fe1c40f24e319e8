"""What a person sees of one robot beside the picture: state, battery, live plots."""

import html
import math

import viser
from scipy.spatial.transform import Rotation

from usarmjx.view.controls import BY_CLIENT, BY_PAGE, BY_POLICY, WorldStatus
from usarmjx.view.drawing import DrawnRobot, Frame, RobotFrame
from usarmjx.view.plots import RobotPlots

DRIVEN_BY = {BY_PAGE: "from this page", BY_CLIENT: "by its client", BY_POLICY: "by a policy"}
MAX_JOINTS = 12
"""Positions of so many joints are told."""
LOW_BATTERY = 0.2


class RobotReadout:
    """State and sensors of a robot; they go where the present container of the GUI is.

    Args:
        gui: Whose page.
        robot: The robot.
        frame: The world now.
    """

    def __init__(self, gui: viser.GuiApi, robot: DrawnRobot, frame: Frame) -> None:
        self._robot = robot
        self._text = ""
        self._state = gui.add_html("")
        with gui.add_folder("Sensors"):
            self._plots = RobotPlots(gui, robot, frame.robots[robot.slot])

    def update(self, frame: Frame, status: WorldStatus | None) -> None:
        """Show the robot as it is now."""
        now = frame.robots.get(self._robot.slot)
        if now is None:
            return
        driver = None if status is None else status.drivers.get(self._robot.slot)
        text = state_html(self._robot, now, driver)
        if text != self._text:
            self._state.content = self._text = text
        self._plots.update(frame.time, now)


def state_html(robot: DrawnRobot, frame: RobotFrame, driver: str | None = None) -> str:
    """Return a table of a robot's state.

    Args:
        robot: The robot.
        frame: The robot now.
        driver: Who drives it; None: nobody knows.
    """
    yaw, pitch, roll = Rotation.from_quat(frame.quat, scalar_first=True).as_euler("ZYX", degrees=True)
    x, y, z = frame.pos
    rows = [
        ("class", html.escape(robot.robot)),
        ("driven", DRIVEN_BY.get(driver, html.escape(driver))) if driver else ("", ""),
        ("at", f"{x:.2f}, {y:.2f}, {z:.2f} m"),
        ("roll, pitch, yaw", f"{roll:.0f}, {pitch:.0f}, {yaw:.0f}&deg;"),
        ("speed", f"{math.hypot(*frame.linear):.2f} m/s"),
        ("battery", _battery(frame.battery, robot.battery_life)),
        ("headlight", "on" if frame.light else "off"),
        (
            "DRIVE",
            ", ".join(
                f"{key} {value:.2g}" for key, value in zip(robot.drive_keys, frame.drive, strict=False)
            ),
        ),
        ("joints", _joints(robot, frame)),
    ]
    cells = "".join(f"<tr><td>{name}</td><td>{text}</td></tr>" for name, text in rows if text)
    return (
        "<style>.robotstate{font-size:.8em;margin:0 1em .5em;width:calc(100% - 2em)}"
        ".robotstate td:first-child{opacity:.65;padding-right:.8em;white-space:nowrap;vertical-align:top}"
        "</style>"
        f'<table class="robotstate">{cells}</table>'
    )


def _battery(left: float, life: float) -> str:
    share = max(0.0, min(1.0, left / life)) if life > 0 else 0.0
    colour = "#3cab5a" if share > LOW_BATTERY else "#e2574a"
    bar = (
        '<span style="display:inline-block;width:5em;height:.6em;background:#8884;border-radius:.3em">'
        f'<span style="display:block;width:{100 * share:.0f}%;height:100%;background:{colour};'
        'border-radius:.3em"></span></span>'
    )
    return f"{bar} {100 * share:.0f} %, {left:.0f} s"


def _joints(robot: DrawnRobot, frame: RobotFrame) -> str:
    turned = [
        f"{html.escape(name)} {value:.2f}"
        for name, value in zip(robot.joints, frame.joint_pos, strict=False)
        if "wheel" not in name.lower()
    ]
    return ", ".join(turned[:MAX_JOINTS]) + (" ..." if len(turned) > MAX_JOINTS else "")
