"""Bridge between a client's dialogue and a robot in a served world; knows no socket."""

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

from usarmjx.base.backend import ArrayLike
from usarmjx.base.clock import wrapped_step
from usarmjx.base.errors import PeerError, PlaceError, UsageError, UsarmjxError
from usarmjx.base.registry import is_name
from usarmjx.base.settings import Parameters
from usarmjx.models.compile.parts import part_name, parts_of
from usarmjx.models.effecters import Gripper, Vacuum
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import STEER_SUFFIX, MissionPackage, RobotSpec
from usarmjx.sensors.rfid import Rfid
from usarmjx.server.gamebots.grippers import binary_order, grip, grippers_of
from usarmjx.server.gamebots.reporter import Reporter, battery_left, first_report_time
from usarmjx.server.gamebots.sensors import configuration, geometry, link_joint
from usarmjx.server.gamebots.spawning import spawn_from_init
from usarmjx.server.gamebots.victims import access_tag
from usarmjx.server.gamebots.world_controller import CLASS_NAME, WorldController
from usarmjx.server.protocol import commands as wire
from usarmjx.server.protocol import reports
from usarmjx.server.protocol.arguments import read_parameters
from usarmjx.server.protocol.command_parsers import COMMANDS
from usarmjx.server.protocol.commands import LinkCommand, MisPkg, OwnCommand, TurnCamera
from usarmjx.server.protocol.dialects import LATER_CLASSES, MANUAL, Dialect, told_class
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import AUTH, Message, check_word, clip, four_decimals, redact
from usarmjx.server.protocol.reports import STATUS_FAILED, STATUS_OK
from usarmjx.server.protocol.session import MAX_FAULTS, RobotSession
from usarmjx.server.runtime.logs import INTERVAL, FaultLog, summary
from usarmjx.server.worlds.robot import Robot, RobotTrace
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.control import FLIP_TIME, CommandUpdate, ControlMode

log = logging.getLogger(__name__)

PAN_LINK, TILT_LINK = 1, 2
"""Link numbers of a pan-tilt frame."""
RELATIVE_ANGLE = 10
"""Order that adds to the present angle (KRobot.uc)."""
BRAKE = 3
"""Order of the wire that holds a joint at its present position (KRobot.uc)."""
RELATIVE_MODES = {10: ControlMode.POSITION, 11: ControlMode.VELOCITY, 12: ControlMode.TORQUE}
"""Orders of the wire that add to the present position, or to the speed or torque in force (KRobot.uc)."""
MOTION_COMMANDS = (
    *(wire.DriveRobot, wire.DriveWheels, wire.DriveJoint, wire.MultiDrive),
    *(wire.MisPkg, wire.Set, wire.SetJoint, wire.SetStiffness, wire.SetFov, wire.TurnCamera),
)
"""Commands that are ignored while a user of the page drives the client's robot."""
CONTROLLER_COMMANDS = (wire.Control, wire.GetStartPoses, wire.SetView)
"""Commands of a client that controls the world."""


def pan_tilt_of(robot: RobotSpec) -> MissionPackage | None:
    """Return the pan-tilt frame that carries a robot's first camera; None without one."""
    for package in robot.packages:
        parts = {part_name(package, link) for link in package.links}
        # The manual lets CAMERA turn only a pan-tilt frame: an arm that carries a camera has other links,
        # too.
        is_frame = {link.number for link in package.links} == {PAN_LINK, TILT_LINK}
        if is_frame and robot.cameras and robot.cameras[0].parent in parts:
            return package
    return None


def package_command(robot: RobotSpec, command: TurnCamera) -> MisPkg | None:
    """Return the MISPKG that turns a robot's first camera as a CAMERA asks; None without a frame.

    Angles are relative unless bAbsoluteCamera is True; a relative angle of 0 leaves its link's command alone.
    """
    frame = pan_tilt_of(robot)
    if frame is None or command.rotation is None:
        return None
    _, tilt, pan = command.rotation
    is_relative = command.order == 0 and not robot.absolute_camera
    order = RELATIVE_ANGLE if is_relative else command.order
    # Yaw is positive to the right on the wire, link 1 to the left.
    turns = ((PAN_LINK, -pan), (TILT_LINK, tilt))
    links = tuple(LinkCommand(link, turn, order) for link, turn in turns if turn or not is_relative)
    return MisPkg(frame.name, links)


