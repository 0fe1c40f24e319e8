"""What a server tells Prometheus: as its own parser reads it, and against what the clients did."""

import json
import logging
import re
import time
import urllib.request

import pytest
from prometheus_client.parser import text_string_to_metric_families
from typer.testing import CliRunner

from tests.server.peers import PATIENCE, Peer, looping
from tests.server.still_world import StillWorld, init
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.cli.serving_options import metrics_socket
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.runtime.logs import JsonFormatter, configure_log
from usarmjx.server.runtime.loop import GAP_BOUNDS, StepMeter
from usarmjx.server.runtime.metrics import MetricsServer

JUNK = "NONSENSE\r\nDRIVE {Left nan}"


@pytest.fixture
def served():
    """Two worlds; the port of the figures, and the servers."""
    servers = [BotServer(StillWorld(), BotServerSettings(port=0), title=f"world {n}") for n in (3, 5)]
    bound = bound_socket("127.0.0.1", 0)
    port = bound.getsockname()[1]
    servers[0].services.append(MetricsServer(servers, 1.0, bound, (3, 5)))
    with looping(servers):
        yield port, servers


def fetch(port, path="/metrics"):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=PATIENCE) as answer:
        return answer.read().decode(), answer.headers["Content-Type"]


def samples(port):
    """All samples, by name and labels."""
    text, kind = fetch(port)
    assert kind == "text/plain; version=0.0.4; charset=utf-8"
    families = text_string_to_metric_families(text)
    return {(s.name, *sorted(s.labels.items())): s.value for family in families for s in family.samples}


def of_world(found, name, world, **labels):
    return found[(f"usarmjx_{name}", *sorted({"world": str(world), **labels}.items()))]


def test_what_clients_did_is_counted_by_world(served):
    port, servers = served
    drives = "DRIVE {Left 1} {Right 1}\r\n" * 3  # which a ComStation does not have: faults, too
    guest = Peer(servers[1].port, init() + "\r\n" + drives + JUNK + "\r\nGETSTARTPOSES")
    guest.until(b"NFO {StartPoses")
    found = samples(port)
    assert of_world(found, "commands_total", 5, kind="Init") == 1
    assert of_world(found, "commands_total", 5, kind="DriveRobot") == 3
    assert of_world(found, "commands_total", 5, kind="GetStartPoses") == 1
    for name, count in (("faults_total", 5), ("clients", 1), ("robots", 1), ("connections_total", 1)):
        assert of_world(found, name, 5) == count, name
        assert of_world(found, name, 3) == 0, name
    guest.close()
    deadline = time.monotonic() + PATIENCE
    # A robot leaves in a control step after its client has.
    gone = ("clients", "robots")
    while any(of_world(found, name, 5) for name in gone) and time.monotonic() < deadline:
        found = samples(port)
    for name, count in (("faults_total", 5), ("clients", 0), ("robots", 0), ("connections_total", 1)):
        assert of_world(found, name, 5) == count, name


def test_physics_that_went_bad_is_counted(served):
    port, servers = served
    servers[0].world.recovery_log.put_back += 2
    servers[1].world.recovery_log.resets += 1
    found = samples(port)
    assert [of_world(found, "robots_put_back_total", world) for world in (3, 5)] == [2, 0]
    assert [of_world(found, "world_resets_total", world) for world in (3, 5)] == [0, 1]


def test_time_and_gaps_are_those_of_the_control_steps(served):
    port, servers = served
    before = servers[1].world.time
    found = samples(port)
    after = servers[1].world.time
    assert before <= of_world(found, "simulated_seconds_total", 5) <= after
    steps = of_world(found, "step_gap_seconds_count", 5)
    assert before / 0.02 - 2 <= steps <= after / 0.02
    assert of_world(found, "step_gap_seconds_bucket", 5, le="+Inf") == steps
    counts = [of_world(found, "step_gap_seconds_bucket", 5, le=str(bound)) for bound in GAP_BOUNDS]
    assert counts == sorted(counts)


def test_the_process_is_weighed(served):
    found = samples(served[0])
    assert 1e7 < found[("usarmjx_process_resident_memory_bytes",)] < 1e11
    assert 5 < found[("usarmjx_process_open_fds",)] < 10_000
    assert found[("usarmjx_process_cpu_seconds_total",)] > 0.1


class Clock:
    """A world of which only the time is asked."""

    time = 0.0


def test_a_meter_by_hand():
    world = Clock()
    meter = StepMeter(type("Server", (), {"world": world}))
    assert meter.realtime_factor(1.0) == 0.0
    for step in range(501):
        world.time = step * 0.02
        meter.count(100.0 + step * 0.04)  # at half the speed
    assert meter.realtime_factor(120.0) == pytest.approx(0.5, rel=1e-6)
    assert meter.realtime_factor(125.0) == pytest.approx(0.25, rel=0.05), "it stands still since"
    assert meter.gap_sum == pytest.approx(20.0)
    assert dict(zip(GAP_BOUNDS, meter.gaps, strict=False))[0.05] == sum(meter.gaps) == 500
    meter.count(127.0)
    assert meter.gaps[-1] == 1


