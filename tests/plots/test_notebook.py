"""A batch in a notebook: the page has the worlds' triangles and poses, and needs nothing else."""

import base64
import contextlib
import io
import json
import re
from html import unescape

import numpy as np
import pytest

import dev
import usarmjx
from usarmjx.base.errors import UsageError
from usarmjx.models.generate import generate_many
from usarmjx.plots import view_batch
from usarmjx.plots.films.raster import solids_of
from usarmjx.view.training_page import BatchSource


@pytest.fixture(scope="module")
def batch():
    """Two worlds with different mazes."""
    scene = usarmjx.build_scene(generate_many("maze", 2, seed=7, size=(3, 3)), ["P2DX"])
    return usarmjx.Batch(scene, worlds=2, engine="c")


@pytest.fixture(scope="module")
def states(batch):
    first = batch.reset()
    return [first, batch.reset_where(first, np.array([True, False]))]


def array(text, kind):
    return np.frombuffer(base64.b64decode(text), kind)


def turned(quat, points):
    """Rotate points (..., 3) by a quaternion, w first, as the page's shader does."""
    w, v = quat[0], quat[1:]
    return points + 2 * np.cross(v, np.cross(v, points) + w * points)


def test_the_page_draws_the_triangles_where_films_draw_them(batch, states):
    """Oracle: `Solids.at`, which films use; single precision of coordinates up to 10 m leaves 1e-5 m."""
    data = json.loads(re.search(r"const data = (.*);\n", view_batch(batch, states).page())[1])
    source = BatchSource(batch, states[0], range(2))
    assert len(data["times"]) == 2
    assert len(data["shapes"]) == 2, "two mazes"
    for number, world in enumerate(data["worlds"]):
        solids = solids_of(source.drawing(number))
        corners, _, shown = solids.at(source.frame(number))
        shape = data["shapes"][world["shape"]]
        own = array(shape["corners"], np.float32).reshape(-1, 3, 3)
        poses = array(world["poses"], np.float32).reshape(2, world["bodies"], 8)[0]
        found, first = [], 0
        for body, count in shape["bodies"]:
            part, pose = own[first : first + count], poses[body]
            first += count
            if pose[7]:
                found.append(turned(pose[3:7], part) + pose[:3])
        np.testing.assert_allclose(np.concatenate(found), corners[shown & ~solids.is_floor], atol=1e-5)
        assert array(shape["colours"], np.uint8).shape == (4 * len(own),)


def test_the_page_needs_no_network(batch, states):
    view = view_batch(batch, states[0], worlds=[1])
    frame = view._repr_html_()
    page = unescape(re.search(r'<iframe srcdoc="([^"]*)"', frame)[1])
    assert page == view.page()
    assert not re.search(r"https?://|src=|import ", page)
    assert page.count("</script>") == 1
    assert repr(view).endswith("worlds=1, moments=1)")


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"worlds": [2]}, "no world 2: the batch has worlds 0 to 1"),
        ({"worlds": []}, "0 worlds in one picture, expected 1 to 16"),
        ({"height": 5}, "height 5 pixels, expected 120 to 2000"),
        ({"states": []}, "no state to show"),
    ],
)
def test_wrong_choices_are_named(batch, states, settings, named):
    with pytest.raises(UsageError, match=named):
        view_batch(batch, **{"states": states, **settings})


@pytest.mark.thorough
def test_the_notebook_of_results_runs(tmp_path, monkeypatch):
    """All cells in order: it plays a batch, and makes tables and curves of an evaluation and a sweep."""
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((dev.ROOT / "examples" / "results.ipynb").read_text("utf-8"))
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    names = {}
    with contextlib.redirect_stdout(io.StringIO()):
        for cell in cells:
            if not cell.startswith("%"):
                exec(compile(cell, "results.ipynb", "exec"), names)
    assert len(names["view"]._repr_html_()) > 10_000
    assert len(names["episodes"]) == 4
    assert len(names["cells"]) == 4
