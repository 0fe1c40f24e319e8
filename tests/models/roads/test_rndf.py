"""Route networks and missions of the Urban Challenge: what is read and written, and named mistakes."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.road_files import write_mdf, write_rndf
from usarmjx.base.errors import SpecError
from usarmjx.models.roads.network import (
    BOUNDARIES,
    Lane,
    Mission,
    RoadSegment,
    RouteNetwork,
    SpeedLimit,
    Spot,
    Zone,
    mission_faults,
    network_faults,
)
from usarmjx.models.roads.rndf import read_mdf, read_rndf
from usarmjx.models.roads.shapes import road_shapes

RNDF = """\
RNDF_name ours.txt
num_segments 1
num_zones 1
format_version 1.0
creation_date 14-Mar-07
segment 1
num_lanes 2
segment_name Elm_Street
lane 1.1
num_waypoints 3
lane_width 12
left_boundary double_yellow
right_boundary solid_white
checkpoint 1.1.2 1
stop 1.1.3
exit 1.1.3 2.0.2
1.1.1 34.5875 -117.37
1.1.2 34.5876 -117.37
1.1.3 34.5877 -117.37
end_lane
lane 1.2
num_waypoints 1
1.2.1 34.6 -117.4
end_lane
end_segment
zone 2
num_spots 1
zone_name Car_Park
perimeter 2.0
num_perimeterpoints 3
exit 2.0.3 1.2.1
2.0.1 34.588 -117.37
2.0.2 34.589 -117.37
2.0.3 34.589 -117.371
end_perimeter
spot 2.1
spot_width 9.5
checkpoint 2.1.2 7
2.1.1 34.5881 -117.3701
2.1.2 34.5881 -117.3702
end_spot
end_zone
end_file
"""
NETWORK = RouteNetwork(
    name="ours.txt",
    format_version="1.0",
    creation_date="14-Mar-07",
    segments=(
        RoadSegment(
            name="Elm_Street",
            lanes=(
                Lane(
                    width=12.0,
                    left="double_yellow",
                    right="solid_white",
                    checkpoints=((2, 1),),
                    stops=(3,),
                    exits=((3, (2, 0, 2)),),
                    waypoints=((34.5875, -117.37), (34.5876, -117.37), (34.5877, -117.37)),
                ),
                Lane(waypoints=((34.6, -117.4),)),
            ),
        ),
    ),
    zones=(
        Zone(
            name="Car_Park",
            perimeter=((34.588, -117.37), (34.589, -117.37), (34.589, -117.371)),
            exits=((3, (1, 2, 1)),),
            spots=(
                Spot(
                    width=9.5,
                    checkpoints=((2, 7),),
                    waypoints=((34.5881, -117.3701), (34.5881, -117.3702)),
                ),
            ),
        ),
    ),
)
MDF = """\
MDF_name first.txt
RNDF ours.txt
format_version 1.0
creation_date 14-Mar-07
checkpoints
num_checkpoints 3
7
1
7
end_checkpoints
speed_limits
num_speed_limits 2
1 5 25.5
2 0 10
end_speed_limits
end_file
"""
MISSION = Mission(
    name="first.txt",
    rndf="ours.txt",
    format_version="1.0",
    creation_date="14-Mar-07",
    checkpoints=(7, 1, 7),
    speed_limits=(SpeedLimit(id=1, low=5.0, high=25.5), SpeedLimit(id=2, low=0.0, high=10.0)),
)


def test_a_file_says_what_it_says():
    assert read_rndf(RNDF) == NETWORK
    assert read_mdf(MDF, NETWORK) == MISSION


def test_what_is_written_is_what_was_read():
    """But for tabs, which DARPA's files have between words."""
    assert write_rndf(NETWORK).replace("\t", " ") == RNDF
    assert write_mdf(MISSION).replace("\t", " ") == MDF


def test_points_and_checkpoints_by_their_numbers():
    assert NETWORK.points()[1, 1, 3] == (34.5877, -117.37)
    assert NETWORK.points()[2, 0, 1] == (34.588, -117.37)
    assert NETWORK.points()[2, 1, 2] == (34.5881, -117.3702)
    assert len(NETWORK.points()) == 9
    assert NETWORK.checkpoints() == {1: (1, 1, 2), 7: (2, 1, 2)}
    assert NETWORK.lane(1, 2).waypoints == ((34.6, -117.4),)


