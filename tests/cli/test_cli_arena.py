"""`usarmjx arena`: what it prints and writes, and that a mistake is one line and exit code 2."""

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from typer.testing import CliRunner

import dev
from usarmjx.cli.app import app
from usarmjx.models.arenas import ARENAS
from usarmjx.models.files.load import find_arena
from usarmjx.models.generate import Difficulty
from usarmjx.models.generate import generate as make
from usarmjx.plots import floor_plan, gallery

ROOM = """
name: DM-Room
extent: [[-3, 3], [-2, 2]]
starts:
- {tag: Door, at: [-1.5, 0, 0.188]}
shapes:
- {kind: box, size: [2, 0.05, 0.6], at: [0, 1.5, 0.6], surface: wall}
victims:
- {name: one, at: [0.5, 0, 0.12]}
"""


def invoke(*words):
    return CliRunner().invoke(app, ["arena", *map(str, words)])


@pytest.fixture
def room(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(ROOM)
    return path


def test_list_is_the_table_of_the_docs():
    """After a change: its output with --markdown into docs/arenas.md, `usarmjx arena gallery --out docs`."""
    result = invoke("list", "--markdown")
    assert result.exit_code == 0
    for name, arena in ARENAS:
        (row,) = re.findall(rf"^\| {re.escape(name)}\b.*$", result.output, re.MULTILINE)
        assert f"| {len(arena.starts)} |" in row
        assert arena.about in row
    assert result.output in (dev.ROOT / "docs" / "arenas.md").read_text(encoding="utf-8")


def test_pictures_of_the_docs_are_small():
    for name in ("arenas-plan.png", "arenas-view.png", "generated.png"):
        assert 10_000 < (dev.ROOT / "docs" / name).stat().st_size < 500_000, name


def test_draw_writes_what_was_asked_for(tmp_path: Path, room: Path, monkeypatch: pytest.MonkeyPatch):
    seen = []

    def small(arena, path):
        seen.append((arena.name, path))

    monkeypatch.setattr(gallery, "perspective", small)
    plan, view = tmp_path / "plan.png", tmp_path / "view.png"
    result = invoke("draw", room, "--png", plan, "--perspective", view)
    assert result.exit_code == 0, result.output
    assert result.output == f"wrote {plan}\nwrote {view}\n"
    assert seen == [("DM-Room", view)]
    assert (np.abs(imread(plan)[..., :3] - to_rgb(floor_plan.VICTIM)).max(-1) < 0.02).sum() > 500


def test_perspective_is_written(tmp_path: Path, room: Path):
    path = tmp_path / "new" / "view.png"
    gallery.perspective(replace(find_arena(room), victims=()), path, width=60, height=40)
    assert imread(path).shape[:2] == (40, 60)


def test_check_says_what_is_wrong(tmp_path: Path, room: Path):
    result = invoke("check", room, "--robot", "P2DX")
    assert (result.exit_code, result.output) == (0, "DM-Room: no faults found for a P2DX\n")
    room.write_text(ROOM.replace("[-1.5, 0, 0.188]", "[-1.5, 1.5, 0.188]"))
    plan = tmp_path / "plan.png"
    result = invoke("check", room, "--png", plan)
    assert result.exit_code == 1
    assert plan.exists()
    assert re.search(r"^start 'Door': a P2AT stands .* deep in shapes\[0\]", result.output, re.MULTILINE)


def test_generate_makes_the_same_arena_as_the_library(tmp_path: Path):
    yaml, xml, plan = tmp_path / "maze.yaml", tmp_path / "maze.xml", tmp_path / "maze.png"
    words = ["--kind", "maze", "--size", "4x3", "--seed", "5", "--difficulty", "0.8", "--clutter", "0.1"]
    result = invoke("generate", *words, "--yaml", yaml, "--xml", xml, "--png", plan)
    assert result.exit_code == 0, result.output
    level = Difficulty(wall_density=0.8, roughness=0.8, clutter=0.1, dead_ends=0.8, radio_shadow=0.8)
    arena = make("maze", (4, 3), 5, level)
    assert find_arena(yaml) == arena
    model = mujoco.MjModel.from_xml_path(str(xml))
    assert sum(model.geom(i).name.startswith("arena/") for i in range(model.ngeom)) == len(arena.shapes)
    first = result.output.splitlines()[0]
    assert first.startswith(f"DM-maze-4x3-5: 4.8 x 3.6 m, {len(arena.shapes)} solids, ")
    assert first.endswith(
        f"{len(arena.victims)} victims, {len(arena.tags)} tags, {len(arena.starts)} start poses"
    )
    assert plan.read_bytes().startswith(b"\x89PNG")


def test_radio_map_takes_a_file(tmp_path: Path, room: Path):
    out = tmp_path / "map.png"
    result = CliRunner().invoke(app, ["radio-map", str(room), "--out", str(out), "--from", "0,0"])
    assert result.exit_code == 0, result.output
    assert out.exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ["draw", "atlantis", "--png", "x.png"],
            "unknown arena 'atlantis'; known: .*DM-USAR_yellow.*or a file",
        ),
        (["draw", "nothing.yaml", "--png", "x.png"], "nothing.yaml: there is no such file"),
        (["draw", "yellow"], "name a picture: --png .* --perspective"),
        (["check", "yellow", "--robot", "Dalek"], "unknown robot 'Dalek'; known: .*P2AT"),
        (["generate", "--kind", "swamp"], "unknown kind of arena 'swamp'; .*known: .*maze"),
        (["generate", "--size", "big"], "size 'big' is not of the form 12x8"),
        (["generate", "--size", "2x2"], "size 2x2, expected 3 to"),
        (["generate", "--difficulty", "3"], "Difficulty: wall_density is 3.0, expected a number from 0 to 1"),
        (["generate", "--seed", "-1"], "seed -1, expected 0 or more"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(words: list, says: str):
    result = invoke(*words)
    assert result.exit_code == 2
    assert re.search(says, result.stderr), result.stderr
    assert result.stderr.startswith("usarmjx: ")
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
