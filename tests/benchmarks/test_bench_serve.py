"""The benchmark of the server: what its clients time, that it sees what is slow, and its record."""

import json
import socket
import struct
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.serving.clients import (
    Bounds,
    Crowd,
    Missing,
    attempt,
    gather,
    join,
    measure_inits,
    ratios,
    rows,
    show,
    start_tags,
    wait_for_reports,
)
from benchmarks.serving.load import CELL, jitter_of, make_hall, measure_gaps, measure_load
from benchmarks.serving.process import OWN_TREE, ServerProcess, SourceTree
from tests.benchmarks.records import faults
from tests.server.peers import serving
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.models.files.load import find_arena
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.worlds.dynamic_world import DynamicWorld

SHORT = Bounds(seconds=0.3, windows=1, limit=30.0, settling=0.5)
STALL = 0.4  # s: how long the slow world takes for a robot
PORTS = (1, 2)  # which the other tree's server says that it listens at; nobody does
BURNT = 0.2  # s: processor time that the other tree's server uses before it listens
TICK = 0.01  # s: processor time comes in whole ticks, of user and system time

OTHER_SERVER = f"""
import signal, sys, time
if "--help" in sys.argv:
    print("Options: --port --max-connections")
    raise SystemExit
if "--arena nowhere" in " ".join(sys.argv):
    sys.exit("there is no such arena")
while time.process_time() < {BURNT}:
    pass
print("usarmjx: listening on 127.0.0.1:{PORTS[0]}", flush=True)
print("usarmjx: pictures on 127.0.0.1:{PORTS[1]}", flush=True)
signal.pause()
"""


class Server:
    """A server in this process; each look at its processor time finds two seconds more."""

    image_port = 0

    def __init__(self, port):
        self.port, self._used = port, 0.0

    def cpu_seconds(self):
        self._used += 2.0
        return self._used


@pytest.fixture(scope="module")
def server():
    with serving(DynamicWorld(find_arena("yellow")), realtime_factor=1.0) as (port, _):
        yield Server(port)


@pytest.fixture(scope="module")
def other_tree(tmp_path_factory):
    """A source tree of a server that only says that it listens."""
    folder = tmp_path_factory.mktemp("other")
    (folder / "usarmjx").mkdir()
    (folder / "usarmjx" / "__init__.py").touch()
    (folder / "usarmjx" / "__main__.py").write_text(OTHER_SERVER)
    return folder


# What clients time


def test_inits_are_timed_by_class(tmp_path):
    """With our own server as a process."""
    with ServerProcess(SourceTree(OWN_TREE), tmp_path, ["--arena", "field", "--engine", "c"]) as process:
        figures = measure_inits(process, ("P2AT", "Talon"), SHORT)
    assert figures.keys() == {"P2AT", "Talon"}
    assert figures["P2AT"].keys() == {"first_sta_s"}  # nobody was there to watch
    assert figures["Talon"].keys() == {"first_sta_s", "beyond_due_s"}
    # A robot's first report is due 0.2 simulated s after it appears, which a loop that lags hurries through.
    assert 0.0 < figures["Talon"]["first_sta_s"] < SHORT.limit
    assert figures["Talon"]["beyond_due_s"] > -0.2


def test_a_world_that_stands_still_is_seen_by_the_watcher(server, monkeypatch):
    def slow_spawn(*args):
        time.sleep(STALL)
        return spawn(*args)

    spawn = Client.spawn
    monkeypatch.setattr(Client, "spawn", slow_spawn)
    figures = measure_gaps(server, 2, SHORT)
    assert list(figures) == [
        "quiet", "joining at once", "first SET POSE", "spam", "leaving at once", "joining in turn",
        "leaving in turn",
    ]  # fmt: skip
    # Nothing is sent while it stands, so the gap is that long at least, and a fifth of a second was due.
    for name in ("joining at once", "joining in turn"):
        assert figures[name]["beyond_due_s"] >= STALL - 0.2
    assert figures["joining at once"]["all_report_s"] >= 2 * STALL
    assert len(figures["joining in turn"]["first_sta_s"]) == 2
    assert min(figures["joining in turn"]["first_sta_s"]) >= STALL
    assert figures["first SET POSE"]["answer_s"] > 0.0
    assert figures["spam"]["commands_per_s"] > 100


