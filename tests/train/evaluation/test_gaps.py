"""Comparisons of engines: along random drives, and by what policies score."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from usarmjx.base.errors import UnsupportedFeatureError, UsageError
from usarmjx.base.estimates import Estimate
from usarmjx.cli.app import app
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.arena import ArenaSpec, StartPose
from usarmjx.models.spec.shapes import Shape
from usarmjx.train.evaluation.drives import DriveTrace, drive_around, drive_gap, drive_table, place_of
from usarmjx.train.evaluation.evaluate import Evaluation
from usarmjx.train.evaluation.task_gap import sources_of, task_gap, told
from usarmjx.train.make import make

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
        pose=pose, ranges=np.zeros((6, 2, 0)), odometry=odometry, touching=touching, period=0.2
    )
    assert drive.contacts_per_minute == pytest.approx(3 / 10 * 60 / 0.2)
    assert drive.slip[-1] == pytest.approx([0.5, 0.0])


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
        UnsupportedFeatureError, match="'planar' cannot run soccer, which needs a ball that is pushed"
    ):
        make("soccer", engine="planar")
    heard = []
    rows = list(task_gap(("planar",), sources_of(["soccer"]), 1, (0,), 1, heard.append))
    assert rows[-1] == "| soccer, by hand | refused |"
    assert "a ball that is pushed" in heard[0]


def test_scores_are_told_with_their_intervals():
    some = Estimate(value=0.5, low=0.25, high=0.75, count=9)
    one = Evaluation(score=some, episodes=(), seed_scores=(), over_seeds=some)
    assert told(one) == "0.5 (0.25 to 0.75)"
    alone = replace(some, low=-np.inf, high=np.inf, count=1)
    assert told(replace(one, score=alone)) == "0.5"
    names = [name for name, _ in sources_of(["drive-to-goal", "convoy"])]
    assert names == ["drive-to-goal, packaged policy", "drive-to-goal, by hand", "convoy, by hand"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--drives", "AirRobot"], "AirRobot does not roll on wheels or tracks"),
        (["--drives", "--tasks"], "name one of them"),
        (["--tasks", "chess"], "chess"),
    ],
)
def test_the_command_refuses_what_it_cannot_compare(words, says):
    refused = CliRunner().invoke(app, ["calibrate", *words])
    assert refused.exit_code == 2
    assert says in refused.output


def test_places_are_refused_by_name():
    with pytest.raises(UsageError, match=r"no place 'moon' .* floor, maze"):
        place_of("moon", ROBOTS.get("P2AT"))
    with pytest.raises(UsageError, match="'moon'"):
        drive_gap(ROBOTS.get("P2AT"), "moon")


def test_a_robot_too_large_for_the_maze_has_a_row_that_says_so(monkeypatch):
    """And one without odometry a dash; the table goes on."""

    def driven(robot, arena, engine, orders):
        looks = np.zeros((51, 2))
        return DriveTrace(
            pose=np.zeros((51, 2, 3)),
            ranges=np.zeros((51, 2, 0)),
            odometry=np.full((51, 2, 3), np.nan),
            touching=looks > 0,
            period=0.4,
        )

    monkeypatch.setattr("usarmjx.train.evaluation.drives.drive_around", driven)
    rows = list(drive_table([ROBOTS.get("Hummer")]))[2:]
    assert rows[0] == "| Hummer, floor | 0.00 m | 0.00 m | 0.00 m | - / - / - | - / - | 0.0 / 0.0 |"
    assert rows[1] == "| Hummer, maze | too large for it | - | - | - | - | - |"
