"""Makes the pictures of docs/viewing.md and the gallery, and the film of the README.

`python -m tests.view.pictures FOLDER` makes all, `... FOLDER still-red film` some. Stills and the film are
`usarmjx film`'s of recordings made here; the others are screenshots of the page.

Worlds run here, step by step, and a browser without a screen looks at their page between two steps: however
slow it draws, the film's time is the worlds'.
"""

import base64
import io
import math
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from PIL import Image

from tests.view.browser import Browser, find_browser
from usarmjx.cli.demo import ARENA, EPISODE_STEPS, STARTS, TASK, starting_at
from usarmjx.cli.recordings import recorded, recorded_episode
from usarmjx.models.files.load import find_arena
from usarmjx.models.robots import ROBOTS
from usarmjx.plots.films.film import FilmPlan, save_film
from usarmjx.plots.play import record_episode
from usarmjx.recording.reader import Recording
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.control import CommandUpdate
from usarmjx.train.baselines import BASELINES
from usarmjx.train.make import make
from usarmjx.view.page import ViewerPage

SIZE, FILM_SIZE = (1280, 720), (800, 450)
FILM_SPAN, FILM_SPEED, FILM_RATE = (1.0, 15.0), 3.0, 6.0
DRAWN = 6.0
"""A processor has drawn a page after so long [s]."""
MANY = 40
SLOW = 900.0
"""So long a picture may take on a busy machine [s]."""
COUNT = "window.drawn = 0; (f => f(f))(f => { window.drawn++; requestAnimationFrame(() => f(f)); })"
TIDY = "document.querySelectorAll('.mantine-Notification-root').forEach(e => e.remove())"
STEP = 0.2
"""Time between two reports of a robot [s]."""
STILL_TIME = 4.0
"""Simulated time of a still [s]."""
ARENAS = {
    "yellow": ("P2AT", "P2DX", "Zerg", "Kenaf"),
    "orange": ("P2AT", "Talon", "Zerg", "Lisa"),
    "red": ("Kenaf", "Talon", "Tarantula", "P2AT"),
    "road": ("Sedan", "Hummer", "P2AT"),
    "pool": ("Submarine",),
}


def make_world(arena, robots, seed=1):
    """A world with robots at its start poses, one of each class, which turn and drive."""
    world = DynamicWorld(find_arena(arena), seed=seed)
    starts = world.arena.starts
    for number, name in enumerate(robots):
        spec, start = ROBOTS.get(name), starts[number % len(starts)]
        aside = 1.5 * (number // len(starts))
        at = (start.at[0] + aside, start.at[1], start.at[2] + spec.dimensions[2] / 2)
        world.prepare(spec)
        robot = world.spawn(spec, name, at, (0.0, 0.0, start.yaw))
        drive(world, robot, 0.8, 1.0 + 0.1 * number)
    return world


def drive(world, robot, left, right):
    """Set the wheels of a robot that has wheels or tracks."""
    if {"Left", "Right"} <= set(robot.spec.drive.full_scale):
        world.update_command(robot, CommandUpdate(drive={"Left": left, "Right": right}))


def advance(worlds, seconds):
    """Let worlds go on, and their robots read their sensors."""
    for world in worlds:
        for _ in range(max(1, math.ceil(seconds / world.period - 1e-9))):
            world.step()
        world.observe(list(world.robots.values()))


class Studio:
    """A page of worlds in a browser's window.

    Args:
        browser: The browser.
        worlds: The worlds.
        size: Of the window [pixels].
    """

    def __init__(self, browser, worlds, size):
        self.worlds = worlds
        self.page = ViewerPage(ServedSource(worlds), title=worlds[0].arena.name)
        self._window = browser.open(f"http://127.0.0.1:{self.page.server.get_port()}/")
        self._window.patience = SLOW
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
        self._window.call("Emulation.setDeviceMetricsOverride", **metrics)
        self._window.wait(lambda: self.page.refresh() or self.page.viewers)
        self.draw(DRAWN)

    @property
    def viewer(self):
        """Who looks."""
        return next(iter(self.page.viewers.values()))

    def draw(self, seconds):
        """Let the browser draw for so long at least, and so often: what appears does so bit by bit."""
        end = time.monotonic() + seconds
        self._window.js(COUNT)
        while time.monotonic() < end or self._window.js("window.drawn") < MANY:
            self.page.refresh()
            self._window.js(TIDY)
            time.sleep(0.1)

    def look(self):
        """What the browser shows now."""
        self.page.refresh()
        self._window.js("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        data = self._window.call("Page.captureScreenshot", format="png")["data"]
        return Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")

    def close(self):
        """Close window and page."""
        self._window.leave()
        self.page.close()


def arena_picture(browser, name="orange"):
    """An arena with some robots in it, after some seconds."""
    world = make_world(name, ARENAS[name])
    advance([world], STILL_TIME)
    studio = Studio(browser, [world], SIZE)
    try:
        return studio.look()
    finally:
        studio.close()


def wall_picture(browser):
    """Sixteen worlds side by side."""
    worlds = [make_world("yellow", ("P2AT", "Zerg"), seed=n) for n in range(16)]
    for number, world in enumerate(worlds):
        advance([world], 0.5 * number + 1.0)
    studio = Studio(browser, worlds, SIZE)
    try:
        studio.page.choose_world(0, wall=True)
        studio.draw(2 * DRAWN)
        return studio.look()
    finally:
        studio.close()


def still(name, file):
    """The same arena and robots as `usarmjx film` shows them."""
    world = make_world(name, ARENAS[name])
    with tempfile.TemporaryDirectory(prefix="usarmjx-pictures-") as folder:
        path = Path(folder) / f"{name}.mcap"
        with recorded([world], path):
            while world.time < STILL_TIME:
                advance([world], STEP)
        save_film(Recording(path), file, FilmPlan(size=SIZE, span=(STILL_TIME - STEP, math.inf)))


def film(file):
    """Four robots of the demo that explore, as `usarmjx film` shows them."""
    arena = starting_at(find_arena(ARENA), STARTS)
    env = make(TASK, engine="c", arena=arena, episode_steps=EPISODE_STEPS)
    with tempfile.TemporaryDirectory(prefix="usarmjx-pictures-") as folder:
        path = Path(folder) / "explore.mcap"
        with recorded_episode(env, path, 0) as watch:
            record_episode(env, BASELINES.get(TASK)(env), FILM_SPAN[1], 0, watch)
        plan = FilmPlan(size=FILM_SIZE, span=FILM_SPAN, speed=FILM_SPEED, rate=FILM_RATE)
        save_film(Recording(path), file, plan)


def main(folder, *names):
    """Make some of the pictures, or all, in a folder."""
    folder = Path(folder)
    filmed = {f"still-{name}": partial(still, name, folder / f"film-{name}.jpg") for name in ARENAS}
    filmed["film"] = partial(film, folder / "viewing.gif")
    shot = {"orange": arena_picture, "wall": wall_picture}
    names = names or (*filmed, *shot)
    for name in filmed.keys() & set(names):
        filmed[name]()
        print(name, flush=True)
    if not (wanted := shot.keys() & set(names)):
        return
    binary = find_browser()
    if binary is None:
        sys.exit("no Chromium here")
    with tempfile.TemporaryDirectory(prefix="usarmjx-pictures-", ignore_cleanup_errors=True) as profile:
        browser = Browser(binary, profile)
        try:
            for name in wanted:
                shot[name](browser).save(folder / f"viewing-{name}.jpg", quality=85)
                print(name, flush=True)
        finally:
            browser.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