@pytest.mark.parametrize("end", ["\r\n", "\n\n\n", "  \t\r\n"])
def test_files_of_others_are_read(tmp_path, end):
    """Line ends of any system, tabs, comments anywhere, keywords in any case, headers in any order."""
    text = RNDF.replace("lane_width 12\nleft_boundary double_yellow\n", "\tLEFT_BOUNDARY  double_yellow\n")
    text = text.replace("checkpoint 1.1.2 1\n", "checkpoint 1.1.2 1 /* here */\nLane_Width 12\n")
    text = text.replace("num_waypoints 3\n", "").replace("stop 1.1.3\n", "stop 1.1.3\nnum_waypoints 3\n")
    text = text.replace("zone 2", "/* a comment\n  over lines: zone 3 **/\nzone\t2").replace(
        "1.1.2 34", "1.1.2 \t 34"
    )
    path = tmp_path / "others.txt"
    path.write_bytes(b"\xef\xbb\xbf/* by others */" + text.replace("\n", end).encode())
    assert read_rndf(path) == NETWORK
    assert read_rndf(str(path)) == NETWORK
    path.write_bytes(MDF.replace("\n7\n", "\n  7 /* again */\n").replace("\n", end).encode())
    assert read_mdf(path) == MISSION


def test_optional_lines_may_be_left_out():
    for line in ("format_version 1.0\n", "segment_name Elm_Street\n", "lane_width 12\n", "stop 1.1.3\n"):
        assert write_rndf(read_rndf(RNDF.replace(line, ""))).replace("\t", " ") == RNDF.replace(line, "")
    bare = "MDF_name m\nRNDF r\nend_file\n"
    assert read_mdf(bare) == Mission(name="m", rndf="r")


BAD_RNDF = [
    # What to replace by what; the line, and what the message says.
    ("RNDF_name ours.txt", "name ours.txt", 1, "found 'name'; allowed here: RNDF_name"),
    ("RNDF_name ours.txt", "RNDF_name", 1, "expected: RNDF_name name"),
    ("num_segments 1", "num_segments 2", 26, "1 segments, but 2 were announced"),
    ("num_segments 1", "num_segments one", 2, "'one'; expected 1 whole numbers, as 1"),
    ("segment 1\n", "segment 2\n", 6, "segment 2; expected segment 1: numbers go up one by one"),
    ("lane 1.2", "lane 1.3", 21, "lane 1.3; expected lane 1.2"),
    ("lane 1.2", "lane 2", 21, "'2'; expected 2 whole numbers, as 1.1"),
    ("num_waypoints 3", "num_waypoints 4", 20, "3 waypoints of 1.1, but 4 were announced"),
    ("lane_width 12", "lane_width wide", 11, "lane_width 'wide'; expected a number from 0 to 1000"),
    ("lane_width 12", "lane_breadth 12", 11, "found 'lane_breadth'; allowed here: lane_width, left_boundary"),
    ("solid_white", "dotted_white", 13, f"'dotted_white'; allowed: {', '.join(BOUNDARIES)}"),
    ("checkpoint 1.1.2 1", "checkpoint 1.1.4 1", 14, "checkpoint at 1.1.4: 1.1 has points 1 to 3"),
    ("checkpoint 1.1.2 1", "checkpoint 1.2.1 1", 14, "point 1.2.1 is not one of 1.1; expected 1.1.P"),
    ("checkpoint 1.1.2 1", "checkpoint 1.1.2", 14, "expected: checkpoint M.N.P number"),
    ("checkpoint 2.1.2 7", "checkpoint 2.1.2 1", 38, "checkpoint 1: numbers begin with 1, and each can"),
    ("stop 1.1.3", "stop 1.1.9", 15, "stop at 1.1.9: 1.1 has points 1 to 3"),
    ("exit 1.1.3 2.0.2", "exit 1.1.3 2.0.4", 16, "exit to 2.0.4: 2.0 has points 1 to 3"),
    ("exit 1.1.3 2.0.2", "exit 1.1.3 5.1.1", 16, "exit to 5.1.1: 5.1 has no points"),
    ("exit 2.0.3 1.2.1", "exit 2.0.9 1.2.1", 31, "exit at 2.0.9: 2.0 has points 1 to 3"),
    ("1.1.2 34.5876 -117.37", "1.1.3 34.5876 -117.37", 18, "1.1.3; expected 1.1.2"),
    ("1.1.2 34.5876 -117.37", "1.1.2 94.5876 -117.37", 18, "latitude '94.5876'; expected a number from -90 "),
    ("1.1.2 34.5876 -117.37", "1.1.2 34.5876 nan", 18, "longitude 'nan'; expected a number from -180 to 180"),
    ("1.1.2 34.5876 -117.37", "1.1.2 34.5876", 18, "expected: 1.1.2 latitude longitude"),
    ("num_spots 1", "num_spots 2", 42, "1 spots of zone 2, but 2 were announced"),
    ("spot_width 9.5", "lane_width 9.5", 37, "found 'lane_width'; allowed here: spot_width, checkpoint, "),
    ("segment_name Elm_Street", "segment_name /* Elm_Street", 8, "a comment without its end; expected */"),
]  # fmt: skip
BAD_MDF = [
    ("RNDF ours.txt\n", "", 2, "found 'format_version'; allowed here: RNDF"),
    ("num_checkpoints 3", "num_checkpoints 2", 10, "3 checkpoints, but 2 were announced"),
    ("7\n1\n", "7\n3\n", 8, "no checkpoint 3; known: 1, 7"),
    ("7\n1\n", "7\n1 2\n", 8, "1 2; expected: 1"),
    ("1 5 25.5", "1 35 25.5", 13, "speeds 35 and 25.5: expected 0 <= lowest <= highest"),
    ("1 5 25.5", "3 5 25.5", 13, "no segment or zone 3; known: 1 to 2"),
    ("1 5 25.5", "2 5 25.5", 14, "2 speed limits for 2; one is allowed"),
    ("1 5 25.5", "1 5", 13, "expected: 1 lowest highest"),
    ("1 5 25.5", "1 -5 25.5", 13, "speed '-5'; expected a number from 0 to 1000"),
    ("speed_limits\nnum", "speeds\nnum", 11, "found 'speeds'; allowed here: format_version, creation_date"),
]


