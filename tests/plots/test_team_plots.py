"""Figures of teams: finds over time and ways are those that were measured; the command prints its table."""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from flax import struct
from matplotlib.figure import Figure
from matplotlib.image import imread
from numpy.testing import assert_allclose
from PIL import Image
from typer.testing import CliRunner

from tests.arenas import FLAT
from usarmjx.base.estimates import estimate_groups
from usarmjx.cli.app import app
from usarmjx.plots.play import (
    SentMessage,
    TeamWays,
    draw_finds,
    draw_messages,
    draw_ways,
    just_sent,
    plot_teams,
)
from usarmjx.plots.style import PALETTE
from usarmjx.plots.team_film import film_teams, recent_messages, team_frames
from usarmjx.train.evaluation import yardsticks
from usarmjx.train.evaluation.yardsticks import TeamResult
from usarmjx.train.tasks.messages import MAP, PLAN, VECTOR, MessageState, no_messages, option
from usarmjx.train.tasks.reporting_team import ExploreBase


class Extra(struct.PyTreeNode):
    messaging: MessageState


class Memory(struct.PyTreeNode):
    step: np.ndarray
    extra: Extra


def row(name, finds):
    return TeamResult(
        name=name,
        score=estimate_groups(np.array([finds[-1] - 1.0, finds[-1]])),
        parts={},
        finds=finds,
        outside=0.0,
        bad=0,
    )


def test_finds_are_drawn_from_nothing_on_with_the_quarters_of_the_time():
    axes = Figure().add_subplot()
    draw_finds(axes, [row("one", (1.0, 3.0, 3.0, 6.0)), row("two", (2.0, 2.0, 2.0, 2.0))], 0.5)
    one, two, *quarters = axes.lines
    assert_allclose(one.get_xydata(), [[0, 0], [0.5, 1], [1, 3], [1.5, 3], [2, 6]])
    assert_allclose(two.get_ydata(), [0, 2, 2, 2, 2])
    assert [line.get_xdata()[0] for line in quarters] == [0.5, 1.0, 1.5]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["one: score 5.5", "two: score 1.5"]


def test_ways_go_from_ring_to_dot():
    axes = Figure().add_subplot()
    way = [np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([[0.5, 0.0, 0.0], [1.0, 2.0, 0.0]])]
    draw_ways(axes, FLAT, way, "pair")
    drawn = [line for line in axes.lines if line.get_color() == PALETTE[1]]
    assert_allclose(drawn[0].get_xydata(), [[1, 0], [1, 2]])
    ring, dot = drawn[1:]
    assert (ring.get_markerfacecolor(), ring.get_xydata().tolist()) == ("none", [[1, 0]])
    assert (dot.get_markerfacecolor(), dot.get_xydata().tolist()) == (PALETTE[1], [[1, 2]])
    with pytest.raises(ValueError, match="no team has been watched"):
        plot_teams("explore-v2", [row("one", (1.0,))], TeamWays(), "nowhere.png")


def test_the_command_shows_and_keeps_the_rows(tmp_path, monkeypatch):
    """Of a team that tests/train/evaluation/test_yardsticks.py lets play."""
    asked, parts = [], {"explored": 4.0, "known": 2.0, "contacts": -0.5}
    one = replace(row("one", (1.0, 3.0, 6.0)), parts=parts)
    monkeypatch.setattr(
        yardsticks, "measure_teams", lambda *how, **fields: asked.append((how, fields)) or (one,)
    )
    words = ["teams", "explore-v2", "one", "--worlds", "3", "--engine", "c", "--set", "episode_steps=3"]
    result = CliRunner().invoke(app, [*words, "--json", str(tmp_path / "teams.json")])
    assert result.exit_code == 0, result.stderr
    ((how, fields),) = asked
    assert how[:5] == ("explore-v2", 3, 0, "c", ["one"])
    assert {name: int(value) for name, value in fields.items()} == {"episode_steps": 3}
    *_, line = result.stdout.splitlines()
    assert line.startswith("| one | 5.5 | ")
    assert " | 4.0 | 2.0 | -0.5 | 17 % | 50 % | 50 % | 0 % |" in line
    (kept,) = json.loads((tmp_path / "teams.json").read_text())["rows"]
    assert (kept["name"], kept["finds"], kept["parts"]) == ("one", [1.0, 3.0, 6.0], parts)


