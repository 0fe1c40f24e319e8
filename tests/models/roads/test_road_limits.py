"""Road files that would take long to read: in linear time, and what is wrong in one short line."""

import time

import pytest

from usarmjx.base.errors import SpecError
from usarmjx.models.roads.network import Lane, RoadSegment, RouteNetwork, mission_faults, network_faults
from usarmjx.models.roads.rndf import MAX_ROAD_FILE_BYTES, read_mdf, read_rndf
from usarmjx.models.roads.shapes import road_shapes

BRIEFLY = 10.0
"""Seconds of a processor; looking for each one's end to the end of the file takes an hour."""


def test_comments_that_begin_without_end_are_looked_for_once():
    start = time.process_time()
    with pytest.raises(SpecError, match="text:1: a comment without its end"):
        read_rndf("/* " * 500_000 + "\n")
    assert time.process_time() - start < BRIEFLY


def test_what_is_wrong_many_times_is_said_once():
    count = 20_000
    exits = tuple((1, (9, 9, i)) for i in range(count))
    lane = Lane(waypoints=((1.0, 2.0),) * count, exits=exits)
    network = RouteNetwork(name="n", segments=(RoadSegment(lanes=(lane,)),))
    start = time.process_time()
    assert len(network_faults(network)) == count
    assert time.process_time() - start < BRIEFLY


def test_roads_round_the_world_have_too_many_markings():
    lane = Lane(waypoints=((-90.0, -180.0), (90.0, 180.0)), left="broken_white", stops=(2,))
    network = RouteNetwork(name="n", segments=(RoadSegment(lanes=(lane,)),))
    start = time.process_time()
    with pytest.raises(SpecError, match="roads 'n' have more than 50000 markings"):
        road_shapes(network, (0.0, 0.0))
    assert time.process_time() - start < BRIEFLY


@pytest.mark.filterwarnings("error")
def test_waypoints_at_one_place_have_nothing_between_them():
    """The kerb is that of the road on both sides of them."""
    ends = (0.0, 0.0), (0.001, 0.0)
    twice = Lane(waypoints=(ends[0], ends[0], ends[1]), stops=(3,))
    found, expected = (
        road_shapes(RouteNetwork(name="n", segments=(RoadSegment(lanes=(lane,)),)), (0.0, 0.0))
        for lane in (twice, Lane(waypoints=ends, stops=(2,)))
    )
    assert len(expected) == 2
    for one, other in zip(found, expected, strict=True):
        assert one.at == pytest.approx(other.at, abs=0.1)
        assert one.size == pytest.approx(other.size, abs=0.1)
    same = RouteNetwork(name="n", segments=(RoadSegment(lanes=(Lane(waypoints=(ends[0],) * 3),)),))
    assert road_shapes(same, (0.0, 0.0)) == ()


def test_a_mission_to_nowhere_lists_some_of_what_there_is():
    marks = tuple((i, i) for i in range(1, 5001))
    lane = Lane(waypoints=((1.0, 2.0),) * 5000, checkpoints=marks)
    network = RouteNetwork(name="n", segments=(RoadSegment(lanes=(lane,)),))
    order = "\n".join(map(str, range(6000, 16_000)))
    text = f"MDF_name m\nRNDF n\ncheckpoints\nnum_checkpoints 10000\n{order}\nend_checkpoints\nend_file\n"
    start = time.process_time()
    with pytest.raises(SpecError, match=r"text:5: no checkpoint 6000; known: 1, .* 100, \.\.\.$"):
        read_mdf(text, network)
    assert len(mission_faults(read_mdf(text), network)) == 10_000
    assert time.process_time() - start < BRIEFLY


def test_numbers_and_files_have_an_end(tmp_path):
    with pytest.raises(SpecError, match=r"text:2: .*expected 1 whole numbers"):
        read_rndf("RNDF_name n\nnum_segments " + "9" * 5000 + "\n")
    path = tmp_path / "a.txt"
    path.write_bytes(b" " * (MAX_ROAD_FILE_BYTES + 1))
    with pytest.raises(SpecError, match=f"has more than {MAX_ROAD_FILE_BYTES} bytes, which are too many"):
        read_rndf(path)


@pytest.mark.parametrize("text", ["RNDF_name\n{}", "RNDF_name n\n{}", "RNDF_name n\nnum_segments {}", "{} n"])
def test_long_lines_and_what_cannot_be_printed_are_quoted_in_short(text):
    with pytest.raises(SpecError) as caught:
        read_rndf(text.format("x\x1b[2J" * 1000 + " y" * 5000) + "\n")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1100
