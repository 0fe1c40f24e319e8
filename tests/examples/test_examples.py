"""The bundled client and controller: what they read, what they send, and how the controller decides."""

import contextlib
import json
import math
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tests.scripts import EXAMPLES, load
from usarmjx.models.robots.pioneer import P2AT

client = load("usarsim_client")
wander = load("wander")

GREETING = "NFO {Gametype BotDeathMatch} {Level DM-USAR_yellow} {TimeLimit 0}"
STATUS = (
    "STA {Type GroundVehicle} {Time %.2f} {FrontSteer 0.0000} {RearSteer 0.0000}"
    " {LightToggle False} {LightIntensity 0} {Battery 1199} {View -1}"
)
SONARS = {
    mount.name: (mount.at[0], mount.at[1], mount.direction[2])
    for mount in P2AT.sensors
    if mount.kind == "Sonar"
}


def test_captured_sonar_line():
    line = "SEN {Time 5608.8500} {Type Sonar} {Name F1 Range 2.5098} {Name F8 Range 4.9978}"
    message = client.parse_line(line)
    assert message.kind == "SEN"
    assert message.time() == 5608.85
    assert message.value("type") == "Sonar"
    assert message.ranges() == {"F1": 2.5098, "F8": 4.9978}


def test_captured_scanner_line():
    line = (
        "SEN {Time 5608.85} {Type RangeScanner} {Name Scanner1} {Resolution 0.0174}"
        " {FOV 3.1415} {Range 11.3059,20.0000,0.5000}"
    )
    assert client.parse_line(line).scan() == (11.3059, 20.0, 0.5)


@pytest.mark.parametrize(
    ("line", "pose"),
    [
        ("SEN {Type Odometry} {Name Odometry} {Pose 0.2415,0.0029,-0.5157}", (0.2415, 0.0029, -0.5157)),
        (
            "SEN {Time 1939.1141} {Type GroundTruth} {Name GroundTruth} {Location 0.75,-7.28,-0.26}"
            " {Orientation 0.00,6.28,1.57}",
            (0.75, -7.28, 1.57),
        ),
    ],
)
def test_captured_pose_lines(line: str, pose: tuple[float, float, float]):
    assert client.parse_line(line).pose() == pose


def test_line_without_time_has_none():
    assert client.parse_line("SEN {Type Odometry} {Name O} {Pose 0,0,0}").time() is None


def test_repeated_keys_keep_their_order():
    line = "MISSTA {Time 1.00} {Name Pan} {Link 1} {Value 0.5000} {Link 2} {Value -0.2500}"
    assert client.parse_line(line).values("Value") == ["0.5000", "-0.2500"]


def test_manual_geo_line_has_the_fields_of_each_item():
    line = (
        "GEO {Type Sonar} {Name F2 Location 0.1850,-0.1150,0.0000 Orientation 0.0000,0.0000,-0.8727"
        " Mount HARD} {Name F3 Location 0.2200,-0.0800,0.0000 Orientation 0.0000,0.0000,-0.5236 Mount HARD}"
    )
    assert client.parse_line(line).items()["F2"]["Mount"] == "HARD"
    assert wander.mounts(client.parse_line(line)) == {
        "F2": (0.185, -0.115, -0.8727),
        "F3": (0.22, -0.08, -0.5236),
    }


@pytest.mark.parametrize(
    ("segments", "line"),
    [
        ({"Left": 1.0, "Right": -0.5}, "DRIVE {Left 1.0000} {Right -0.5000}"),
        ({"Name": "Pan", "Order": 0}, "DRIVE {Name Pan} {Order 0}"),
        ({"Location": (4.5, 1.9, 2)}, "DRIVE {Location 4.5000,1.9000,2}"),
        ({"Flip": True}, "DRIVE {Flip True}"),
    ],
)
def test_commands_are_written_as_the_manual_does(segments: dict[str, object], line: str):
    assert client.format_line("DRIVE", segments) == line


class FakeServer(threading.Thread):
    """Greets, then answers by how a line starts; cuts its bytes into small pieces."""

    def __init__(self, replies: dict[str, list[str]], greeting: str = GREETING):
        super().__init__(daemon=True)
        self.replies, self.greeting = replies, greeting
        self.heard: list[str] = []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.start()

    def run(self):
        # The client may leave while we speak or with words of ours unread.
        with contextlib.suppress(ConnectionError), self.listener, self.listener.accept()[0] as peer:
            self.say(peer, self.greeting)
            for raw in peer.makefile("rb"):
                line = raw.decode().rstrip("\r\n")
                self.heard.append(line)
                for reply in self.answers(line):
                    self.say(peer, reply)
                if line == "BYE":
                    return

    def answers(self, line: str) -> list[str]:
        return next((reply for start, reply in self.replies.items() if line.startswith(start)), [])

    @staticmethod
    def say(peer: socket.socket, line: str):
        data = (line + "\r\n").encode() if line else b""
        for start in range(0, len(data), 7):
            peer.sendall(data[start : start + 7])

    def connect(self, timeout: float = 5.0):
        return client.UsarsimClient("127.0.0.1", self.port, timeout)