@pytest.mark.thorough
def test_the_command_plays_draws_and_keeps_the_rows(tmp_path):
    """The finds of the file end with the parts of the table."""
    words = ["teams", "explore-v2", "one", "--worlds", "3", "--engine", "c", "--set", "episode_steps=3"]
    files = ["--out", str(tmp_path / "teams.png"), "--json", str(tmp_path / "teams.json")]
    result = CliRunner().invoke(app, [*words, *files])
    assert result.exit_code == 0, result.stderr
    head, _, _, line, wrote = result.stdout.splitlines()
    assert head.startswith("| team | score | 95 % interval | explored | known | contacts |")
    assert wrote == f"wrote {tmp_path / 'teams.png'}"
    assert imread(tmp_path / "teams.png").shape[1] > 800
    (kept,) = json.loads((tmp_path / "teams.json").read_text())["rows"]
    assert (kept["name"], len(kept["finds"])) == ("one", 3)
    assert kept["finds"][-1] == pytest.approx(kept["parts"]["explored"] + kept["parts"]["known"])
    assert kept["finds"] == sorted(kept["finds"])
    assert line.startswith(f"| one | {kept['score']['value']:.1f} |")
    assert len(kept["reached"]) == 3


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["drive-to-goal"], "drive-to-goal is no task for a team: its score has no parts"),
        (
            ["explore-v2", "fast"],
            "fast is none of the teams random, one, baseline, perfect-radio, packaged",
        ),
        (["explore-v2", "--worlds", "4"], "4 worlds for 3 levels of arenas: expected a multiple"),
        (["chess"], "unknown task 'chess'"),
    ],
)
def test_what_cannot_play_is_refused_in_a_line(words, complaint):
    result = CliRunner().invoke(app, ["teams", *words, "--engine", "c"])
    assert result.exit_code == 2
    assert complaint in result.stderr


def test_watching_takes_down_the_first_world(monkeypatch):
    places = iter([np.zeros((2, 3)), np.ones((2, 3)), np.full((2, 3), 2.0)])
    monkeypatch.setattr("usarmjx.plots.play.positions_of", lambda env, state: (next(places), None))
    seen = TeamWays()
    env = SimpleNamespace(batch=SimpleNamespace(arena_of=lambda state, world: FLAT), period=0.2, task=None)
    for name in ("a", "a", "b"):
        seen(name, env, SimpleNamespace(batch=None))
    assert (seen.arena, seen.period) == (FLAT, 0.2)
    assert {name: [way[0, 0] for way in ways] for name, ways in seen.ways.items()} == {"a": [0, 1], "b": [2]}


@pytest.mark.parametrize("hold", [2, 8])
def test_messages_are_drawn_from_senders_to_receivers_by_kind(hold, monkeypatch):
    """World 0: robot 1 sends its map to the base, robot 2 its plan to both; they are taken down once."""
    task = ExploreBase(count=2, byte_rate=64.0, hold=hold)
    places = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 3.0, 0.0]])
    state = no_messages(3, 5).replace(
        chosen=np.array([0, option(1, MAP), option(0, PLAN)]),
        receivers=np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], bool),
    )
    monkeypatch.setattr("usarmjx.plots.play.positions_of", lambda env, state: (places, None))
    env = SimpleNamespace(batch=SimpleNamespace(arena_of=lambda state, world: FLAT), period=0.2, task=task)
    seen = TeamWays()
    worlds = jax.tree.map(lambda x: np.asarray(x)[None], state)
    for step in range(1, 2 * hold + 1):
        memory = Memory(step=np.array([step]), extra=Extra(messaging=worlds))
        seen("a", env, SimpleNamespace(batch=None, memory=memory))
    sent = [(one.kind, one.ends.tolist()) for one in seen.sent["a"]]
    each = [
        ("map", [[1, 0], [0, 0]]),
        ("plan", [[2, 3], [0, 0]]),
        ("plan", [[2, 3], [1, 0]]),
    ]
    assert sent == each * 2  # of two messages in two times of `hold` steps
    axes = Figure().add_subplot()
    draw_messages(axes, seen.sent["a"][:3])
    lines = [line.get_xydata().tolist() for line in axes.lines if line.get_linestyle() == "-"]
    assert lines == [each[1][1], each[2][1], each[0][1]]
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert texts == ["2 plan", "1 map"]


