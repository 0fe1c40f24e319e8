"""The example that drives a team over TCP."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.team_over_tcp import play, table
from tests.scripts import load
from usarmjx.base.errors import UsageError
from usarmjx.train.make import make_task
from usarmjx.train.tasks import TASKS, Buildings

SMALL = Buildings(levels=(0.4,), count=2, size=(5, 4), together=True, spacing=1.2)


@pytest.mark.thorough
@pytest.mark.parametrize("own", [{}, {"byte_rate": 512.0}], ids=["maps", "parts"])
def test_a_team_over_tcp_tells_its_base_by_radio(own):
    """The base has no scanner: its map is what robots have sent it over the wireless server."""
    task = make_task("explore-v3", arena=SMALL, count=2, episode_steps=40, **own)
    found = play(task, "explore-v3", "packaged", 2, "planar")
    assert (found["mapped"] > 0).all()
    np.testing.assert_allclose(found["score"], found["points"] - task.price * found["contacts"])
    assert table({"packaged": found}).splitlines()[2].startswith("| packaged | ")


def test_planners_and_policies_choose_goals_that_are_there():
    client = load("team_client")
    layout = TASKS.get("explore-v3").layout(None)
    seen = np.zeros((3, layout.size), np.float32)
    seen[:, -19:] = np.eye(19)[[0, 4, 7]]
    for name in ("baseline", "frontier", "courier", "packaged"):
        chosen = client.chooser(name, "explore-v3", TASKS.get("explore-v3"))(seen).argmax(-1)
        assert chosen.tolist() == [0, 4, 7], name
    assert client.corners("0,-1.5,12,9") == ((0.0, 12.0), (-1.5, 9.0))


def test_a_policy_with_other_choices_is_refused():
    client, task = load("team_client"), make_task("explore-v3", actions="goals+message")
    with pytest.raises(UsageError, match="packaged has 19 choices, but --actions goals"):
        client.chooser("packaged", "explore-v3", task)


def test_what_is_no_message_closes_its_link(capsys):
    """Three good messages and a half one are kept; a size that no message has ends the link."""
    client = load("team_client")
    mind = SimpleNamespace(letter_size=10, decoded=lambda data: np.frombuffer(data, "<f4"))
    radio = SimpleNamespace(register=lambda name: None)
    post = client.Post(radio, ["a", "b"], mind, -50.0)
    good = client.HEAD.pack(8, 1.5) + np.array([1.0, 2.0], "<f4").tobytes()
    letters, rest = post.unpacked(3 * good + good[:11])
    assert [(seconds, letter.tolist()) for seconds, letter in letters] == [(1.5, [1.0, 2.0])] * 3
    assert rest == good[:11]
    pieces = iter([client.HEAD.pack(81, 0.0), None])
    closed = list[str]()
    ends = {name: SimpleNamespace(close=lambda name=name: closed.append(name)) for name in "ab"}
    ends["a"].receive = lambda wait: next(pieces)
    post.links = {(0, 1): ends["a"], (1, 0): ends["b"]}
    assert post.received() == []
    assert sorted(closed) == ["a", "b"]
    assert "b sends a message of 81 bytes, expected at most 80: its link is closed" in capsys.readouterr().err