# Deviations in files of the race's teams: what to replace by what; the line and words of the warning.
TOLERATED_RNDF = [
    ("num_zones 1\n", "", 42, "num_zones is missing"),
    ("num_waypoints 3\n", "", 19, "num_waypoints of 1.1 is missing"),
    ("end_lane\nend_segment", "end_segment", 24, "end_lane is missing"),
    ("end_zone\nend_file\n", "end_file\n", 42, "end_zone is missing"),
    ("end_file\n", "", 42, "end_file is missing"),
    ("num_lanes 2\n", "", 24, "num_lanes of segment 1 is missing"),
    ("num_spots 1\n", "", 41, "num_spots of zone 2 is missing"),
]
TOLERATED_MDF = [
    ("end_checkpoints\n", "", 10, "end_checkpoints is missing"),
    ("end_speed_limits\n", "", 15, "end_speed_limits is missing"),
    ("end_file\n", "", 15, "end_file is missing"),
    ("num_checkpoints 3\n", "", 6, "num_checkpoints is missing"),
    (
        "RNDF ours.txt\nformat_version 1.0\n",
        "format_version 1.0\nRNDF ours.txt\n",
        2,
        "RNDF stands further down",
    ),
]


@pytest.mark.parametrize(("old", "new", "line", "message"), TOLERATED_RNDF + TOLERATED_MDF)
def test_a_deviation_is_read_with_a_warning_and_its_line(caplog, old, new, line, message):
    mission = (old, new, line, message) in TOLERATED_MDF
    found = read_mdf(mistaken(MDF, old, new), NETWORK) if mission else read_rndf(mistaken(RNDF, old, new))
    assert found == (MISSION if mission else NETWORK)
    assert [record.getMessage() for record in caplog.records] == [f"text:{line}: {message}"]