def test_round_trip_with_a_server():
    server = FakeServer(
        {
            "GETSTARTPOSES": [
                "NFO {StartPoses 2} {A 4.50,1.90,1.80 0.00,0.00,0.00 B 1.00,2.00,3.00 0.00,0.00,1.57}"
            ],
            "INIT": [STATUS % 5.0, "SEN {Type Odometry} {Name Odometry} {Pose 0.0,0.0,0.0}"],
            "GETGEO": [
                STATUS % 5.2,
                "GEO {Type Sonar} {Name F1 Location 1,2,3 Orientation 0,0,0 Mount HARD}",
            ],
            "SET {Type Odometry}": ["RES {Time 5.40} {Type Odometry} {Name Odometry} {Status OK}"],
        }
    )
    with server.connect() as robot:
        assert robot.greeting.value("Level") == "DM-USAR_yellow"
        assert robot.start_poses() == [
            ("A", (4.5, 1.9, 1.8), (0.0, 0.0, 0.0)),
            ("B", (1.0, 2.0, 3.0), (0.0, 0.0, 1.57)),
        ]
        assert robot.init("USARBot.P2AT", "R1", (4.5, 1.9, 1.8)).time() == 5.0
        assert robot.geo("Sonar").items()["F1"]["Location"] == "1,2,3"
        assert robot.set("Odometry", "Odometry", "RESET").value("Status") == "OK"
        assert robot.set("Joint", "Pan", "Angle", 0.5) is None
        robot.drive(1, -1, normalized=True)
        robot.send("BYE")
        # What came between is still there, in order, and the iteration ends with the connection.
        left = [(message.kind, message.value("Time")) for message in robot]
        assert left == [("STA", "5.00"), ("SEN", ""), ("STA", "5.20")]
        with pytest.raises(ConnectionError):
            robot.receive(1.0)
    server.join(5)
    assert server.heard == [
        "GETSTARTPOSES",
        "INIT {ClassName USARBot.P2AT} {Name R1} {Location 4.5000,1.9000,1.8000}"
        " {Rotation 0.0000,0.0000,0.0000}",
        "GETGEO {Type Sonar}",
        "SET {Type Odometry} {Name Odometry} {Opcode RESET}",
        "SET {Type Joint} {Name Pan} {Opcode Angle} {Params 0.5000}",
        "DRIVE {Left 1} {Right -1} {Normalized True}",
        "BYE",
    ]


def test_silence_is_none_and_a_missing_answer_raises():
    server = FakeServer({})
    with server.connect(timeout=0.2) as robot:
        assert robot.receive(0.05) is None
        with pytest.raises(TimeoutError, match=r"report of the new USARBot\.Nothing"):
            robot.init("USARBot.Nothing", "R1", (0.0, 0.0, 0.0))


def test_server_that_does_not_greet_is_refused():
    server = FakeServer({}, greeting="")
    with pytest.raises(TimeoutError, match="greeting"):
        server.connect(timeout=0.2)


def ranges(**seen: float) -> dict[str, float]:
    """Return sonar readings, 5 m (nothing there) where not given."""
    return {name: seen.get(name, 5.0) for name in SONARS}


def decide(turning: int = 0, **seen: float):
    return wander.steer(wander.echoes(ranges(**seen), SONARS), [], turning)


def test_echo_lies_along_the_sonar():
    (point,) = wander.echoes({"F1": 2.0}, SONARS)  # at 0.145, -0.13, looking left
    assert point == pytest.approx((0.145, -2.13))
    (point,) = wander.echoes({"F6": 1.0}, SONARS)  # 30 degrees to the right
    assert point == pytest.approx((0.22 + math.sqrt(3) / 2, 0.08 + 0.5))


def test_open_space_is_driven_straight_at_cruising_speed():
    left, right, turning = decide()
    assert left == right == pytest.approx(wander.CRUISE / wander.WHEEL_RADIUS)
    assert turning == 0


def test_wall_near_ahead_slows_and_nearer_turns_in_place():
    fast, slow = decide()[0], decide(F4=0.6, F5=0.6)[0]
    assert 0 < slow < fast
    left, right, turning = decide(F4=0.3, F5=0.3, F8=0.6, F7=0.6)  # more room on the left
    assert turning == -1
    assert left == -right < 0


@pytest.mark.parametrize(("sonar", "turn"), [("F1", 1), ("F8", -1)])
def test_wall_beside_pushes_to_the_other_side(sonar: str, turn: int):
    left, right, turning = decide(**{sonar: 0.25})
    assert turning == 0
    assert (left - right) * turn > 0  # left wheels faster: to the right


def test_turn_goes_on_the_same_way_until_there_is_room():
    seen = {"F4": 0.5, "F5": 0.5}  # enough to go on driving, not to end a turn
    assert decide(**seen)[2] == 0
    assert decide(turning=1, **seen)[2] == 1
    assert decide(turning=-1, **seen)[2] == -1
    assert decide(turning=-1)[2] == 0


