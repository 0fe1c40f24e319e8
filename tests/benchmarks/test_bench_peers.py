"""Ours and others in turn: the peers' folders, the record, and what fails of one alone."""

import json
import os
import select
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

import dev
from benchmarks import tools
from benchmarks.cases import ContestCase, PeerFolders, RecordOptions, parse_worlds
from benchmarks.peering import contest, peers
from benchmarks.peering.contest import GrowingRecord, measure_peers
from benchmarks.peering.ours import WORKLOADS
from benchmarks.peering.peers import ContestantError, ask_process, ensure_environment, read_peers
from benchmarks.report.page import peers_text
from benchmarks.report.records import BenchRecord
from tests.benchmarks.records import faults
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.ranging import ScannerSettings

FOLDER = dev.ROOT / "benchmarks" / "peers"
CLOCK = """
import sys, time
from pathlib import Path
sys.path.insert(0, {clock!r})
from clock import measure, read_options
options = read_options()
if options.variant == "broken":
    sys.exit("no such variant")
if options.worlds == 999:
    held = Path(__file__).with_name("held").open("wb", buffering=0)
    held.write(b"x")
    time.sleep(600)
measure(lambda state: time.sleep(0.001), None, options, 0.1, ("numpy",), "cpu")
"""
DESCRIPTION = """
name: Toy
variants: {fine: {beams: 7}, broken: {has: nothing}}
robot: nothing
has: a wait
lacks: all else
settings: as it is
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


def test_what_is_told_may_differ_by_variant(folder):
    (vmas,) = read_peers(FOLDER, ["vmas"])
    with_beams, without = vmas.about("navigation"), vmas.about("navigation without beams")
    assert (with_beams["beams"], without["beams"]) == (12, 0)
    assert "contacts between discs" in with_beams["has"]
    assert "contacts between discs" not in without["has"]  # `collisions=False` leaves both away
    assert "contacts between discs" in without["lacks"]
    assert with_beams["robot"] == without["robot"]
    (toy,) = read_peers(folder)
    assert (toy.about("fine")["has"], toy.about("broken")["has"]) == ("a wait", "nothing")


@pytest.fixture
def asked(monkeypatch):
    """What was asked of ours, which answers at once; peers run in our own environment."""
    asked = []

    def ask(words, limit):
        if "benchmarks.peering.ours" in words:
            asked.append(words)
            return {
                "warm_up": 1, "first_s": 1.0, "times_s": [0.5, 0.25, 1.0], "period_s": 0.05, "steps": 3,
                "device": "host", "versions": {"python": "3"},
            }  # fmt: skip
        return ask_process([sys.executable, *words[1:]], limit)

    monkeypatch.setattr(contest, "ask_process", ask)
    monkeypatch.setattr(contest, "ensure_environment", lambda peer, where, install: where)
    return asked


def test_a_run_has_ours_and_theirs_and_what_failed(folder, asked, tmp_path):
    case = ContestCase(size=["4x2", "8x2"], engines=["c"], steps=3, repeats=3)
    file = tmp_path / "peers.jsonl"
    text = measure_peers(
        case, PeerFolders(folder=folder, environments=tmp_path), RecordOptions(json=file, note="toy size")
    )
    record = json.loads(file.read_text())
    assert faults(record) == []
    rows = {(row["who"], row["variant"], row["worlds"]): row for row in record["rows"]}
    assert len(rows) == 2 * (3 + 2)
    ours = rows["usarmjx", "c, whole", 8]
    assert ours["robot_steps_per_s"] == pytest.approx(8 * 2 * 3 / 0.5)
    assert ours["robot_seconds_per_s"] == pytest.approx(ours["robot_steps_per_s"] * 0.05)
    assert (ours["speed"]["warm_up"], ours["speed"]["compile_s"]) == (1, 0.5)
    theirs = rows["Toy", "fine", 4]
    assert theirs["speed"]["warm_up"] == 2
    assert record["note"] == "toy size"
    assert theirs["robot_steps_per_s"] < 4 * 2 * 3 / 0.001
    assert (theirs["beams"], theirs["authors"]) == (7, "it waits well")
    assert rows["Toy", "broken", 4]["missing"] == "no such variant"
    assert "no such variant" in text
    assert {words[words.index("--part") + 1] for words in asked} == {"whole", "blind", "bare"}
    assert "| on |" not in peers_text([BenchRecord("", record)])  # all of them on the host


def test_variants_are_chosen_by_name(folder, asked, tmp_path):
    said = []
    case = ContestCase(engines=["c"], steps=1, repeats=1, variants=["blind", "fine"])
    measure_peers(case, PeerFolders(folder=folder, environments=tmp_path), say=said.append)
    assert said[::2] == ["Toy, fine: 64 x 4", "usarmjx, c, blind: 64 x 4"]
    assert said[3] == f"  {64 * 4 * 3 / 0.5:,.0f} robot-steps/s on host"
    wrong = ContestCase(engines=["c"], variants=["fine", "12 beams, open ground"])
    with pytest.raises(UnknownNameError, match=r"'fine', 'broken', 'whole', 'blind', 'bare'$"):
        measure_peers(
            wrong, PeerFolders(folder=folder, environments=tmp_path)
        )  # engine c is not measured with twelve


def test_who_ran_on_the_processor_is_no_row_of_a_gpu(folder, asked, monkeypatch, tmp_path):
    gpu = SimpleNamespace(platform="gpu", device_kind="Toy GPU")
    monkeypatch.setattr(contest.jax, "devices", lambda: [gpu])
    found = {
        "warm_up": 1, "first_s": 1.0, "times_s": [0.5], "period_s": 0.05, "steps": 1, "versions": {},
    }  # fmt: skip
    devices = {"whole": "Toy GPU", "blind": "cpu", "bare": "cpu"}

    def ask(words, limit):
        if "--engine" not in words:
            return ask_process([sys.executable, *words[1:]], limit)
        part = words[words.index("--part") + 1]
        return {**found, "device": "host" if "c" in words else devices[part]}

    monkeypatch.setattr(contest, "ask_process", ask)
    file = tmp_path / "peers.jsonl"
    chosen = ["fine", "whole", "blind"]
    case = ContestCase(engines=["c", "jax"], variants=chosen)
    measure_peers(case, PeerFolders(folder=folder, environments=tmp_path), RecordOptions(json=file))
    record = json.loads(file.read_text())
    assert faults(record) == []
    rows = {f"{row['who']}, {row['variant']}": row for row in record["rows"]}
    assert rows["Toy, fine"]["missing"] == "asked for a GPU, has only cpu"
    assert rows["usarmjx, jax, blind"]["missing"] == "asked for a GPU, ran on cpu"
    assert rows["usarmjx, jax, whole"]["device"] == "Toy GPU"
    assert rows["usarmjx, c, blind"]["device"] == "host"
    table = peers_text([BenchRecord("", record)])
    assert "| load | on |" in table
    assert table.count("| Toy GPU |\n") == 1
    assert table.count("| host |\n") == 3


def test_a_record_is_in_its_file_after_each_row(tmp_path):
    file = tmp_path / "new" / "peers.jsonl"
    record = GrowingRecord(tools.record_header("peers", note="toy"), {}, file)
    told = {
        name: "" for name in ("who", "variant", "robot", "has", "lacks", "settings", "authors", "citation")
    }
    row = {**told, "beams": 0, "robots": 1, "missing": "not now"}
    for worlds in (1, 2):
        record.add({**row, "worlds": worlds})
        with file.open("a") as another:
            another.write(f"another, {worlds}\n")
    first, *others = file.read_text().splitlines()
    assert others == ["another, 1", "another, 2"]
    assert faults(json.loads(first)) == []
    assert [each["worlds"] for each in json.loads(first)["rows"]] == [1, 2]
    assert json.loads(first)["note"] == "toy; not finished: later rows are missing"
    record.finish()
    first, *others = file.read_text().splitlines()
    assert others == ["another, 1", "another, 2"]
    assert json.loads(first)["note"] == "toy"


@pytest.mark.skipif(os.name == "nt", reason="no named pipes there")
def test_a_pipe_gets_the_record_when_it_is_finished(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    end = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    record = GrowingRecord(tools.record_header("peers"), {}, pipe)
    record.add({"who": "", "variant": "", "worlds": 1, "robots": 1, "missing": "not now"})
    record.finish()
    (line,) = os.read(end, 1 << 20).splitlines()
    os.close(end)
    assert len(json.loads(line)["rows"]) == 1


@pytest.mark.skipif(os.name == "nt", reason="no such signal there")
def test_sigterm_ends_the_process_that_measures_and_keeps_the_rows(folder, tmp_path):
    python = tmp_path / "environments" / "toy" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    held = tmp_path / "toy" / "held"  # a pipe of which the peer has the other end as long as it lives
    os.mkfifo(held)
    end = os.open(held, os.O_RDONLY | os.O_NONBLOCK)
    file = tmp_path / "peers.jsonl"
    words = (
        f"-m usarmjx bench peers --folder {folder} --environments {tmp_path / 'environments'} --no-install "
        f"--engine c --variant fine --size 4x2 --size 999x2 --json {file}"
    )
    run = subprocess.Popen(
        [sys.executable, *words.split()], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        assert select.select([end], [], [], 120)[0], "the peer was not started"
        assert os.read(end, 1) == b"x"
        assert json.loads(file.read_text())["note"] == "not finished: later rows are missing"
        run.send_signal(signal.SIGTERM)
        out, _ = run.communicate(timeout=60)
    finally:
        run.kill()
    assert run.returncode == 0
    assert "4 x 2" in out
    record = json.loads(file.read_text())
    assert record["note"] == "interrupted: later rows are missing"
    assert [row["worlds"] for row in record["rows"]] == [4]
    assert select.select([end], [], [], 10)[0], "the peer runs on"
    assert os.read(end, 1) == b""
    os.close(end)


@pytest.mark.parametrize("said", [None, "true"])
def test_the_process_that_starts_the_others_spares_a_gpus_memory(monkeypatch, said):
    name, seen = "XLA_PYTHON_CLIENT_PREALLOCATE", []
    monkeypatch.delenv(name, raising=False)
    if said is not None:
        monkeypatch.setenv(name, said)
    monkeypatch.setattr(tools.jax, "devices", lambda: seen.append(os.environ[name]))
    tools.spare_memory()
    assert seen == ["false"]
    assert os.environ.get(name) == said  # of others as it was


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
    folders = PeerFolders(folder=folder, environments=tmp_path)
    assert "12 beams, open ground" in measure_peers(ContestCase(engines=["c", "planar"]), folders)
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
    from benchmarks.peering import ours

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
    odd = DESCRIPTION.replace("{has: nothing}", "{colour: red}")
    (folder / "toy" / "peer.yaml").write_text(odd)
    with pytest.raises(UsageError, match="'broken' cannot have 'colour', but robot, has"):
        read_peers(folder)


def test_processes_that_say_nothing_or_take_too_long():
    with pytest.raises(ContestantError, match="said no figures"):
        ask_process([sys.executable, "-c", "print('hello')"], 60.0)
    with pytest.raises(ContestantError, match="said no 'first_s'"):
        ask_process([sys.executable, "-c", "print('{\"warm_up\": 1}')"], 60.0)
    with pytest.raises(ContestantError, match=r"not done after 0\.1 s"):
        ask_process([sys.executable, "-c", "import time; time.sleep(60)"], 0.1)
    assert peers.python_of(dev.ROOT).parent.name in ("bin", "Scripts")


def test_sizes():
    assert ContestCase(size=["4096x16", "1x1"]).sizes == [(4096, 16), (1, 1)]
    for bad in ("4096", "0x4", "4x", "axb", "4x-1"):
        with pytest.raises(UsageError, match="WORLDSxROBOTS"):
            parse_worlds(bad)