def test_blocks_and_lines_are_read_in_any_order(caplog):
    """Zones before segments, lanes in reverse, marks behind points."""
    head, rest = RNDF.split("segment 1\n", 1)
    segment, zone = rest.split("zone 2\n")
    first, second = segment.split("lane 1.2\n")
    names, first = first.split("lane 1.1\n")
    exit_line = "exit 1.1.3 2.0.2\n"
    first = first.replace(exit_line, "").replace("end_lane", f"{exit_line}end_lane")
    lane, end = second.split("end_segment\n")
    text = (
        f"{head}zone 2\n{zone.replace('end_file', '')}segment 1\n{names}lane 1.2\n{lane}lane 1.1\n{first}"
        f"end_segment\n{end}end_file\n"
    )
    assert read_rndf(text) == NETWORK
    said = " ".join(record.getMessage() for record in caplog.records)
    assert "zone 2 is before zone 1" in said
    assert "lane 1.2 is before lane 1.1" in said
    assert "exit is behind points; the format has it before" in said


def test_waypoints_keep_the_numbers_of_the_file(caplog):
    text = RNDF
    for number in (3, 2, 1):
        text = text.replace(f"1.1.{number} ", f"1.1.{number + 13} ").replace(
            f"1.1.{number}\n", f"1.1.{number + 13}\n"
        )
    network = read_rndf(text)
    lane = network.lane(1, 1)
    assert (lane.first, lane.last, lane.checkpoints, lane.stops) == (14, 16, ((15, 1),), (16,))
    assert network.points()[1, 1, 14] == NETWORK.points()[1, 1, 1]
    assert network.checkpoints()[1] == (1, 1, 15)
    assert write_rndf(network).replace("\t", " ") == text
    assert [record.getMessage() for record in caplog.records] == [
        "text:17: points of 1.1 begin with 1.1.14 instead of 1"
    ]
    with pytest.raises(SpecError, match=r"stop at 1\.1\.3: 1\.1 has points 14 to 16"):
        read_rndf(text.replace("stop 1.1.16", "stop 1.1.3"))
    old, new = (road_shapes(one, (34.5875, -117.37)) for one in (NETWORK, network))
    assert new == old


def mistaken(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(("old", "new", "line", "message"), BAD_RNDF)
def test_a_mistake_in_an_rndf_is_named_with_its_line(tmp_path, old, new, line, message):
    path = tmp_path / "bad.txt"
    path.write_text(mistaken(RNDF, old, new), encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        read_rndf(path)
    assert str(caught.value).startswith(f"{path}:{line}: ")
    assert message in str(caught.value)


@pytest.mark.parametrize(("old", "new", "line", "message"), BAD_MDF)
def test_a_mistake_in_an_mdf_is_named_with_its_line(old, new, line, message):
    with pytest.raises(SpecError) as caught:
        read_mdf(mistaken(MDF, old, new), NETWORK)
    assert str(caught.value).startswith(f"text:{line}: ")
    assert message in str(caught.value)


def test_a_file_that_is_not_there_is_named():
    with pytest.raises(SpecError, match=r"nowhere\.txt: cannot be read: No such file"):
        read_rndf("nowhere.txt")


def test_a_mission_is_read_without_its_network_but_not_checked_against_it():
    strange = MDF.replace("1 5 25.5", "9 5 25.5")
    assert read_mdf(strange).speed_limits[0].id == 9
    with pytest.raises(SpecError, match="no segment or zone 9"):
        read_mdf(strange, NETWORK)


def with_lane(**changes):
    lane = replace(NETWORK.segments[0].lanes[0], **changes)
    segment = replace(NETWORK.segments[0], lanes=(lane, NETWORK.segments[0].lanes[1]))
    return replace(NETWORK, segments=(segment,))


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (with_lane(exits=((3, (1, 2, 2)),)), r"exit to 1\.2\.2: 1\.2 has points 1 to 1"),
        (with_lane(checkpoints=((1, 7),)), "checkpoint 7"),
        (with_lane(left="none"), "left_boundary 'none'; allowed: double_yellow"),
        (with_lane(width=-1.0), r"1\.1 is -1 feet wide"),
        (with_lane(waypoints=()), r"1\.1 has 0 points; expected 1"),
        (with_lane(waypoints=((float("nan"), 0.0),), exits=(), stops=()), r"1\.1\.1 lies at nan"),
        (replace(NETWORK, name=""), "needs a name"),
        (replace(NETWORK, creation_date="14 /* Mar"), "single spaces"),
        (replace(NETWORK, creation_date="14\nMar"), "single spaces"),
    ],
)
def test_what_is_not_sound_is_not_written(network, message):
    with pytest.raises(SpecError, match=message):
        write_rndf(network)


