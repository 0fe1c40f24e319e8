"""Cameras in a dialogue without sockets: zoom, viewports, views, MultiView, traces. No picture is taken."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from tests.server.test_adapter import F2, House, heard, numbers, pick
from tests.server.watchers import MOLE, camera, classes, gallery, watcher
from usarmjx.sensors.suite import suite_of
from usarmjx.server.pictures.views import client_view
from usarmjx.server.protocol.viewports import MultiView, ViewBindings
from usarmjx.server.worlds.robot import Robot
from usarmjx.sim.control import idle_command

SIZE = (320, 240)
NAMES = ("Ahead", "Right", "Behind")


@pytest.fixture(scope="module")
def world():
    with classes():
        yield gallery()


@pytest.fixture
def house(world):
    house = House(world)
    yield house
    for client in list(house.clients):
        house.leave(client)
    world.multi_view = None
    world.traces.points.clear()


def join(house, kind="Lookout", name="R1", start="S0"):
    return house.connect(f"INIT {{ClassName USARBot.{kind}}} {{Name {name}}} {{Start {start}}}")


def without_time(line):
    assert re.match(rf"RES {{Time {F2}}} ", line)
    return re.sub(r"{Time [^}]*} ", "", line)


def ask(house, client, line):
    """The answers of a line, without their times."""
    return [without_time(answer) for answer in house.say(client, line)]


# Zoom


@pytest.mark.parametrize(
    ("asked", "fov", "status"),
    [
        ("1.5", "1.5000", "OK"),
        ("0.5", "0.5000", "OK"),
        ("2", "2.0000", "OK"),
        ("0", "1.0000", "Failed"),  # the default; KRobot.uc applies it and says Failed
        ("0.4", "0.5000", "Failed"),
        ("9", "2.0000", "Failed"),
        ("-1", "0.5000", "Failed"),
        ("garbage", "1.0000", "Failed"),  # C's atof makes it 0
    ],
)
def test_zoom_is_held_within_its_limits_and_every_camera_is_listed(house, asked, fov, status):
    """Manual 9.3 and 9.4; KRobot.uc."""
    client = join(house)
    assert ask(house, client, f"SET {{Type Camera}} {{Name ahead}} {{FOV {asked}}}") == [
        f"RES {{Type Camera}} {{Name Ahead}} {{FOV {fov}}} {{Status {status}}} "
        "{Name Right} {FOV 1.0000} {Status OK} {Name Behind} {FOV 1.0000} {Status OK}"
    ]
    configurations = [
        f"{{CameraDefFov 1.0000}} {{CameraMinFov 0.5000}} {{CameraMaxFov 2.0000}} {{CameraFov {fov}}}",
        "{CameraDefFov 1.0000} {CameraMinFov 1.0000} {CameraMaxFov 1.0000} {CameraFov 1.0000}",
        "{CameraDefFov 1.0000} {CameraMinFov 0.5000} {CameraMaxFov 2.0000} {CameraFov 1.0000}",
    ]
    named = [f"{{Name {name}}} {one}" for name, one in zip(NAMES, configurations, strict=True)]
    assert house.say(client, "GETCONF {Type Camera}") == [f"CONF {{Type Camera}} {' '.join(named)}"]
    assert house.say(client, "GETCONF {Type Camera} {Name Ahead}") == [
        f"CONF {{Type Camera}} {configurations[0]}"
    ]


def test_several_cameras_zoom_at_once_and_one_that_cannot_fails(house):
    """Manual 10.14.2: equal minimum and maximum."""
    client = join(house)
    line = "SET {Type Camera} {Name Behind} {FOV 0.75} {Name Right} {FOV 0.75} {Name Nobody} {FOV 1}"
    assert ask(house, client, line) == [
        "RES {Type Camera} {Name Ahead} {FOV 1.0000} {Status OK} {Name Right} {FOV 1.0000} {Status Failed} "
        "{Name Behind} {FOV 0.7500} {Status OK} {Name Nobody} {Status Failed}"
    ]


def test_zoom_stays_until_it_is_changed_and_a_new_robot_starts_with_the_default(house):
    client = join(house)
    ask(house, client, "SET {Type Camera} {Name Ahead} {FOV 0.75}")
    (line,) = ask(house, client, "SET {Type Camera} {Name Behind} {FOV 1.25}")
    assert "{Name Ahead} {FOV 0.7500}" in line
    house.leave(client)
    (line,) = ask(house, join(house), "SET {Type Camera} {Name Behind} {FOV 1.25}")
    assert "{Name Ahead} {FOV 1.0000}" in line


def test_the_older_form_of_zooming_answers_with_the_field_of_view(house):
    client = join(house)
    for params, fov in (("{Params 0.75}", "0.7500"), ("{0.875}", "0.8750"), ("{Params 3}", "2.0000")):
        assert ask(house, client, f"SET {{Type Camera}} {{Name Ahead}} {{Opcode Zoom}} {params}") == [
            f"RES {{Type Camera}} {{Name Ahead}} {{Status {fov}}}"
        ]
    for line in ("{Name Ahead} {Opcode Spin} {Params 1}", "{Name X} {Opcode Zoom} {Params 1}"):
        assert ask(house, client, f"SET {{Type Camera}} {line}")[0].endswith("{Status Failed}")


def test_a_robot_without_cameras_lists_none(house):
    client = join(house, "Mole")
    assert ask(house, client, "SET {Type Camera} {Name C} {FOV 1}") == [
        "RES {Type Camera} {Name C} {Status Failed}"
    ]


def test_an_empty_battery_answers_nothing(house, monkeypatch):
    """KRobot.uc."""
    client = join(house)
    monkeypatch.setattr(type(house.world), "battery", lambda self, robot: 0.0)
    assert house.say(client, "SET {Type Camera} {Name Ahead} {FOV 0.75}") == []
    assert house.say(client, "SET {Type Viewports} {Config SingleView}") == []


# Viewports


def test_viewports_answer_as_the_manual_says(house):
    """Manual 9.3 and 9.4: with several cameras it starts in QuadView."""
    client = join(house)
    assert ask(house, client, "SET {Type Viewports} {Config 0}") == [
        "RES {Type Viewports} {Config SingleView} {Status OK} {Viewport1 Ahead} {Status OK} "
        "{Viewport2 Right} {Status OK} {Viewport3 Behind} {Status OK} {Viewport4 Disabled} {Status OK}"
    ]
    assert ask(house, client, "SET {TypeViewports} {Viewport1 Disable} {Viewport2 nobody} {Config Huge}") == [
        "RES {Type Viewports} {Config SingleView} {Status Failed} {Viewport1 Disabled} {Status OK} "
        "{Viewport2 None} {Status Failed} {Viewport3 Behind} {Status OK} {Viewport4 Disabled} {Status OK}"
    ]


def test_one_camera_starts_in_single_view(house):
    """The manual's example."""
    client = join(house, "Cyclops")
    assert ask(house, client, "SET {Type Viewports}") == [
        "RES {Type Viewports} {Config SingleView} {Status OK} {Viewport1 Camera} {Status OK} "
        "{Viewport2 Disabled} {Status OK} {Viewport3 Disabled} {Status OK} {Viewport4 Disabled} {Status OK}"
    ]


