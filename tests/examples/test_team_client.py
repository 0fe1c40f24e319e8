"""The example that drives a team over TCP."""

import numpy as np
import pytest

from benchmarks.team_over_tcp import play, table
from tests.scripts import load
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