def test_a_sound_network_and_mission_have_no_faults():
    assert network_faults(NETWORK) == []
    assert mission_faults(MISSION, NETWORK) == []
    (fault,) = mission_faults(replace(MISSION, checkpoints=(2,)), NETWORK)
    assert fault == (("checkpoint", 2), "no checkpoint 2; known: 1, 7")


NAMES = st.text(st.characters(codec="utf-8"), max_size=12).map(lambda text: " ".join(text.split())).filter(
    lambda text: "/*" not in text and "*/" not in text
)  # fmt: skip
PLACES = st.tuples(st.floats(-90, 90), st.floats(-180, 180))
WIDTHS = st.none() | st.floats(0, 1e3)


@st.composite
def networks(draw):
    """Sound networks of any shape; exits are drawn once it is known which points there are."""
    shape = draw(st.lists(st.lists(st.integers(1, 4), min_size=1, max_size=3), min_size=1, max_size=3))
    zones = draw(st.lists(st.tuples(st.integers(1, 4), st.integers(0, 2)), max_size=2))
    points = [
        (m, n, p) for m, lanes in enumerate(shape, 1) for n, k in enumerate(lanes, 1) for p in range(1, k + 1)
    ]
    points += [(len(shape) + z, 0, p) for z, (k, _) in enumerate(zones, 1) for p in range(1, k + 1)]
    numbers = iter(draw(st.lists(st.integers(1, 10**6), unique=True, min_size=40, max_size=40)))

    def exits(count):
        return tuple(draw(st.lists(st.tuples(st.integers(1, count), st.sampled_from(points)), max_size=3)))

    def checkpoints(count):
        return tuple((point, next(numbers)) for point in draw(st.lists(st.integers(1, count), max_size=2)))

    def places(count):
        return tuple(draw(st.lists(PLACES, min_size=count, max_size=count)))

    def lane(count):
        return Lane(
            waypoints=places(count),
            width=draw(WIDTHS),
            left=draw(st.sampled_from(("", *BOUNDARIES))),
            right=draw(st.sampled_from(("", *BOUNDARIES))),
            checkpoints=checkpoints(count),
            stops=tuple(draw(st.lists(st.integers(1, count), max_size=2))),
            exits=exits(count),
        )

    def spot():
        return Spot(waypoints=places(2), width=draw(WIDTHS), checkpoints=checkpoints(2))

    return RouteNetwork(
        name=draw(NAMES.filter(bool)),
        format_version=draw(NAMES),
        creation_date=draw(NAMES),
        segments=tuple(RoadSegment(lanes=tuple(map(lane, lanes)), name=draw(NAMES)) for lanes in shape),
        zones=tuple(
            Zone(perimeter=places(k), exits=exits(k), spots=tuple(spot() for _ in range(n)), name=draw(NAMES))
            for k, n in zones
        ),
    )


@settings(deadline=None)  # a loaded machine is no failure
@given(networks())
def test_every_network_comes_back_exactly(network):
    assert read_rndf(write_rndf(network)) == network
    assert read_rndf(write_rndf(network).replace("\n", " /* so */\r\n")) == network


@given(
    st.builds(
        Mission,
        name=NAMES.filter(bool),
        rndf=NAMES.filter(bool),
        format_version=NAMES,
        creation_date=NAMES,
        checkpoints=st.lists(st.integers(1, 10**6), max_size=5).map(tuple),
        speed_limits=st.lists(
            st.tuples(st.integers(1, 99), st.floats(0, 50), st.floats(50, 1000)),
            max_size=3,
            unique_by=lambda limit: limit[0],
        ).map(lambda limits: tuple(SpeedLimit(id=n, low=low, high=high) for n, low, high in limits)),
    )
)
def test_every_mission_comes_back_exactly(mission):
    assert read_mdf(write_mdf(mission)) == mission
