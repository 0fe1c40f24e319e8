"""A cell whose robot a client drives over TCP."""

import sys
from types import SimpleNamespace

import pytest

from tests.sweeps.conftest import SMALL
from usarmjx.base.errors import UsageError
from usarmjx.sweeps.clients import play_client
from usarmjx.sweeps.resolve import resolve
from usarmjx.sweeps.spec import read_spec
from usarmjx.train.tasks import TASKS

AHEAD = 30
"""With this seed the goal is 2.5 m away and 25 degrees beside the robot's nose."""
CLIENT = """
import os, socket, sys

with socket.create_connection(("127.0.0.1", int(os.environ["USARMJX_PORT"]))) as peer:
    assert sys.argv[1:] == [os.environ["USARMJX_PORT"], os.environ["USARMJX_EPISODE"]]
    peer.sendall(b"INIT {ClassName USARBot.P2AT} {Name P2AT0}\\r\\n")
    while peer.recv(65536):
        peer.sendall(b"DRIVE {Left 5.0} {Right 5.0}\\r\\n")
"""


def client_cell(command, **more):
    common = {**SMALL["common"], "episodes": 1, "policy": {"client": command, **more}, "seed": AHEAD}
    common["fields"] = {**common["fields"], "episode_steps": 100, "radius": 1.9}
    del common["split"]
    (cell,) = read_spec({"common": {**common, "arena": "floor"}}).cells
    return resolve(cell)


@pytest.mark.slow
def test_a_client_drives_and_its_episodes_are_scored(tmp_path):
    file = tmp_path / "client.py"
    file.write_text(CLIENT)
    cell = client_cell(f"{sys.executable} {file} {{port}} {{episode}}", speed=2)
    assert cell.driver.speed == 2
    played = play_client(cell, cell.driver, "c")
    assert played.scores.tolist() == [1.0], "it drove 0.7 m ahead"
    assert 5 < played.steps[0] < 100
    gone = client_cell(f"{sys.executable} -c 'raise SystemExit(3)'")
    with pytest.raises(UsageError, match="the client of episode 0 ended too early, with 3"):
        play_client(gone, gone.driver, "c")


def test_tasks_whose_score_counts_mail_are_refused():
    cell = SimpleNamespace(task=TASKS.get("explore-v3"), settings={"task": "explore-v3"})
    with pytest.raises(UsageError, match="robots send no mail, which the score of explore-v3 counts"):
        play_client(cell, SimpleNamespace(), "c")
