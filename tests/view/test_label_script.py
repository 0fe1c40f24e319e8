"""Texts of the live page do not cover each other: their rectangles as the page's own shader places them."""

import numpy as np
import pytest

from tests.view.scenery import seers
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.view.page import ViewerPage

PLACES = ((0.0, 0.0, 0.0), (0.6, 0.0, 0.0), (0.0, 0.6, 0.0), (0.6, 0.6, 0.0))
ATLAS_DEPTH, REFERENCE_HEIGHT = 10.0, 800.0
"""Depth and height of the picture for which the shader's unit of texts of constant size holds."""
READ = """(() => {
 const {scene, camera} = window.__viserMutable, boards = [];
 scene.traverse(one => {
  const uniforms = one.material?.uniforms, own = one.geometry?.attributes;
  if (!uniforms?.uLabelData || uniforms.uAtlas || !own.aRect) return;
  boards.push({
   ids: [...own.aLabelIndex.array],
   rect: [...own.aRect.array],
   unit: [...own.aParams.array],
   places: [...uniforms.uLabelData.value.image.data.slice(0, 400)],
   fov: uniforms.uFovScale.value, height: uniforms.uViewportHeight.value,
  });
 });
 const {matrixWorldInverse, projectionMatrix} = camera;
 return {boards, view: [...matrixWorldInverse.elements], projection: [...projectionMatrix.elements]};
})()"""
SWITCH = """(() => {
 const {scene, requestRender} = window.__viserMutable;
 window.arrange ??= scene.onBeforeRender;
 scene.onBeforeRender = ON ? window.arrange : () => {};
 requestRender();
 return new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))));
})()"""


def rectangles(window, on):
    """Left, low, right and high of each visible text [pixels] (texts, 4), by the shader, and the view."""
    window.js(SWITCH.replace("ON", "true" if on else "false"))
    seen = window.js(READ)
    view, projection = (np.array(seen[key]).reshape(4, 4).T for key in ("view", "projection"))
    found = []
    for board in seen["boards"]:
        places = np.array(board["places"]).reshape(-1, 4)[np.array(board["ids"], int)]
        rects, units = np.array(board["rect"]).reshape(-1, 4), np.array(board["unit"]).reshape(-1, 2)[:, 1]
        for (*place, shown), (left, low, width, tall), unit in zip(places, rects, units, strict=True):
            if not shown:
                continue
            depth = -(view @ [*place, 1.0])[2]
            scale = unit * depth / ATLAS_DEPTH * board["fov"] * REFERENCE_HEIGHT / board["height"]
            ends = []
            for x, y in ((left, low), (left + width, low + tall)):
                world = np.array(place) + scale * (x * view[0, :3] + y * view[1, :3])
                clip = projection @ view @ [*world, 1.0]
                ends += (clip[:2] / clip[3] * board["height"] / 2).tolist()
            found.append(ends)
    return np.array(found).reshape(-1, 4), view


def overlaps(found):
    """Number of pairs of rectangles that cover each other."""
    one, other = found[:, None], found[None]
    meets = (one[..., :2] < other[..., 2:]) & (other[..., :2] < one[..., 2:])
    return int(np.triu(meets.all(-1), 1).sum())


@pytest.fixture(scope="module")
def meeting(browser):
    """Page and window of four robots that stand together, with their radio links."""
    world, _ = seers(*PLACES)
    page = ViewerPage(ServedSource([world], RadioSettings()))
    page.show_layers(["Radio links"])
    window = browser.open(f"http://127.0.0.1:{page.server.get_port()}/")
    yield page, window
    window.leave()
    page.close()


@pytest.mark.alone
def test_texts_of_robots_that_meet_do_not_cover_each_other(meeting):
    page, window = meeting
    texts = len(PLACES) * (len(PLACES) + 1) // 2  # names and links

    def drawn():
        """Texts with and without the script from the same view, once all are there."""
        page.refresh()
        (kept, first), (plain, second) = rectangles(window, on=True), rectangles(window, on=False)
        whole = len(plain) >= texts and len(plain) > len(kept) >= len(PLACES)
        return (kept, plain) if whole and np.array_equal(first, second) else None

    window.wait(lambda: page.refresh() or page.viewers)
    window.wait("!!window.__viserMutable?.scene?.onBeforeRender.length")
    kept, plain = window.wait(drawn)
    assert overlaps(kept) == 0
    assert overlaps(plain) > 0, "they would"
    heights = (plain[:, 3] - plain[:, 1]).round(2)
    names = heights == heights.max()
    assert names.sum() == len(PLACES)
    lowest = plain[names][:, 1].min()  # the nearest robot's
    assert np.isclose(kept, plain[names][plain[names][:, 1] == lowest][0], atol=0.5).all(1).any(), (
        "in its place"
    )
    assert ((kept[:, 3] - kept[:, 1]).round(2) == heights.max()).sum() >= len(PLACES) - 1, "names go first"
    assert window.errors == []
