"""Ours and others in turn: the peers' folders, the record, and what fails of one alone."""

import json
import sys

import pytest

import dev
from tests.bench.records import faults
from usarmjx.base.errors import UsageError
from usarmjx.bench.peering import contest, peers
from usarmjx.bench.peering.contest import ContestCase, measure_peers, parse_sizes
from usarmjx.bench.peering.ours import WORKLOADS
from usarmjx.bench.peering.peers import ContestantError, ask_process, ensure_environment, read_peers
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.ranging import ScannerSettings

FOLDER = dev.ROOT / "benchmarks" / "peers"
CLOCK = """
import sys, time
sys.path.insert(0, {clock!r})
from clock import measure, read_options
options = read_options()
if options.variant == "broken":
    sys.exit("no such variant")
measure(lambda state: time.sleep(0.001), None, options, 0.1, ("numpy",), "toy")
"""
DESCRIPTION = """
name: Toy
variants: {fine: {}, broken: {}}
robot: nothing
has: a wait
lacks: all else
settings: as it is
beams: {fine: 7}
authors: "it waits well"
citation: "Nobody, 2026"
"""


@pytest.fixture
def folder(tmp_path):
    """A peer that waits, in our own environment."""
    toy = tmp_path / "toy"
    toy.mkdir()
    (toy / "peer.yaml").write_text(DESCRIPTION)
    (toy / "measure.py").write_text(CLOCK.format(clock=str(FOLDER)))
    return tmp_path


def test_the_peers_that_we_have_describe_themselves():
    found = read_peers(FOLDER)
    assert {"VMAS", "JaxMARL", "MuJoCo", "MuJoCo Playground"} <= {peer.name for peer in found}
    for peer in found:
        needs = (peer.folder / "requirements.txt").read_text()
        assert "==" in needs, peer.name
        assert "://" not in needs, peer.name
        assert (peer.folder / "measure.py").is_file()
        assert bool(peer.authors) == bool(peer.citation)
        for variant in peer.variants:
            assert {"robot", "has", "lacks", "settings", "beams"} <= peer.about(variant).keys()


def test_a_run_has_ours_and_theirs_and_what_failed(folder, monkeypatch, tmp_path):
    asked = []

    def ask(words, limit):
        if "usarmjx.bench.peering.ours" in words:
            asked.append(words)
            return {
                "first_s": 1.0, "times_s": [0.5, 0.25, 1.0], "period_s": 0.05, "steps": 3,
                "device": "host", "versions": {"python": "3"},
            }  # fmt: skip
        return ask_process([sys.executable, *words[1:]], limit)

    monkeypatch.setattr(contest, "ask_process", ask)
    monkeypatch.setattr(contest, "ensure_environment", lambda peer, where, install: where)
    case = ContestCase(sizes=((4, 2), (8, 2)), engines=("c",), steps=3, repeats=3)
    file = tmp_path / "peers.jsonl"
    text = measure_peers(case, folder, tmp_path, file=file, note="toy size")
    record = json.loads(file.read_text())
    assert faults(record) == []
    rows = {(row["who"], row["variant"], row["worlds"]): row for row in record["rows"]}
    assert len(rows) == 2 * (3 + 2)
    ours = rows["usarmjx", "c, whole", 8]
    assert ours["robot_steps_per_s"] == pytest.approx(8 * 2 * 3 / 0.5)
    assert ours["robot_seconds_per_s"] == pytest.approx(ours["robot_steps_per_s"] * 0.05)
    theirs = rows["Toy", "fine", 4]
    assert theirs["robot_steps_per_s"] < 4 * 2 * 3 / 0.001
    assert (theirs["beams"], theirs["authors"]) == (7, "it waits well")
    assert rows["Toy", "broken", 4]["missing"] == "no such variant"
    assert "no such variant" in text
    assert {words[words.index("--part") + 1] for words in asked} == {"whole", "blind", "bare"}


def test_planar_is_measured_with_as_many_beams_as_others_have(monkeypatch, folder, tmp_path):
    asked = []

    def ask(words, limit):
        asked.append(words)
        raise ContestantError("not now")

    monkeypatch.setattr(contest, "ask_process", ask)
    monkeypatch.setattr(contest, "ensure_environment", lambda peer, where, install: where)
    monkeypatch.setattr(contest, "WORKLOADS", {name: part for name, part in WORKLOADS.items() if part.ini})
    (tmp_path / "peers").mkdir()
    folder = (tmp_path / "toy").rename(tmp_path / "peers" / "toy").parent
    assert "12 beams, open ground" in measure_peers(ContestCase(engines=("c", "planar")), folder, tmp_path)
    ours = [words for words in asked if "--ini" in words]
    assert [words[words.index("--engine") + 1] for words in ours] == ["planar"] * 2
    for words, part in zip(ours, contest.WORKLOADS.values(), strict=True):
        assert words[words.index("--ini") + 1] == str(tmp_path / part.ini)
        found = load_robots([dev.ROOT / "benchmarks" / part.ini], ROBOTS).robots
        (scanner,) = next(robot.sensors for robot in found if robot.name == "P2AT")
        keys = dict(scanner.defaults)
        beams = ScannerSettings(resolution=keys["Resolution"], scan_fov=keys["ScanFov"]).beams
        assert (beams, keys["ScanInterval"]) == (part.beams, 0.05)


def test_ours_is_measured_as_the_others_are(monkeypatch, capsys):
    from usarmjx.bench.peering import ours

    sizes = "--worlds 2 --robots 1 --steps 1 --repeats 2 --seed 0"
    monkeypatch.setattr(sys, "argv", f"ours --engine c --part bare --arena soccer {sizes}".split())
    ours.main()
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert len(found["times_s"]) == 2
    assert (found["period_s"], found["steps"], found["device"]) == (pytest.approx(0.05), 1, "host")


def test_what_is_wrong_with_peers_is_told(folder, tmp_path):
    with pytest.raises(UsageError, match="no peer is called 'gazebo'; known: toy"):
        read_peers(folder, ["gazebo"])
    with pytest.raises(UsageError, match="has no peers"):
        read_peers(tmp_path / "nowhere")
    (toy,) = read_peers(folder)
    with pytest.raises(ContestantError, match="Toy has no environment at"):
        ensure_environment(toy, tmp_path, install=False)
    (folder / "toy" / "peer.yaml").write_text("name: Toy\n")
    with pytest.raises(UsageError, match="missing 5 required"):
        read_peers(folder)


def test_processes_that_say_nothing_or_take_too_long():
    with pytest.raises(ContestantError, match="said no figures"):
        ask_process([sys.executable, "-c", "print('hello')"], 60.0)
    with pytest.raises(ContestantError, match=r"not done after 0\.1 s"):
        ask_process([sys.executable, "-c", "import time; time.sleep(60)"], 0.1)
    assert peers.python_of(dev.ROOT).parent.name in ("bin", "Scripts")


def test_sizes():
    assert parse_sizes(["4096x16", "1x1"]) == ((4096, 16), (1, 1))
    for bad in ("4096", "0x4", "4x", "axb", "4x-1"):
        with pytest.raises(UsageError, match="WORLDSxROBOTS"):
            parse_sizes([bad])
