"""Objects that a world controller moves along waypoints and rotates (WorldController.uc)."""

import math

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.test_created_objects import CREATE, controller, steps
from tests.server.test_world_controller import ARENA, objects, say
from usarmjx.recording.reader import Recording
from usarmjx.recording.replay import check_recording
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.server.worlds.object_motion import MAX_POINTS
from usarmjx.server.worlds.recorded import record_worlds

ATOL = 2e-4  # m, rad: four decimals that are cut, and single precision of the physics
SETWP = "CONTROL {Type SetWP} {Name box}"


@pytest.fixture
def world():
    return DynamicWorld(ARENA, max_robots=2)


@pytest.fixture
def client(world):
    """A controller, and an object without physics that hangs at 2, 1, 0.5 m."""
    client = controller(world)
    say(client, f"{CREATE} {{Name box}} {{Location 2,1,-0.5}} {{Rotation 0,0,0.3}}")
    return client


def pose(client, name="box"):
    """Location and rotation on the wire."""
    return objects(client, f" {{Name {name}}}")[name][1:]


def after(world, client, seconds):
    steps(world, round(seconds / world.period))
    return pose(client)


def is_at(found, location, rotation=(0.0, 0.0, 0.3)):
    np.testing.assert_allclose(found, (location, rotation), atol=ATOL)


def test_an_object_moves_along_its_points_with_its_speed_and_stays_at_the_last(world, client):
    """Three metres ahead and four to the right: 1 m/s for 7 s."""
    assert say(client, f"{SETWP} {{Speed 1}} {{WP 0,0,-0.5;3,0,-0.5;3,4,-0.5}}") == []
    is_at(pose(client), (0.0, 0.0, -0.5))
    is_at(after(world, client, 2.0), (2.0, 0.0, -0.5))
    is_at(after(world, client, 3.0), (3.0, 2.0, -0.5))
    is_at(after(world, client, 4.0), (3.0, 4.0, -0.5))
    is_at(after(world, client, 1.0), (3.0, 4.0, -0.5))


def test_a_loop_is_closed_and_a_time_is_that_of_all_of_it(world, client):
    """A square of 1 m in 4 s: after 5.5 s on the second side."""
    say(client, f"{SETWP} {{Time 4}} {{Loop true}} {{WP 0,0,-0.5;1,0,-0.5;1,1,-0.5;0,1,-0.5}}")
    is_at(after(world, client, 3.5), (0.0, 0.5, -0.5))
    is_at(after(world, client, 2.0), (1.0, 0.5, -0.5))
    say(client, f"{SETWP} {{Speed 2}} {{Time 8}}")  # 0.5 m/s, the slower of both
    is_at(after(world, client, 1.0), (1.0, 1.0, -0.5))
    say(client, f"{SETWP} {{Speed 0.25}} {{Time 8}}")
    is_at(after(world, client, 2.0), (0.5, 1.0, -0.5))


def test_it_pauses_points_along_its_path_and_points_are_added(world, client):
    say(client, f"{SETWP} {{Speed 1}} {{Autoalign true}} {{WP 0,0,-0.5;1,0,-0.5}}")
    say(client, "CONTROL {Type AddWP} {Name box} {WP 1,3,-0.5 ; 4,3,-3.5}")
    is_at(after(world, client, 0.5), (0.5, 0.0, -0.5), (0.0, 0.0, 0.0))
    is_at(after(world, client, 1.5), (1.0, 1.0, -0.5), (0.0, 0.0, math.pi / 2))
    say(client, f"{SETWP} {{Move false}}")
    is_at(after(world, client, 1.0), (1.0, 1.0, -0.5), (0.0, 0.0, math.pi / 2))
    say(client, f"{SETWP} {{Move true}}")
    # Up by 45 degrees: a pitch that is positive on the wire.
    share = 1 - 1 / math.sqrt(2)
    is_at(after(world, client, 3.0), (2 - share, 3.0, -1.5 + share), (0.0, math.pi / 4, 0.0))
    say(client, f"{SETWP} {{Autoalign false}}")
    is_at(pose(client), (2 - share, 3.0, -1.5 + share))


def test_cleared_points_send_it_back_unless_it_shall_stay(world, client):
    say(client, f"{SETWP} {{Speed 1}} {{WP 0,0,-0.5;3,0,-0.5}}")
    steps(world, 25)
    say(client, "CONTROL {Type ClearWP} {Name BOX}")
    is_at(pose(client), (2.0, 1.0, -0.5))
    assert not world.motions
    say(client, f"{SETWP} {{Speed 1}} {{ResetOnClear false}} {{WP 0,0,-0.5;3,0,-0.5}}")
    is_at(after(world, client, 1.0), (1.0, 0.0, -0.5))
    say(client, "CONTROL {Type ClearWP} {Name box}")
    is_at(after(world, client, 0.5), (1.0, 0.0, -0.5))