@pytest.mark.parametrize(("talk", "kept"), [("all", [(0, 2), (1, 2), (0, 2)]), ("base", [(0, 2), (0, 2)])])
def test_links_over_which_whole_maps_go_are_drawn_when_they_begin(talk, kept, monkeypatch):
    """Robot 2 is linked to the base from the first step on, to robot 1 in the second; both links break."""
    task = ExploreBase(count=2, talk=talk)
    places = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 3.0, 0.0]])
    monkeypatch.setattr("usarmjx.plots.play.positions_of", lambda env, state: (places, None))
    batch = SimpleNamespace(arena_of=lambda state, world: FLAT)
    env = SimpleNamespace(batch=batch, period=0.2, task=task, scene=task.scene())
    seen = TeamWays()
    for pairs in ([(0, 2)], [(0, 2), (1, 2)], [], [(0, 2)]):
        table = np.zeros((1, 3, 3), bool)
        for one, other in pairs:
            table[0, one, other] = table[0, other, one] = True
        worlds = SimpleNamespace(links=SimpleNamespace(in_range=table))
        seen("a", env, SimpleNamespace(batch=SimpleNamespace(worlds=worlds), memory=None))
    found = [(one.kind, one.ends.tolist()) for one in seen.sent["a"]]
    assert found == [("link", [places[one, :2].tolist(), places[other, :2].tolist()]) for one, other in kept]


def test_letters_with_a_vector_are_drawn_as_such():
    task = ExploreBase(count=2, actions="goals+message", message_floats=2)
    state = no_messages(3, 5, task.message_floats).replace(
        chosen=np.array([0, option(1, VECTOR), option(1, PLAN)]),
        receivers=np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bool),
    )
    memory = Memory(step=np.array(task.hold // 2 + 1), extra=Extra(messaging=state))
    assert [one.kind for one in just_sent(task, memory, np.zeros((3, 3)))] == ["vector", "plan"]


def watched():
    """Two teams of one robot on a floor, for 4 and 2 steps of 2 s; the first sends a message in each step."""
    seen = TeamWays()
    seen.arena, seen.period = FLAT, 2.0
    seen.ways = {"a": [np.array([[0.5 * step, 1.0, 0.0]]) for step in range(4)], "b": [np.zeros((1, 3))] * 2}
    seen.sent = {"a": [SentMessage("map", np.full((2, 2), float(step))) for step in range(4)], "b": []}
    seen.sent_counts = {"a": [1, 2, 3, 4], "b": [0, 0]}
    return seen


def test_a_film_shows_the_messages_of_the_last_seconds():
    """Of 5 s, which are two steps of 2 s, rounded."""
    seen = watched()
    shown = [[one.ends[0, 0] for one in recent_messages(seen, "a", step)] for step in range(5)]
    assert shown == [[0], [0, 1], [1, 2], [2, 3], [2, 3]]
    assert recent_messages(seen, "b", 3) == []


def test_a_film_of_teams_goes_on_until_the_last_team_ends(tmp_path):
    """Eight times as fast as it was; moments differ, and a moment does not depend on those before it."""
    seen, rows = watched(), [row("a", (1.0, 1.0, 2.0, 3.0)), row("b", (1.0, 1.0))]
    film_teams("explore-v3", rows, seen, tmp_path / "teams.gif")
    with Image.open(tmp_path / "teams.gif") as film:
        times = []
        for frame in range(film.n_frames):
            film.seek(frame)
            times.append(film.info["duration"])
    assert times == [250, 250, 250, 2000]
    first, last = team_frames("explore-v3", rows, seen, np.array([0, 3]))
    (again,) = team_frames("explore-v3", rows, seen, np.array([0]))
    assert (first == again).all()
    assert (first != last).any()
    with pytest.raises(ValueError, match="no team has been watched"):
        film_teams("explore-v3", rows, TeamWays(), tmp_path / "none.gif")