def test_the_load_is_per_simulated_second_and_commands_show(server):
    figures = measure_load(server, 2, SHORT)
    for state in ("standing", "driving"):
        (cpu,) = figures[state]["cpu_per_simulated_s"]
        # Two seconds of processor time in a window, which lasts from report to report.
        reports = 2.0 / cpu / 0.2
        assert reports == pytest.approx(round(reports), abs=1e-3)
        assert figures[state]["realtime_factor"][0] > 0.0
        assert 0.0 <= figures[state]["jitter_p95_s"][0] <= figures[state]["jitter_most_s"][0]
    for name in ("joint_shows_s", "motion_shows_s", "answer_s"):
        assert len(figures["command"][name]) == 2 * SHORT.windows
        assert all(0.0 < figure < SHORT.limit for figure in figures["command"][name])


def test_what_does_not_come_has_a_reason(server):
    with Crowd(server.port) as crowd:
        (tag,) = start_tags(crowd, 1, SHORT.limit)
        nobody = [join(crowd, "Unicycle", tag)]
        assert wait_for_reports(crowd, nobody, 0.1) == Missing("0 of 1 robots reported within 0.1 s")
        with pytest.raises(UsageError, match="48 start poses, not 49"):
            start_tags(crowd, 49, SHORT.limit)
        assert len(set(start_tags(crowd, 48, SHORT.limit))) == 48


def test_pictures_are_told_from_black_ones():
    def show_two(listener):
        connection, _ = listener.accept()
        with connection:
            for grey in (0, 7):
                frame = struct.pack(">HH", 2, 1) + bytes([grey] * 6)
                connection.sendall(struct.pack(">BI", 0, len(frame)) + frame)
                assert connection.recv(2) == b"OK"
            connection.recv(1)  # until the client leaves

    with socket.create_server(("127.0.0.1", 0)) as listener, Crowd(0) as crowd:
        showing = threading.Thread(target=show_two, args=(listener,))
        showing.start()
        client = crowd.pictures(listener.getsockname()[1])
        assert crowd.wait(lambda: len(client.frames) == 2, SHORT.limit)
        assert [shows for _, shows in client.frames] == [False, True]
        crowd.leave(client)
        showing.join()


def test_jitter_is_what_arrivals_differ_from_simulated_time():
    made = np.arange(5) * 0.2
    came = made + 100.0 + [0.0, 0.0, 0.03, 0.0, 9.0]
    reports = list(zip(came, made, strict=True))
    np.testing.assert_allclose(jitter_of(reports, 100.0, 101.0), [0.0, 0.03, 0.03], atol=1e-9)


@pytest.mark.parametrize("robots", [1, 5, 64])
def test_a_hall_has_room(robots):
    hall = make_hall(robots)
    at = np.array([start.at[:2] for start in hall.starts])
    assert len(at) >= robots
    apart = np.linalg.norm(at[:, None] - at[None], axis=-1)[~np.eye(len(at), dtype=bool)]
    assert apart.min(initial=CELL) == pytest.approx(CELL)
    walls = np.array([(*shape.at[:2], *shape.size[:2]) for shape in hall.shapes])
    outside = np.maximum(np.abs(at[:, None] - walls[:, :2]) - walls[:, 2:], 0.0)
    assert np.linalg.norm(outside, axis=-1).min() > 0.8  # a P2AT's half diagonal is 0.36 m


# Figures