def test_an_object_rotates_until_its_speed_is_zero(world, client):
    assert say(client, "CONTROL {Type Rotate} {Name box} {Speed 0,0,0.5}") == []
    is_at(after(world, client, 2.0), (2.0, 1.0, -0.5), (0.0, 0.0, 1.3))
    say(client, "CONTROL {Type AbsMove} {Name box} {Location 1,1,-0.5} {Rotation 0,0,-1}")
    is_at(after(world, client, 1.0), (1.0, 1.0, -0.5), (0.0, 0.0, -0.5))
    say(client, f"{SETWP} {{Speed 1}} {{WP 0,0,-0.5;3,0,-0.5}}")
    is_at(after(world, client, 1.0), (1.0, 0.0, -0.5), (0.0, 0.0, 0.0))
    say(client, "CONTROL {Type Rotate} {Name box} {Speed 0,0,0}")
    is_at(after(world, client, 1.0), (2.0, 0.0, -0.5), (0.0, 0.0, 0.0))


def test_an_object_of_the_arena_falls_where_its_path_ends(world):
    client = controller(world)
    say(client, "CONTROL {Type SetWP} {Name crate} {Speed 1} {WP 0,0,-0.5;1,0,-0.5}")
    steps(world, round(0.5 / world.period))
    np.testing.assert_allclose(pose(client, "crate")[0], (0.5, 0.0, -0.5), atol=3e-3)
    steps(world, round(2.0 / world.period))
    np.testing.assert_allclose(pose(client, "crate")[0], (1.0, 0.0, -0.03), atol=5e-3)
    say(client, "CONTROL {Type ClearWP} {Name crate}")
    np.testing.assert_allclose(pose(client, "crate")[0], (4.0, -1.0, -0.03), atol=1e-3)
    world.reset()
    assert not world.motions


@pytest.mark.parametrize(
    "line",
    [
        "CONTROL {Type SetWP} {Name nobody} {WP 0,0,0;1,0,0}",
        "CONTROL {Type SetWP} {Name box} {Speed 1} {WP a,b;c}",
        "CONTROL {Type SetWP} {Name box} {Speed 1} {WP 1,2;3,4}",
        "CONTROL {Type SetWP} {Name box} {Speed 1,2,3} {WP 0,0,0;1,0,0}",
        "CONTROL {Type SetWP} {Name box} {Speed fast} {WP 0,0,0;1,0,0}",
        "CONTROL {Type SetWP} {Name box} {Speed 1} {WP 0,0,0;1e9,0,0}",
        f"CONTROL {{Type AddWP}} {{Name box}} {{WP {'0,0,0;' * (MAX_POINTS + 1)}}}",
        "CONTROL {Type AddWP} {Name box}",
        "CONTROL {Type ClearWP} {Name nobody}",
        "CONTROL {Type Rotate} {Name box}",
        "CONTROL {Type Rotate} {Name nobody} {Speed 0,0,1}",
    ],
)
def test_what_is_no_path_changes_nothing(world, client, line):
    before, faults = pose(client), client.session.fault_count
    assert say(client, line) == []
    assert client.session.fault_count == faults + 1
    assert not world.motions
    np.testing.assert_array_equal(after(world, client, 0.2), before)


def test_a_path_ends_with_its_object_and_one_point_is_a_place(world, client):
    say(client, f"{SETWP} {{Speed 1}} {{Loop true}} {{WP 1,2,-0.5}}")
    is_at(after(world, client, 0.5), (1.0, 2.0, -0.5))
    say(client, "CONTROL {Type Kill} {Name box}")
    assert not world.motions
    steps(world, 5)


def test_a_recording_of_moving_objects_is_replayed_to_the_bit(tmp_path):
    world = DynamicWorld(FLAT, max_robots=2)
    file = record_worlds([world], tmp_path / "paths.mcap")
    client = controller(world)
    say(client, f"{CREATE} {{Name box}} {{Location 2,1,-0.1}} {{Physics RigidBody}}")
    say(client, f"{SETWP} {{Speed 1}} {{WP 0,0,-0.5;1,0,-0.5}}")
    say(client, "CONTROL {Type Rotate} {Name box} {Speed 0,0,1}")
    steps(world, 80)
    file.close()
    result = check_recording(Recording(tmp_path / "paths.mcap"), 0)
    assert (result.difference, result.note, result.steps) == ("", "", 80)
