"""Comparisons of engines: along random drives, and by what policies score."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from usarmjx.base.errors import UnsupportedFeatureError, UsageError
from usarmjx.cli.app import app
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.train.evaluation import engine_gap as task_gaps
from usarmjx.train.evaluation.engine_gap import (
    DriveTrace,
    drive_around,
    drive_gap,
    drive_table,
    place_of,
    places_for,
    score_text,
    sources_of,
    task_gap,
)
from usarmjx.train.evaluation.evaluate import Episodes, evaluation_of
from usarmjx.train.learning.config import Config, RunRecord
from usarmjx.train.make import make
from usarmjx.train.policies.sources import PolicySource

AHEAD = ArenaSpec(
    name="ahead",
    starts=(StartPose(tag="S", at=(0.0, 0.0, 0.188), yaw=0.0),),
    extent=((-2, 2), (-2, 2)),
    shapes=(Shape(kind="box", size=(0.1, 2.0, 0.5), at=(0.6, 0.0, 0.5), surface="wall"),),
)


def test_contacts_count_when_they_begin_and_odometry_from_the_start():
    touching = np.array([[0, 0], [1, 0], [1, 0], [0, 0], [1, 1], [0, 1]], bool)
    pose, odometry = np.zeros((6, 2, 3)), np.zeros((6, 2, 3))
    pose[:, 0] = [2.0, 1.0, np.pi / 2]
    pose[-1, 0] = [2.0, 3.0, np.pi / 2]  # 2 m ahead, as it stands
    odometry[-1, 0] = [1.5, 0.0, 0.0]
    drive = DriveTrace(
        pose=pose,
        height=np.zeros((6, 2)),
        ranges=np.zeros((6, 2, 0)),
        odometry=odometry,
        touching=touching,
        period=0.2,
    )
    assert drive.contacts_per_minute == pytest.approx(3 / 10 * 60 / 0.2)
    assert drive.slip[-1] == pytest.approx([0.5, 0.0])


@pytest.mark.thorough
def test_a_wall_that_is_run_into_counts_on_c_as_on_planar():
    """By the same measure that tasks score by; ranges and poses agree while nothing is touched."""
    robot = ROBOTS.get("P2AT")
    orders = np.full((101, 1, 2), 5.0, np.float32)
    real, planar = (drive_around(robot, AHEAD, engine, orders) for engine in ("c", "planar"))
    for drive in (real, planar):
        assert not drive.touching[0, 0]
        assert drive.touching[-1, 0]
        assert drive.contacts_per_minute > 0
    assert planar.pose[-1, 0, 0] == pytest.approx(real.pose[-1, 0, 0], abs=0.03), "both stop at the wall"
    assert planar.ranges[0] == pytest.approx(real.ranges[0], abs=0.02)


def test_what_needs_a_solver_is_refused_by_name():
    with pytest.raises(
        UnsupportedFeatureError, match="'planar' cannot run stairs, which needs flippers that lift"
    ):
        make("stairs", engine="planar")
    heard = []
    rows = list(task_gap(("planar",), sources_of(["stairs"]), 1, (0,), 1, tell=heard.append))
    assert rows[-1] == "| stairs, baseline | refused |"
    assert "flippers that lift" in heard[0]


def episodes(*scores, seed=0):
    """Whole episodes that ended with some scores."""
    count = np.zeros(len(scores), int)
    return Episodes(
        seed=seed, scores=np.array(scores), lengths=count, worlds=count, episode_index=count, bad=0
    )


def test_scores_are_told_with_their_intervals():
    shares = evaluation_of([episodes(*[0.0, 1.0] * 8)])
    assert score_text([shares]) == f"0.5 ({shares.score.low:.3g} to {shares.score.high:.3g})"
    assert score_text([evaluation_of([episodes(0.5)])]) == "0.5"
    names = [name for name, _ in sources_of(["drive-to-goal", "convoy"])]
    assert names == ["drive-to-goal, packaged policy", "drive-to-goal, baseline", "convoy, baseline"]


def test_runs_that_differ_by_their_seeds_share_a_row_and_are_told_each(tmp_path, monkeypatch):
    shape = {"groups": (), "privileged_size": 0, "episode_steps": 7, "period": 0.2, "processes": 1}
    for name, engine, overrides in (
        ("a", "planar", {}),
        ("b", "c", {}),
        ("d", "planar", {}),
        ("e", "planar", {"square": "2"}),
    ):
        (tmp_path / name).mkdir()
        record = RunRecord(task="wander", engine=engine, overrides=overrides, config=Config(), **shape)
        record.save(tmp_path / name)
    monkeypatch.setattr(task_gaps, "load_policy", lambda folder: PolicySource(name=folder, task="wander"))
    rows = {name: [Path(one.name).name for one in found] for name, found in sources_of(folders(tmp_path))}
    assert rows == {
        "wander, trained on planar, 2 runs": ["a", "d"],
        "wander, trained on c": ["b"],
        "wander, trained on planar, square=2": ["e"],
    }
    few, many = evaluation_of([episodes(2.0, 2.0)]), evaluation_of([episodes(8.0, 8.0, 8.0, 8.0)])
    assert score_text([few, many]) == "6 (6 to 6): 2, 8", "no interval of one run reaches over to the other's"


def folders(path):
    return sorted(map(str, path.iterdir()))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--drives", "QRIO"], "QRIO neither rolls nor flies nor dives"),
        (["--drives", "--tasks"], "name one of them"),
        (["--tasks", "chess"], "chess"),
        (["--tasks", "convoy", "--split", "test"], "convoy has no generated arenas"),
    ],
)
def test_the_command_refuses_what_it_cannot_compare(words, says):
    refused = CliRunner().invoke(app, ["calibrate", *words])
    assert refused.exit_code == 2
    assert says in refused.output


def test_places_are_refused_by_name():
    with pytest.raises(UsageError, match=r"no place 'moon' .* floor, maze, air, water"):
        place_of("moon", ROBOTS.get("P2AT"))
    with pytest.raises(UsageError, match="'moon'"):
        drive_gap(ROBOTS.get("P2AT"), "moon")


def test_heights_count_of_what_flies_or_dives_and_every_class_that_planar_moves_has_a_place():
    places = {name: places_for(robot) for name, robot in ROBOTS}
    assert places["P2AT"] == ("floor", "maze")
    assert (places["AirRobot"], places["Passarola"], places["Submarine"]) == (("air",), ("air",), ("water",))
    assert {name for name, found in places.items() if not found} == {"ERS", "QRIO", "ComStation"}
    zero = np.zeros((2, 1))
    one, other = (
        DriveTrace(np.full((2, 1, 3), x), zero + z, zero[..., None], zero, zero > 0, 0.2)
        for x, z in ((0.0, 0.0), (1.0, 3.0))
    )
    assert one.distance(other, in_space=False) == pytest.approx(np.sqrt(2) + zero)
    assert one.distance(other, in_space=True) == pytest.approx(np.sqrt(2 + 9) + zero)


@pytest.mark.parametrize(("name", "place", "least"), [("AirRobot", "air", 5.0), ("Submarine", "water", 0.01)])
@pytest.mark.thorough
def test_what_flies_or_dives_meets_nothing_and_stays_near_to_c(name, place, least):
    """All keys of its drive at half of their most, for 4 s: the same forces on the same mass."""
    robot = ROBOTS.get(name)
    orders = np.tile(robot.drive.limits / 2, (201, 1, 1))
    real, planar = (drive_around(robot, place_of(place, robot), engine, orders) for engine in ("c", "planar"))
    for drive in (real, planar):
        assert not drive.touching.any()
        assert drive.height.min() > 100.0
    way = real.distance(replace(real, pose=real.pose[:1], height=real.height[:1]), in_space=True)[-1]
    assert way.min() > least
    assert (real.distance(planar, in_space=True)[-1] < 0.1 * way).all()


def test_a_robot_too_large_for_the_maze_has_a_row_that_says_so(monkeypatch):
    """And one without odometry a dash; the table goes on."""

    def driven(robot, arena, engine, orders):
        looks = np.zeros((51, 2))
        return DriveTrace(
            pose=np.zeros((51, 2, 3)),
            height=looks,
            ranges=np.zeros((51, 2, 0)),
            odometry=np.full((51, 2, 3), np.nan),
            touching=looks > 0,
            period=0.4,
        )

    monkeypatch.setattr("usarmjx.train.evaluation.engine_gap.drive_around", driven)
    rows = list(drive_table([ROBOTS.get("Hummer")]))[2:]
    assert rows[0] == "| Hummer, floor | 0.00 m | 0.00 m | 0.00 m | - / - / - | - / - | 0.0 / 0.0 |"
    assert rows[1] == "| Hummer, maze | too large for it | - | - | - | - | - |"