def test_a_health_line(served):
    port, servers = served
    text, kind = fetch(port, "/healthz")
    assert kind == "application/json"
    assert text.endswith("}\n")
    health = json.loads(text)
    assert health.keys() == {"status", "realtime_factor", "clients", "worlds"}
    assert (health["clients"], health["worlds"]) == (0, 2)
    slow = MetricsServer(servers, 1e6, bound_socket("127.0.0.1", 0))
    assert slow.health()["status"] == "behind"
    slow._bound.close()
    with pytest.raises(urllib.request.HTTPError, match="404"):
        fetch(port, "/")


def test_the_port_is_taken_first_and_moved_with_the_others():
    with metrics_socket("127.0.0.1", None, 0) as none:
        assert none is None
    with metrics_socket("127.0.0.1", 0, 100) as bound:
        bound.listen()
        port = bound.getsockname()[1]
        with (
            pytest.raises(UsageError, match=f":{port}: .*--metrics-port"),
            metrics_socket("127.0.0.1", port, 0),
        ):
            pass
    with pytest.raises(UsageError, match="--metrics-port leads to port 65536"):
        metrics_socket("127.0.0.1", 65535, 1).__enter__()


# The log for machines


def logged(message, *args, **more):
    record = logging.getLogger("usarmjx.test").makeRecord(
        "usarmjx.test", logging.WARNING, __file__, 1, message, args, more.get("exc_info")
    )
    (line,) = JsonFormatter().format(record).splitlines()
    return json.loads(line)


@pytest.mark.parametrize(
    ("message", "world", "peer", "rest"),
    [
        ("127.0.0.1:4711: connected", None, "127.0.0.1:4711", "connected"),
        ("world 3, 10.0.0.7:1: INIT refused: no room", 3, "10.0.0.7:1", "INIT refused: no room"),
        ("::1:4711: connected", None, "::1:4711", "connected"),
        ("fe80::1ff:4711: connected", None, "fe80::1ff:4711", "connected"),
        ("0.51 s behind the clock: simulated time falls back", None, None, None),
        ("the physics of world 3 was not finite", None, None, None),
    ],
)
def test_a_log_line_is_an_object(message, world, peer, rest):
    line = logged("%s", message)
    assert (line.get("world"), line.get("peer")) == (world, peer)
    assert line["message"] == (rest or message)
    assert (line["level"], line["logger"]) == ("warning", "usarmjx.test")
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00", line["time"])


def test_whatever_a_peer_says_stays_in_its_line():
    evil = 'a"b\\\n{"level": "none"}\x00é\u2028'
    assert logged("%s", evil)["message"] == evil
    try:
        raise ValueError(evil)
    except ValueError as error:
        found = logged("failed", exc_info=(type(error), error, error.__traceback__))
    assert "ValueError" in found["exception"]
    assert "Traceback" in found["exception"]


def test_the_log_of_a_server_names_peers(monkeypatch, capsys):
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(logging, "captureWarnings", lambda on: None)
    usarmjx = logging.getLogger("usarmjx")
    monkeypatch.setattr(usarmjx, "level", usarmjx.level)
    before = root.level
    configure_log(verbose=True, as_json=True)
    try:
        server = BotServer(StillWorld(), BotServerSettings(port=0), title="world 7")
        with looping([server]):
            guest = Peer(server.port, init())
            guest.until(b"STA")
            address = "{}:{}".format(*guest.socket.getsockname())
            guest.close()
    finally:
        root.setLevel(before)
        logging.Logger.manager._clear_cache()
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    mine = [line for line in lines if line.get("peer") == address]
    assert mine[0]["message"] == "connected"
    assert any(line["message"].startswith("spawned ComStation") for line in mine)
    assert {line["world"] for line in mine} == {7}


def test_both_options_are_there():
    helped = CliRunner().invoke(app, ["serve", "--help"], env={"COLUMNS": "200", "NO_COLOR": "1"}).output
    assert "--metrics-port" in helped
    assert "--log-json" in helped
    assert "--metrics-port" in CliRunner().invoke(app, ["play", "--help"], env={"COLUMNS": "200"}).output


def test_serve_logs_as_it_is_told(monkeypatch):
    told = []
    monkeypatch.setattr("usarmjx.cli.serve.configure_log", lambda **how: told.append(how))
    for words in ([], ["--log-json", "--verbose"]):
        ran = CliRunner().invoke(app, ["serve", "--instances", "9", "--port", "0", *words])
        assert ran.exit_code == 2
        assert "instance 9" in ran.stderr
    assert told == [{"verbose": False, "as_json": False}, {"verbose": True, "as_json": True}]