# What an image client sees


def seen(house, address="10.0.0.2", port=1):
    """Robot, camera and place of what it sees."""
    return [
        (shot.robot.name, shot.camera, left, top, shot.width, shot.height)
        for shot, left, top in client_view(house.world, address, port, SIZE).tiles
    ]


QUARTERS = [("R1", 0, 0, 0, 160, 120), ("R1", 1, 160, 0, 160, 120), ("R1", 2, 0, 120, 160, 120)]


def test_without_a_robot_there_is_nothing_to_see(house):
    assert seen(house) == []
    assert (client_view(house.world, "10.0.0.2", 1, SIZE).compose({}) == 0).all()


def test_untied_clients_see_the_viewports_of_the_first_robot_with_a_camera(house):
    join(house, "Mole", "M", "S1")
    house.run(1)
    first = join(house, name="R1")
    house.run(1)
    second = join(house, "Cyclops", "R2", "S2")
    assert seen(house) == QUARTERS
    house.say(first, "SET {Type Viewports} {Config SingleView} {Viewport1 Behind}")
    assert seen(house) == [("R1", 2, 0, 0, *SIZE)]
    house.say(first, "SET {Type Viewports} {Viewport1 Disable}")
    assert seen(house) == []
    house.leave(first)
    assert seen(house) == [("R2", 0, 0, 0, *SIZE)]
    house.leave(second)
    assert seen(house) == []


def test_a_view_is_tied_and_released_from_any_connection(house):
    """Manual 9.4, SPQR's spelling; a connection without a robot will do, and viewports do not count then."""
    robot = join(house, name="R1")
    join(house, "Cyclops", "R2", "S2")
    operator = house.connect()
    heard(operator)
    assert house.say(operator, "SET {Type Camera}{Robot r2}{Name camera}{Client 10.0.0.2}") == []
    assert seen(house) == [("R2", 0, 0, 0, *SIZE)]
    house.say(robot, "SET {Type Viewports} {Config SingleView}")
    assert seen(house) == [("R2", 0, 0, 0, *SIZE)]
    house.say(robot, "SET {Type Viewports} {Config QuadView}")
    assert seen(house, "10.0.0.3") == QUARTERS
    assert house.say(operator, "SET {Type Camera} {Robot R1} {Name Right} {Client 10.0.0.2:7}") == []
    assert seen(house, port=7) == [("R1", 1, 0, 0, *SIZE)]
    assert seen(house, port=8) == [("R2", 0, 0, 0, *SIZE)]
    for client in ("10.0.0.2", "10.0.0.2:7"):
        assert house.say(operator, f"SET {{Type Camera}} {{Client {client}}}") == []
    assert seen(house) == seen(house, port=7) == QUARTERS