def test_figures_of_runs_are_gathered_by_name():
    runs = [
        {"a": {"x": 1.0, "y": [1.0, 2.0]}, "b": 5.0},
        {"a": {"x": 4.0, "y": [6.0]}, "b": Missing("too slow")},
        {"a": Missing("it fell over"), "b": 7.0},
    ]
    gathered = gather(runs)
    assert gathered["a"]["x"] == {
        "median": 2.5, "least": 1.0, "most": 4.0, "values": [1.0, 4.0], "missing": ["it fell over"],
    }  # fmt: skip
    assert gathered["a"]["y"]["values"] == [1.0, 2.0, 6.0]
    assert gathered["b"]["median"] == 6.0
    assert gathered["b"]["missing"] == ["too slow"]
    assert [name for name, _ in rows(gathered)] == ["a x", "a y", "b"]
    assert show(gathered["b"]) == "6.000 (5.000-7.000)"
    assert gather([Missing("one"), Missing("one")]) == {"median": None, "missing": ["one"]}


def test_ratios_are_of_ours():
    ours, theirs = {"a": 2.0, "b": 1.0, "c": -0.1}, {"a": 3.0, "b": Missing("no"), "c": 1.0}
    assert ratios(gather([ours]), gather([theirs])) == {"a": 1.5, "b": None, "c": None}


def test_what_fails_is_missing_and_bugs_are_not():
    def fail(error):
        raise error

    assert attempt(lambda: fail(UsageError("why"))) == Missing("why")
    with pytest.raises(ZeroDivisionError):
        attempt(lambda: fail(ZeroDivisionError()))


# Processes


def test_the_server_of_another_tree_is_run(other_tree, tmp_path):
    tree = SourceTree(other_tree)
    assert tree.seats(64) == ["--max-connections", "64"]
    with ServerProcess(tree, tmp_path, []) as process:
        assert (process.port, process.image_port) == PORTS
        assert process.cpu_seconds() >= BURNT - 2 * TICK
    assert process.started_s >= BURNT
    assert process.stopped_s is not None


def test_a_server_that_does_not_start_says_why(other_tree, tmp_path):
    process = ServerProcess(SourceTree(other_tree), tmp_path, ["--arena", "nowhere"])
    with pytest.raises(UsageError, match="ended: there is no such arena"), process:
        pass
    with pytest.raises(UsageError, match="no source tree"):
        SourceTree(tmp_path).prepare()


def test_a_run_of_two_trees_by_the_command_line(other_tree, tmp_path, monkeypatch):
    """The other tree's server does not answer: only how it starts can be measured. It stands for ours too."""
    monkeypatch.setattr("benchmarks.serve.OWN_TREE", other_tree)
    file = tmp_path / "new" / "serve.jsonl"
    words = ["--part", "start", "--part", "init", "--repeats", "1", "--note", "not idle", "--json", str(file)]
    words += ["--baselines", "none"]
    result = CliRunner().invoke(app, ["bench", "serve", "--checkout", str(other_tree), *words])
    assert result.exit_code == 0, result.output
    (line,) = file.read_text().splitlines()
    record = json.loads(line)
    assert (record["benchmark"], record["note"]) == ("serve", "not idle")
    assert record["versions"]["mujoco"] == "3.17.0"
    assert record["case"]["parts"] == ["start", "init"]
    assert record["cores"] >= 1
    assert faults(record) == []
    ours, other = record["servers"]
    for server in (ours, other):
        for figures in server["figures"]["start"].values():
            assert figures["listening_s"]["median"] >= BURNT
            assert figures["sigint_to_end_s"]["median"] > 0.0
        refused = server["figures"]["init"]["cold"]
        assert refused["median"] is None
        assert "refused" in refused["missing"][0]
        assert f"{server['commit']}, init cold: {refused['missing'][0]}" in result.output
    assert other["commit"] == "unknown"
    assert str(tmp_path) not in line
    assert str(other_tree) not in line
    name = "start cold listening_s"
    both = [dict(rows(server["figures"]))[name]["median"] for server in (ours, other)]
    assert other["of_ours"][name] == pytest.approx(both[1] / both[0], abs=1e-3)  # three decimals
    assert f"{both[0]:.3f}" in result.output


def test_unknown_parts_are_refused():
    result = CliRunner().invoke(app, ["bench", "serve", "--part", "everything"])
    assert result.exit_code == 2
    assert "no part is called 'everything'; known: start, init" in result.output