def _in_wire_axes(error: UsarmjxError) -> str:
    """Return the message of an exception with its position, if it has one, in the wire's axes."""
    return error.in_axes(flip_wire_vector) if isinstance(error, PlaceError) else str(error)


class Client:
    """One connection: a session, and a robot once INIT has spawned one.

    Args:
        world: The served world.
        peer: The peer's address, for the log.
        fault_log: Log of its faults; None for one of its own.
        dialect: Vocabulary of the client.
        time_limit: Minutes of simulated time after which the world ends; 0: never.
    """

    def __init__(
        self,
        world: ServedWorld,
        peer: str,
        fault_log: FaultLog | None = None,
        dialect: Dialect = MANUAL,
        time_limit: int = 0,
    ) -> None:
        self.session = RobotSession(reports.nfo_greeting(world.arena.name, time_limit), dialect=dialect)
        self.robot: Robot | None = None
        self._controller: WorldController | None = None
        self._reporter = Reporter(world, self.session)
        self._trace_state: RobotTrace | None = None
        self._fault_log = fault_log or FaultLog(log)
        self._next_log, self._logged = 0.0, 0
        self._world = world
        self._peer = peer
        self._handlers: dict[type, Callable[..., object]] = {
            wire.GetStartPoses: self._start_poses,
            wire.DriveRobot: self._drive,
            wire.DriveWheels: self._drive_wheels,
            wire.DriveJoint: self._drive_joint,
            wire.MultiDrive: self._drive_joints,
            wire.SetJoint: self._set_joint,
            wire.SetStiffness: self._set_stiffness,
            wire.InvalidSet: self._refuse_set,
            wire.MisPkg: self._move_package,
            wire.Set: self._set,
            wire.SetFov: self._zoom,
            wire.SetViewports: self._set_viewports,
            wire.SetView: self._set_view,
            wire.Trace: self._trace,
            wire.TurnCamera: self._turn_camera,
            wire.GetGeo: self._geometry,
            wire.GetConf: self._configuration,
            wire.Control: self._control,
            wire.OwnCommand: self._own_command,
        }

    def handle(self, command: wire.Command) -> None:
        """Carry out any command but INIT; nothing if the robot is lost: its slot may be another's."""
        # A page's user keeps the robot while it drives: two sources of setpoints would take turns at each
        # step.
        if (
            self.robot is not None
            and self.robot.controller not in (None, self)
            and isinstance(command, MOTION_COMMANDS)
        ):
            self.session.add_fault(f"{self.robot.name} is driven from the page: {type(command).__name__}")
        elif self.is_controller and not isinstance(command, CONTROLLER_COMMANDS):
            self.session.add_fault(f"a world controller has no robot: {type(command).__name__}")
        elif not self.lost:
            self._handlers[type(command)](command)

    def log_faults(self, *, is_last: bool = False) -> None:
        """Log the faults of the client's lines, at most one line a second; the last at once."""
        now = time.monotonic()
        # The session keeps only some of the faults but counts all, so the line says how many there were.
        count = self.session.fault_count - self._logged
        if count and (is_last or now >= self._next_log):
            self._next_log, self._logged = now + INTERVAL, self.session.fault_count
            faults = self.session.take_faults()[:MAX_FAULTS]
            self._fault_log.warning("%s: %s", self._peer, summary(faults, count))

    @property
    def is_controller(self) -> bool:
        """Whether it controls the world in place of a robot."""
        return self._controller is not None

    def becomes_controller(self, init: wire.Init) -> bool:
        """Let the client control the world if its INIT asks for that; return whether it does."""
        if not self.session.dialect.has_world_controllers or init.class_name.lower() != CLASS_NAME.lower():
            return False
        self._controller = WorldController(self._world)
        log.info("%s: controls the world", self._peer)
        return True

    # INIT comes in two halves, so that the server can prepare the class in a thread.

    def robot_class(self, init: wire.Init) -> RobotSpec | None:
        """Return the robot class of an INIT; None when there is no such class."""
        # The class as given goes first: a later version's name must not hide a class that is registered here.
        later = LATER_CLASSES.get(init.class_name.lower(), "")
        for name in (init.class_name, later):
            if name in ROBOTS:
                return ROBOTS.get(name)
        known = ", ".join(ROBOTS.names())
        self.session.note_refusal(f"unknown robot {clip(init.class_name)}; known: {known}")
        return None

    def spawn(self, init: wire.Init, spec: RobotSpec) -> bool:
        """Spawn the robot of an INIT; return whether that worked. As in the original, nothing is answered."""
        try:
            robot = spawn_from_init(self._world, init, spec, flip_wire_vector)
        except UsageError as error:
            self.session.note_refusal(_in_wire_axes(error))
            return False
        # GEO and CONF of later versions quote the class: in its own spelling, not in that of the INIT.
        self.session.robot_class = told_class(init.class_name, spec.name)
        self.attach_robot(robot, robot.spawn_time)
        log.info("%s: spawned %s as %r", self._peer, spec.name, robot.name)
        return True

    def attach_robot(self, robot: Robot, since: float) -> None:
        """Attach a robot that is in the world already, and report from `since` [s] on."""
        self.robot = robot
        robot.next_report = first_report_time(robot, self._world.robots.values(), since, self._world.period)

    def record_lines(self, peer: str, data: bytes, *, sent: bool) -> None:
        """Record bytes sent to the client or received from it, if the world is recorded."""
        # Bytes are recorded as they came, undecoded: a recording must show a malformed line, too.
        if data and self._world.recorder is not None:
            # A token is taken out before the file is written: recordings are passed on.
            if not sent and AUTH.encode() in data.upper():
                data = redact(data.decode("latin-1")).encode("latin-1")
            self._world.recorder.lines(peer, self.robot.name if self.robot else "", data, sent=sent)

    def leave(self) -> None:
        """Remove the robot from the world after the end of the connection."""
        if self.robot is not None:
            self._world.remove(self.robot)
            self.robot = None
        self.session.close()

    @property
    def lost(self) -> bool:
        """Whether the robot has vanished under the client (its world was reset)."""
        # Identity, not the name: after a reset another client's robot may have this slot.
        return self.robot is not None and self._world.robots.get(self.robot.slot) is not self.robot

    @property
    def battery_empty(self) -> bool:
        """Whether the battery is empty: then only STA goes on (KRobot.uc)."""
        return battery_left(self._world, self._present) <= 0

    @property
    def _present(self) -> Robot:
        if self.robot is None:
            raise UsageError("the client has no robot")
        return self.robot

    # Commands

    def _start_poses(self, command: wire.GetStartPoses) -> None:
        del command
        arena = self._world.arena
        poses = [
            (
                start.tag,
                # Positions in an arena are above its floor, those on the wire are not.
                flip_wire_vector((*start.at[:2], arena.floor + start.at[2])),
                flip_wire_angles(start.angles),
            )
            for start in arena.starts
        ]
        self.session.send(reports.nfo_start_poses(poses))

    def _drive(self, command: wire.DriveRobot) -> None:
        self._steer(dict(command.values), command)

    def _drive_wheels(self, command: wire.DriveWheels) -> None:
        values: dict[str, float] = {}
        for wheel in command.wheels:
            for key, value in (("WheelSpeed", wheel.speed), ("WheelSteer", wheel.steer)):
                if value is not None:
                    values[f"{key}{wheel.number}"] = value
        self._steer(values, command)

    def _steer(self, values: dict[str, float], command: wire.DriveRobot | wire.DriveWheels) -> None:
        """Set keys of DRIVE; those that the robot's drive does not have are logged and left out."""
        robot = self._present
        full = robot.spec.drive.full_scale | robot.spec.drive.other_keys
        unknown = [key for key in values if key not in full]
        if unknown:
            self.session.add_fault(f"{robot.spec.name} has no DRIVE {{{'} {'.join(unknown)}}}")
        # The known keys of a DRIVE count even if others are wrong.
        # Normalized values are percent of the largest.
        known = {k: v * full[k] / 100 if command.normalized else v for k, v in values.items() if k in full}
        # A flip ends at a step, not at a time: a sum of floats would end it a step early or late.
        flip = round(FLIP_TIME / self._world.period)
        flip_until = wrapped_step(self._world.steps + flip) if command.flip else None
        self._update_command(CommandUpdate(drive=known, light=command.light, flip_until=flip_until))

    def _update_command(self, update: CommandUpdate) -> None:
        self._world.update_command(self._present, update)

    def _set_joint_mode(self, joint: int, order: int, value: float) -> bool:
        """Apply an order of the wire to one joint; return whether there is such an order."""
        robot = self._present
        target, present = robot.command.target[joint], robot.command.mode[joint]
        goal: ArrayLike = value
        if order == BRAKE:
            # A velocity of 0 holds the joint where it is now; a position would need the measured one, a step
            # old.
            goal, mode = 0.0, ControlMode.VELOCITY
        elif order in RELATIVE_MODES:
            mode = RELATIVE_MODES[order]
            now = self._world.state(robot).joint_pos[joint] if mode == ControlMode.POSITION else 0.0
            # A relative speed or torque adds to the command in force, a relative angle to the measured one
            # (KRobot.uc).
            goal = value + (target if mode != ControlMode.POSITION and present == mode else now)
        elif order in tuple(ControlMode):
            mode = ControlMode(order)
        else:
            return False
        self._update_command(CommandUpdate(joints={robot.plan.parts[1 + joint]: goal}, mode=mode))
        return True

    def _set_named_joint(self, name: str, order: int, value: float) -> bool:
        joint = self._present.plan.joint_index(name)
        if joint is None:
            self.session.add_fault(f"{self._present.spec.name} has no joint {clip(name)}")
        elif not self._set_joint_mode(joint, order, value):
            self.session.add_fault(f"no such order as {order} for joint {clip(name)}")
        else:
            return True
        return False

    def _drive_joint(self, command: wire.DriveJoint | wire.SetJoint) -> bool:
        """Order a joint to move and a wheel to steer; return whether the robot could do both."""
        done = True
        if command.value is not None:
            done = self._set_named_joint(command.name, command.order, command.value)
        if command.steer is not None:
            steer = command.name + STEER_SUFFIX
            # Both are ordered before the answer: a bad steering part must not keep the wheel from moving.
            done = self._set_named_joint(steer, ControlMode.POSITION, command.steer) and done
        return done

    def _set_joint(self, command: wire.SetJoint) -> None:
        robot, is_angle = self._present, command.order == ControlMode.POSITION
        # The dialect's word for all joints counts only with angles; with other orders it is a name like any.
        if is_angle and command.name.lower() in self.session.dialect.all_joints and not self.battery_empty:
            goals: dict[str, ArrayLike] = {
                part.name: command.value
                for part in parts_of(robot.spec)
                if part.motor is not None and not part.is_wheel
            }
            self._update_command(CommandUpdate(joints=goals, mode=ControlMode.POSITION))
            return
        # A joint that moves is not answered (KRobot.uc); without an answer to what failed none could tell.
        if not self.battery_empty and not self._drive_joint(command):
            self.session.send(reports.res(self._world.time, "Joint", command.name, STATUS_FAILED))

    def _set_stiffness(self, command: wire.SetStiffness) -> None:
        robot, name = self._present, command.name
        if self.battery_empty:
            return
        try:
            joint = robot.plan.joint_index(name)
            part = None if joint is None else parts_of(robot.spec)[joint]
            # A wheel has a motor, but no servo that holds its angle.
            if joint is None or part is None or part.motor is None or part.is_wheel:
                raise PeerError(f"{robot.spec.name} has no joint {clip(name)} with a servo that holds it")
            self._world.set_stiffness(robot, joint, command.share)
        except (PeerError, UsageError) as error:
            self.session.add_fault(str(error))
            self.session.send(reports.res(self._world.time, "Joint", name, STATUS_FAILED))

    def _drive_joints(self, command: wire.MultiDrive) -> None:
        # One update for all joints: a gait sends a dozen in each control step, and a client's time is short.
        plan, goals = self._present.plan, dict[str, ArrayLike]()
        for name, angle in command.joints:
            joint = plan.joint_index(name)
            if joint is None:
                self.session.add_fault(f"{self._present.spec.name} has no joint {clip(name)}")
            else:
                goals[plan.parts[1 + joint]] = angle
        if goals:
            self._update_command(CommandUpdate(joints=goals, mode=ControlMode.POSITION))

    def _move_package(self, command: wire.MisPkg) -> None:
        for link in command.links:
            joint = link_joint(self._present.spec, command.name, link.link)
            if joint is None:
                self.session.add_fault(f"no link {link.link} in package {clip(command.name)}")
            elif not self._set_joint_mode(joint, link.order, link.value):
                self.session.add_fault(f"MISPKG order {link.order} is not supported")

        if command.gripper is not None and not self.battery_empty:
            self._grip(command.name, closes=command.gripper != 0)

    def _grip(self, name: str, *, closes: bool) -> None:
        """Close or open the grippers of that name or package; as in the original, nothing is answered."""
        robot = self._present
        indices = list(grippers_of(robot, name))
        if not indices:
            self.session.add_fault(f"{robot.spec.name} has no gripper on or called {clip(name)}")
        for index in indices:
            grip(self._world, robot, index, closes=closes)

    def _set(self, command: wire.Set) -> None:
        robot = self._present
        if self.battery_empty:
            return
        sensor = robot.suite.find(command.type, command.name)
        # An RFID sensor answers with the tag's data, not with the common RES.
        if sensor is not None and robot.suite.sensors[sensor].kind == Rfid.kind:
            self.session.send(self._access_tag(robot, sensor, command))
            return
        camera = robot.camera_index(command.name) if command.type.lower() == "camera" else None
        try:
            if sensor is not None:
                status = self._operate_sensor(robot, sensor, command)
            elif camera is not None:
                status = self._operate_camera(robot, camera, command)
            else:
                status = self._operate(robot, command)
        except PeerError as error:
            self.session.add_fault(f"SET {clip(command.name)} {clip(command.opcode)}: {error}")
            status = STATUS_FAILED
        self.session.send(reports.res(self._world.time, command.type, command.name, status))

    def _refuse_set(self, command: wire.InvalidSet) -> None:
        if not self.battery_empty:
            self.session.send(reports.res(self._world.time, command.type, command.name, STATUS_FAILED))

    def _operate_sensor(self, robot: Robot, index: int, command: wire.Set) -> str:
        """Carry out a SET on a sensor; return the Status to answer."""
        form = robot.suite.sensors[index].parameters_of(command.opcode)
        values = read_parameters(command.params, form)
        # Only a pose has axes: other parameters go to the sensor as they came.
        if command.opcode.upper() == "POSE" and len(values) == 6:
            values = (*flip_wire_vector(values[:3]), *flip_wire_angles(values[3:]))
        done = self._world.operate_sensor(robot, index, command.opcode, values)
        return STATUS_OK if done else STATUS_FAILED

    def _operate_camera(self, robot: Robot, camera: int, command: wire.Set) -> str:
        """Carry out the older form of zooming; the Status is the field of view [rad]."""
        if command.opcode.lower() != "zoom":
            return STATUS_FAILED
        (fov,) = read_parameters(command.params, Parameters(1, 1))
        self._world.zoom(robot, camera, fov)
        # The angle in force, not the one that was asked for: it is held within the camera's limits.
        return four_decimals(robot.fovs[camera])

    def _zoom(self, command: wire.SetFov) -> None:
        robot = self._present
        if self.battery_empty:
            return
        # The answer lists all cameras, also those that the command leaves out.
        statuses, unknown = [STATUS_OK] * len(robot.cameras), list[str]()
        for name, fov in command.cameras:
            camera = robot.camera_index(name)
            if camera is None:
                self.session.add_fault(f"{robot.spec.name} has no camera {clip(name)}")
                # A name that is no word cannot stand in the answer.
                unknown += [name] if is_name(name) else []
            elif fov is None:
                self.session.add_fault(f"camera {clip(name)}: its FOV is no number")
                statuses[camera] = STATUS_FAILED
            else:
                statuses[camera] = STATUS_OK if self._world.zoom(robot, camera, fov) else STATUS_FAILED
        names = [camera.mount.name for camera in robot.cameras]
        lines = zip(names, robot.fovs, statuses, strict=True)
        self.session.send(reports.res_camera(self._world.time, lines, unknown))

    def _turn_camera(self, command: wire.TurnCamera) -> None:
        """Carry out a CAMERA; the original sends no answer."""
        robot = self._present
        move = package_command(robot.spec, command)
        if move is not None:
            self._move_package(move)
        elif command.rotation is not None:
            self.session.add_fault(f"{robot.spec.name} has no pan-tilt frame under its first camera")
        if command.fov is not None and robot.cameras and not self.battery_empty:
            self._world.zoom(robot, 0, command.fov)

    def _set_viewports(self, command: wire.SetViewports) -> None:
        robot = self._present
        if self.battery_empty:
            return
        names = [camera.mount.name for camera in robot.cameras]
        status, statuses = robot.viewports.arrange(names, command.config, command.cameras)
        shown = zip(robot.viewports.shown, statuses, strict=True)
        config = (robot.viewports.config, status)
        self.session.send(reports.res_viewports(self._world.time, config, shown))

    def _set_view(self, command: wire.SetView) -> None:
        """Bind an image client's view to a camera, or unbind it; the original sends no answer."""
        if not command.robot:
            self._world.view_bindings.unbind(command.client)
            return
        try:
            # The robot is not looked up: it may come later, and the view is black until then.
            self._world.view_bindings.bind(command.client, command.robot, command.name)
        except PeerError as error:
            self.session.add_fault(str(error))

    def _trace(self, command: wire.Trace) -> None:
        # The last point is kept: a TRACE that is repeated on the spot adds none.
        self._trace_state = RobotTrace(command, self._trace_state.last if self._trace_state else None)

    def add_trace_point(self) -> None:
        """Add a point to the robot's trace if one is due; call it after every control step."""
        # A lost robot's slot may be another's, whose path would go on in this trace.
        if (
            self._trace_state is not None
            and self._trace_state.due(self._world.time)
            and not (self.robot is None or self.lost)
        ):
            # JAX scalars become floats here: the trace outlives the step whose buffers they are in.
            x, y, z = (float(value) for value in self._world.state(self.robot).pos)
            self._world.traces.add_point(self._trace_state, (x, y, z), self._world.time)

    def _access_tag(self, robot: Robot, sensor: int, command: wire.Set) -> Message:
        """Read or write an RFID tag; return the RES."""

        def reaches(number: int) -> bool:
            return self._world.operate_sensor(robot, sensor, command.opcode, (float(number),))

        return access_tag(command, self._world.time, self._world.tag_texts, reaches)

    def _operate(self, robot: Robot, command: wire.Set) -> str:
        """Carry out a SET on the first effecter of that type and name; return the Status to answer."""
        index = robot.effecter_index(command.type, command.name)
        if index is not None and isinstance(robot.effecters[index], Gripper | Vacuum):
            # Only the later dialect means closed or open by these; else the effecter reads the opcode.
            order = binary_order(command) if self.session.dialect.has_binary_grippers else None
            if order is not None:
                return grip(self._world, robot, index, closes=order)
        opcode = None if index is None else robot.effecters[index].opcode(command.opcode)
        if index is None or opcode is None:
            return STATUS_FAILED
        values = read_parameters(command.params, opcode.parameters)
        value = values[0] if values else opcode.default_val
        return STATUS_FAILED if value is None else self._world.operate(robot, index, opcode, value)

    def _geometry(self, command: wire.GetGeo) -> None:
        types = self.session.dialect.package_types
        if not self.battery_empty:
            for message in geometry(self._present.plan, command.type, command.name, types):
                self.session.send(message)

    def _configuration(self, command: wire.GetConf) -> None:
        if not self.battery_empty:
            robot = self._present
            known = (robot.spec, robot.suite.sensors, robot.fovs)
            dialect = self.session.dialect
            asked = (command.type, command.name, dialect.package_types)
            for message in configuration(*known, *asked, has_camera_names=dialect.has_camera_names):
                self.session.send(message)

    def _control(self, command: wire.Control) -> None:
        if self._controller is None:
            self.session.add_fault("CONTROL is for world controllers")
            return
        try:
            answer = self._controller.execute(command)
        except (PeerError, UsageError) as error:
            self.session.add_fault(f"CONTROL: {_in_wire_axes(error)}")
            return
        if answer is not None:
            self.session.send(answer)

    def _own_command(self, command: wire.OwnCommand) -> None:
        answer = command.action(self._world, self._present, command.message)
        if answer is not None:
            self.session.send(answer)

    # Reports

    def due(self, time: float | None = None) -> bool:
        """Whether a report of the robot is due, at a time of the world [s]; None: now."""
        if self.robot is None:
            return False
        # Both times are sums of floats: without the margin a report slips to the next step now and then.
        return (self._world.time if time is None else time) >= self.robot.next_report - 1e-6

    def report(self) -> None:
        """Send the robot's reports, and log those that failed."""
        self._reporter.report(self._present)
        self.log_faults()


CommandAction: TypeAlias = Callable[[ServedWorld, Robot, Message], Message | None]
"""Action of a command: the world, the robot of the client, and its line; returns the answer, or None."""


def add_command(head: str, action: CommandAction) -> None:
    """Register a command with another head, for clients with a robot of all servers of this process.

    Args:
        head: The first word of the line, whose case is ignored.
        action: Function of the world, the client's robot and the message; returns the answer or None. It
            runs between two control steps, and everybody waits for it.

    Raises:
        UsageError: There is such a command already, or the head is not one word.
    """
    COMMANDS.add(check_word(head), partial(OwnCommand, action))