def test_a_tied_view_waits_for_its_robot_and_outlives_it(house):
    operator = house.connect()
    house.say(operator, "SET {Type Camera} {Robot R1} {Client 10.0.0.2}")
    join(house, "Cyclops", "R2", "S2")
    assert seen(house) == [], "nothing, and not somebody else's"
    first = join(house, name="R1")
    assert seen(house) == QUARTERS, "its viewports, as no camera is named"
    house.leave(first)
    assert seen(house) == []
    house.say(operator, "SET {Type Camera} {Robot R2} {Name X} {Client 10.0.0.2}")
    assert seen(house) == [], "it has no such camera"
    house.say(operator, "SET {Type Camera} {Client 10.0.0.2}")


def test_view_and_zoom_do_not_mix(house):
    """A viewpoint command has no answer and changes no field of view."""
    client = join(house)
    assert house.say(client, "SET {Type Camera} {Robot R1} {Name Ahead} {FOV 2} {Client 10.0.0.2}") == []
    (line,) = house.say(client, "GETCONF {Type Camera} {Name Ahead}")
    assert "{CameraFov 1.0000}" in line
    house.say(client, "SET {Type Camera} {Client 10.0.0.2}")


def test_multi_view_shows_the_first_camera_of_every_robot_and_sta_says_where(house):
    """Manual 3.2.6; View is in captured STA lines."""
    house.world.multi_view = MultiView(camera_num=3, camera_x_res=100, camera_y_res=75)
    kinds = ["Lookout", "Mole", "Cyclops", "Cyclops", "Cyclops"]
    clients = [join(house, kind, f"R{i}", f"S{i}") for i, kind in enumerate(kinds)]
    house.run()
    views = [int(re.search(r"{View (-?\d+)}", pick(heard(client), "STA"))[1]) for client in clients]
    assert views == [0, -1, 1, 2, -1], "no tile without a camera, nor beyond CameraNum"
    assert seen(house) == [
        ("R0", 0, 0, 0, 100, 75),
        ("R2", 0, 100, 0, 100, 75),
        ("R3", 0, 0, 75, 100, 75),
    ]
    house.leave(clients[2])
    late = join(house, "Cyclops", "Late", "S5")
    house.run()
    assert "{View 1}" in pick(heard(late), "STA"), "it takes the free tile"
    assert ("Late", 0, 100, 0, 100, 75) in seen(house)


def test_a_stereo_camera_fills_its_tile_with_both_eyes(house):
    """Manual 3.2.6.2: an even width, a pixel less if need be; which eye is where is the camera's matter."""
    fields = {"IsStereo": True, "StereoSpacing": (("Y", 0.05),)}
    owl = Robot(
        0, "Owl", suite_of(watcher("Owl", camera("Camera", **fields))), idle_command(MOLE), 0.0, tile=1
    )
    shared = MultiView(camera_num=2, wide_mode=2, camera_x_res=101, camera_y_res=75)
    world = SimpleNamespace(robots={0: owl}, view_bindings=ViewBindings(), multi_view=shared)
    ((shot, left, top),) = client_view(world, "10.0.0.2", 1, (202, 75)).tiles
    assert (shot.width, shot.height, left, top) == (100, 75, 101, 0)
    assert len(owl.cameras[shot.camera].eye_offsets) == 2


def test_without_multi_view_the_view_is_minus_one(house):
    client = join(house)
    house.run()
    assert "{View -1}" in pick(heard(client), "STA")


# Trace


def drive(house, client, seconds, speed=2.0):
    house.say(client, f"DRIVE {{Left {speed}}} {{Right {speed}}}")
    for _ in range(round(seconds / house.world.period)):
        house.run(1)
        client.add_trace_point()


def test_a_robot_leaves_points_where_it_has_been(house):
    """Manual 9.4; they outlive the robot, 5.2.5.1."""
    client = join(house, start="S1")
    house.run()
    drive(house, client, 0.5)
    assert house.world.traces.points == []
    house.say(client, "Trace {On true} {Interval 0.5} {Color Green}")
    drive(house, client, 3.0)
    house.say(client, "Trace {On false}")
    house.run()
    last = numbers(pick(heard(client), "GroundTruth"), "Location")
    drive(house, client, 1.0)
    places, colors = house.world.traces.sketch().start, house.world.traces.sketch().rgb
    assert len(places) == 6, "every 0.5 s for 3 s"
    assert (colors == (0, 1, 0)).all()
    # 2 rad/s on wheels of 0.13 m, a few per cent less for the slip; it drives along x from S1.
    np.testing.assert_allclose(np.diff(places[1:, 0]), 0.13, rtol=0.08)
    assert abs(places[:, 1] - 20.0).max() < 0.05
    assert places[-1, 0] <= last[0]
    house.leave(client)
    assert len(house.world.traces.points) == 6


def test_two_robots_leave_their_own_colours(house):
    one, other = join(house, name="R1", start="S1"), join(house, "Cyclops", "R2", "S2")
    house.say(one, "Trace {On 1} {Color 5}")
    house.say(other, "Trace {On 1} {Color White}")
    for client in (one, other):
        drive(house, client, 0.1)
    assert {color for _, color in house.world.traces.points} == {"Blue", "White"}
