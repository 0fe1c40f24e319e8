"""Viser's page with our name, colours, a loading state and a place for the scoreboard.

The page is one file. Viser serves a copy of it, with a script and a style sheet, from a folder of its own.
"""

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

import viser

from usarmjx.view.label_script import LABEL_SCRIPT

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