def test_wheels_stay_within_their_limit():
    for front in (0.1, 0.3, 0.5, 1.0, 5.0):
        for side in (0.1, 0.3, 5.0):
            left, right, _ = decide(F4=front, F5=front, F1=side)
            assert max(abs(left), abs(right)) <= wander.MAX_SPIN


def test_low_block_that_is_no_longer_heard_is_remembered():
    memory = wander.Memory()
    memory.add(1.0, (0.0, 0.0, 0.0), [(0.8, 0.0)])  # a block 0.8 m ahead of the start
    ahead = memory.around((0.3, 0.0, 0.0))
    assert ahead == [pytest.approx((0.5, 0.0))]
    assert wander.steer(wander.echoes(ranges(), SONARS), ahead)[2] != 0
    # Facing right (wire yaw +90 degrees) it is on the left, and out of the way.
    beside = memory.around((0.3, 0.0, math.pi / 2))
    assert beside == [pytest.approx((0.0, -0.5))]
    assert wander.steer(wander.echoes(ranges(), SONARS), beside)[2] == 0
    memory.add(1.1 + wander.REMEMBER, (0.3, 0.0, 0.0), [])
    assert memory.around((0.3, 0.0, 0.0)) == []


def test_clearance_is_measured_from_the_hull():
    assert wander.clearance([(wander.HALF_LENGTH + 0.3, wander.HALF_WIDTH + 0.4)]) == pytest.approx(0.5)


def test_controller_runs_against_a_server_and_writes_its_log(tmp_path: Path):
    """Ten reports, each 0.2 s later; the server's replies are scripted, not simulated."""
    geo = " ".join(
        f"{{Name {name} Location {x},{y},0.0 Orientation 0.0,0.0,{yaw} Mount HARD}}"
        for name, (x, y, yaw) in SONARS.items()
    )
    items = " ".join(f"{{Name {name} Range 5.0000}}" for name in SONARS)

    def report(i: int) -> list[str]:
        time = 100 + 0.2 * i
        return [
            STATUS % time,
            f"SEN {{Time {time:.4f}}} {{Type Sonar}} {items}",
            f"SEN {{Time {time:.2f}}} {{Type RangeScanner}} {{Name Scanner1}} {{Resolution 1.5707}}"
            " {FOV 3.1415} {Range 1.0000,2.0000,3.0000}",
            f"SEN {{Type Odometry}} {{Name Odometry}} {{Pose {0.1 * i:.4f},0.0000,0.0000}}",
            f"SEN {{Type INS}} {{Name INS}} {{Location {4.5 + 0.1 * i:.2f},1.90,1.80}}"
            " {Orientation 0.00,0.00,0.00}",
            f"SEN {{Time {time:.4f}}} {{Type GroundTruth}} {{Name GroundTruth}}"
            f" {{Location {4.5 + 0.1 * i:.2f},1.90,1.80}} {{Orientation 0.00,0.00,0.00}}",
        ]

    class Scripted(FakeServer):
        step = -1  # of the next report; each command to drive is followed by one

        def answers(self, line: str) -> list[str]:
            scanner = "{Name Scanner1 Location 0.1439,0,-0.09 Orientation 0,0,0 Mount HARD}"
            self.step += not line.startswith("GETGEO {Type Sonar}")
            if line.startswith("GETGEO {Type Sonar}"):
                return [f"GEO {{Type Sonar}} {geo}"]
            if line.startswith("GETGEO"):
                return [f"GEO {{Type RangeScanner}} {scanner}", *report(self.step)]
            return report(self.step)

    server = Scripted({})
    log = tmp_path / "log.json"
    command = [sys.executable, str(EXAMPLES / "wander.py"), "--port", str(server.port)]
    command += ["--seconds", "1.5", "--json", str(log)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert result.returncode == 0, result.stderr
    record = json.loads(log.read_text())
    assert record["level"] == "DM-USAR_yellow"
    first, last = record["track"][0], record["track"][-1]
    assert first[1] == [4.5, 1.9, 0.0]
    assert last[0] - first[0] >= 1.3
    assert last[1][0] - first[1][0] == pytest.approx(last[2][0], abs=0.01)
    assert record["scan"]["ranges"] == [1.0, 2.0, 3.0]
    assert record["scan"]["pose"] == last[1]
    # It ends within a report, as soon as the time is up.
    assert 8 <= len(record["track"]) <= record["messages"]["STA"] <= len(record["track"]) + 1
    assert server.heard[0].startswith("INIT {ClassName USARBot.P2AT}")
    assert server.heard[-1] == "DRIVE {Left 0.0000} {Right 0.0000}"


def test_controller_without_a_server_says_so():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    command = [sys.executable, str(EXAMPLES / "wander.py"), "--port", str(port)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert result.returncode == 1
    assert result.stderr.startswith(f"wander: 127.0.0.1:{port}: ")
    assert "Traceback" not in result.stderr
