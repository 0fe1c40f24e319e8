"""Viser's page with our name, colours, a loading state and a place for the scoreboard.

The page is one file. Viser serves a copy of it, with a script and a style sheet, from a folder of its own.
"""

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

import viser

LABEL_SCRIPT = """
(() => {
 const GAP = 2, STEADY = 6, LIFTS = 3;  // pixels, pixels, and places of a text: its own and those above
 const PIXELS = 40;  // of the library's unit of texts of constant size
 const lifted = new Map();
 // The library draws a rectangle behind each text; these meshes have all of them.
 const boards = scene => {
  const found = [];
  scene.traverse(one => {
   const uniforms = one.material?.uniforms;
   if (uniforms?.uLabelData && !uniforms.uAtlas && one.geometry.attributes.aRect) found.push(one);
  });
  return found;
 };
 const texts = (meshes, places, view, scale) => {
  const found = [];
  for (const {geometry} of meshes) {
   const {aLabelIndex, aRect, aParams} = geometry.attributes;
   for (let i = 0; i < aLabelIndex.count; i++) {
    const id = aLabelIndex.array[i], at = 4 * id, [x, y, z, shown] = places.slice(at, at + 4);
    const depth = -(view[2] * x + view[6] * y + view[10] * z + view[14]);
    if (!shown || !aParams.array[2 * i] || depth <= 0) continue;
    const [left, low, width, tall] = aRect.array.slice(4 * i, 4 * i + 4).map(
     one => one * aParams.array[2 * i + 1] * PIXELS);
    found.push({
     id, at, depth, width, tall,
     left: (view[0] * x + view[4] * y + view[8] * z + view[12]) / depth * scale + left,
     low: (view[1] * x + view[5] * y + view[9] * z + view[13]) / depth * scale + low,
    });
   }
  }
  return found.sort((a, b) => Math.abs(a.tall - b.tall) > .01 ? b.tall - a.tall : a.depth - b.depth);
 };
 const arrange = (scene, camera) => {
  const meshes = boards(scene);
  if (!meshes.length) return;
  const {uLabelData, uViewportHeight} = meshes[0].material.uniforms, places = uLabelData.value.image.data;
  const view = camera.matrixWorldInverse.elements;
  const scale = camera.projectionMatrix.elements[5] * uViewportHeight.value / 2, kept = [];
  for (const one of texts(meshes, places, view, scale)) {
   const before = lifted.get(one.id) ?? 0;
   const fits = lift => {
    const gap = lift < before ? STEADY : GAP, low = one.low + lift * (one.tall + GAP);
    return !kept.some(other =>
     one.left < other.left + other.width + gap && other.left < one.left + one.width + gap &&
     low < other.low + other.tall + gap && other.low < low + one.tall + gap);
   };
   let lift = 0;
   while (lift < LIFTS && !fits(lift)) lift++;
   lifted.set(one.id, lift);
   if (lift === LIFTS) { places[one.at + 3] = 0; continue; }
   const up = lift * (one.tall + GAP) * one.depth / scale;
   for (let axis = 0; axis < 3; axis++) places[one.at + axis] += up * view[4 * axis + 1];
   one.low += lift * (one.tall + GAP);
   kept.push(one);
  }
  uLabelData.value.needsUpdate = true;
 };
 const wait = setInterval(() => {
  const scene = window.__viserMutable?.scene;
  if (!scene) return;
  clearInterval(wait);
  scene.onBeforeRender = (renderer, same, camera) => arrange(same, camera);
 }, 100);
})();
"""
"""Before each picture, a text that would cover another one moves up by a line or two, or is hidden.

Larger texts keep their places before smaller ones, near ones before distant ones. A version of the library
with other names shows all texts where they are.
"""
PRODUCT = "usarmjx"
MARK = "<title>Viser</title>"
"""Text of viser's page that we replace; a version without it is served as it is."""
LIBRARY, HELD = "<script data-p=", '<script type="text/held" data-p='
"""Start of viser's script of 3 MB, and that of one which waits until ours runs it."""
BACKGROUND = "#e9eef2"
"""Colour of the page before anything is drawn, near that of the sky."""
ICON = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'%3E"
    "%3Crect width='32' height='32' rx='7' fill='%231f5fa8'/%3E%3Cpath d='M7 21h18l-3-9H10z' fill='white'/%3E"
    "%3Ccircle cx='11' cy='23' r='4' fill='%23ffc400'/%3E%3Ccircle cx='21' cy='23' r='4' fill='%23ffc400'/%3E"
    "%3C/svg%3E"
)
STYLE = """
html,body,#root>div,#root div[style*="background-color: rgb(255, 255, 255)"]{
 background:BACKGROUND!important;margin:0}
#root canvas{opacity:1!important}
#usarmjx-loading{position:fixed;inset:0;z-index:9999;display:flex;flex-direction:column;gap:.6em;
 align-items:center;justify-content:center;background:BACKGROUND;color:#23303d;
 font:600 1.6rem system-ui,sans-serif;transition:opacity .25s}
#usarmjx-loading small{font-weight:400;font-size:1rem;opacity:.75}
#usarmjx-head{position:fixed;top:.7em;left:.7em;z-index:9;width:max-content;max-width:calc(100vw - 1.4em);
 background:rgba(20,24,30,.82);color:#fff;border-radius:.5em;padding:.5em .8em;
 font:clamp(11.5px,.98vw,16px)/1.35 system-ui,sans-serif;max-height:38vh;overflow:auto;
 scrollbar-width:thin;scrollbar-color:#fff6 transparent}
#usarmjx-head:has(details[open]){max-height:calc(100vh - 6em)}
#usarmjx-head summary{font-weight:600;cursor:pointer}
#usarmjx-head table{border-collapse:collapse;margin-top:.4em;width:100%}
#usarmjx-head td,#usarmjx-head th{padding:.05em .7em .05em 0;white-space:nowrap;text-align:left}
#usarmjx-head td:first-child{opacity:.85}
#usarmjx-head th{font-weight:400;font-size:.85em;opacity:.65}
#usarmjx-head i{display:inline-block;width:.7em;height:.7em;border-radius:50%;margin-right:.45em}
#usarmjx-head b{display:inline-block;width:3em;height:.5em;background:#fff4;border-radius:.25em}
#usarmjx-head s{display:block;height:100%;border-radius:.25em}
#usarmjx-head ul{list-style:none;margin:.4em 0 0;padding:0;opacity:.9}
#usarmjx-head details{margin-top:.4em}
#usarmjx-head details summary{font-weight:400;opacity:.85}
.usarmjx-board{display:none}
.mantine-Notifications-root[data-position]{top:auto!important;bottom:1em}
button:has(.tabler-icon-adjustments){display:none!important}
@media (max-width:36em){
 [style*="max-height: 60%"],[style*="max-height: 60%"] [style*="width: 20em"]{width:100%!important}
 #usarmjx-head{font-size:12px;max-height:45vh}
 .mantine-Notifications-root[data-position]{bottom:4.5em}
}
"""
SCRIPT = """
(() => {
 const page = document.documentElement, phone = matchMedia('(max-width:36em)').matches;
 const wait = page.appendChild(document.createElement('div'));
 wait.id = 'usarmjx-loading';
 wait.innerHTML = 'PRODUCT<small>loading the world ...</small>';
 const PATIENCE = 20000, begun = performance.now();
 // The library's script keeps a browser busy for a second: it waits until the loading state is on the screen.
 const run = () => {
  const held = document.querySelector('script[type="text/held"]');
  if (!held) return;
  const script = document.createElement('script');
  Object.assign(script.dataset, held.dataset);
  script.textContent = held.textContent;
  held.replaceWith(script);
 };
 addEventListener('DOMContentLoaded', () => {
  requestAnimationFrame(() => setTimeout(run));
  setTimeout(run, 500);  // a window behind others draws nothing
 });
 // The library has its scene under these names, for tests of its own; without them time decides.
 const drawn = () => {
  const scene = window.__viserMutable?.scene, info = window.__viserTestpoints?.rendererInfo;
  let solids = 0;
  scene?.traverse(one => { if (one.isInstancedMesh || one.isInstancedMesh2) solids++; });
  return {solids, frames: info?.render.frame ?? 0};
 };
 let before = {solids: 0, frames: 0}, first = -1;
 const look = setInterval(() => {
  const now = drawn();
  if (now.solids > 0 && first < 0) first = now.frames;
  const whole = first >= 0 && now.frames > first && now.solids === before.solids;
  before = now;
  if (!whole && performance.now() - begun < PATIENCE) return;
  clearInterval(look);
  wait.style.opacity = 0;
  setTimeout(() => wait.remove(), 250);
 }, 100);
 let head, shut = false, told = false;
 const fill = (place, text) => { if (place.innerHTML !== text) place.innerHTML = text; };
 const show = board => {
  if (!head) {
   head = document.body.appendChild(document.createElement('details'));
   head.id = 'usarmjx-head';
   head.open = !phone;
   head.innerHTML = '<summary></summary><div></div><details><summary>legend</summary><div></div></details>';
  }
  const name = 'PRODUCT \\u00b7 ' + board.dataset.world;
  if (document.title !== name) document.title = head.firstChild.textContent = name;
  fill(head.children[1], board.firstChild.innerHTML);
  fill(head.lastChild.lastChild, board.lastChild.innerHTML);
  head.lastChild.hidden = !board.lastChild.childElementCount;
 };
 new MutationObserver(() => {
  const board = document.querySelector('.usarmjx-board');
  if (board) show(board);
  if (head) head.hidden = !board;  // a panel that is folded away has none, so nothing old stays
  if (phone && !shut && board) {
   const sheet = document.querySelector('[style*="max-height: 60%"] [style*="cursor: pointer"]');
   if (sheet) { shut = true; sheet.click(); }
  }
  if (!told) for (const one of document.querySelectorAll('.mantine-Notification-root')) {
   if (!one.textContent.startsWith('Software WebGL')) continue;
   told = true;
   setTimeout(() => one.querySelector('button')?.click(), 8000);
  }
 }).observe(page, {subtree: true, childList: true, characterData: true});
})();
"""


def page_text(original: str) -> str:
    """Return viser's page with our head; one that is not as known stays as it is."""
    if MARK not in original:
        return original
    style = STYLE.replace("BACKGROUND", BACKGROUND)
    script = SCRIPT.replace("PRODUCT", PRODUCT) + LABEL_SCRIPT
    head = f"<title>{PRODUCT}</title><style>{style}</style><script>{script}</script>"
    before, _, after = original.partition(MARK)
    first, _, rest = before.partition('<link\n      rel="icon"')
    if rest:
        before = f'{first}<link rel="icon" href="{ICON}" />' + rest.partition("/>")[2]
    return before + head + after.replace(LIBRARY, HELD, 1)


@cache
def page_folder() -> Path:
    """Return the folder with the page, which goes when the program ends."""
    original = Path(viser.__file__).parent / "client" / "build" / "index.html"
    folder = Path(tempfile.mkdtemp(prefix="usarmjx-page-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "index.html").write_text(page_text(original.read_text(encoding="utf-8")), encoding="utf-8")
    return folder
