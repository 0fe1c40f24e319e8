"""The live page in a browser, as people use it: two worlds, two people."""

import logging
import time
from functools import partial

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.peers import looping
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.runtime.loop import StepClock
from usarmjx.server.viewing.controls import ServedControls
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.viewing.viewer_service import ViewerService, ViewerSettings
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.view.controls import ControlLock

pytestmark = pytest.mark.alone

PATIENCE = 60.0  # s
STALL = 12.0  # s, of a page
OWN_FOLDERS = 2  # of who has the controls: of the run, and for a new robot
CLASS = "Zerg"
TAKE, LEAVE = "Take the controls", "Give the controls back"


class Show:
    """Worlds with a live page."""

    def __init__(self):
        self.worlds = [DynamicWorld(FLAT, max_robots=3, number=n) for n in range(2)]
        self.clock, self.lock = StepClock(), ControlLock()
        self.servers = [BotServer(world, BotServerSettings(port=0)) for world in self.worlds]
        self.controls = ServedControls(self.servers, self.clock)
        source = ServedSource(self.worlds)

        def make_page(server):
            from usarmjx.view.page import ViewerPage
            from usarmjx.view.user_panels import UserPanels

            panels = [partial(UserPanels, lock=self.lock)]
            return ViewerPage(source, server=server, controls=self.controls, panels=panels)

        self.service = ViewerService(source, ViewerSettings(), make_page=make_page)
        self.servers[0].services += [self.controls, self.service]

    @property
    def page(self):
        return self.service.page

    @property
    def url(self):
        return f"http://127.0.0.1:{self.service.port}/"

    def robot(self, name):
        return next(robot for robot in self.worlds[0].robots.values() if robot.name == name)

    def place(self, name):
        return np.array(self.worlds[0].state(self.robot(name)).pos)

    def setpoint(self, name):
        return np.array(self.robot(name).command.setpoint)

    def names(self):
        return sorted(robot.name for robot in self.worlds[0].robots.values())


@pytest.fixture(scope="module")
def show():
    made = Show()
    made.worlds[0].spawn(ROBOTS.get(CLASS), "Own", (-1.5, -1.0, 0.1), (0.0, 0.0, 0.0))
    with looping(made.servers, made.clock):
        yield made


@pytest.fixture(scope="module")
def me(show, browser):
    page = browser.open(show.url)
    page.wait_for_text(TAKE)
    return page


@pytest.fixture(scope="module")
def other(show, browser, me):
    """Somebody else, while the first one has the controls."""
    if show.lock.holder is None:
        me.click("button", TAKE)
        me.wait_for_text(LEAVE)
    page = browser.open(show.url)
    page.wait_for_text("somebody has the controls")
    return page


@pytest.fixture(autouse=True)
def report(show, browser):
    """Print what the server and the pages know, for a test that fails."""
    yield
    lock, viewers = show.lock.holder, {n: one.robot for n, one in show.page.viewers.items()}
    print(f"holder {lock}, viewers {viewers}, errors {[page.errors for page in browser.pages]}")
    for number in range(len(show.worlds)):
        print(number, show.controls.status(number))


def wait_until(done):
    deadline = time.monotonic() + PATIENCE
    while not done() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert done()


def test_it_loads_and_asks_nobody_else(show, me):
    me.wait_for_text("real time")
    assert me.hosts == {show.url.split("/")[2]}
    assert me.errors == []


def test_the_loading_state_goes_when_the_world_is_drawn_at_full_strength(me):
    me.wait("!document.querySelector('#usarmjx-loading')")
    solids = "let n = 0; __viserMutable.scene.traverse(o => { if (o.isInstancedMesh2) n++; }); return n;"
    assert me.js(f"(() => {{ {solids} }})()") > 0
    assert me.js("getComputedStyle(document.querySelector('#root canvas')).opacity") == "1"
    assert me.js("document.title").startswith("usarmjx \u00b7 ")
    assert "Dev Settings" not in me.text()


def test_the_scoreboard_shows_nothing_old_while_the_panel_is_folded_away(show, me):
    me.wait("document.querySelector('#usarmjx-head')?.hidden === false")
    show.page.server.gui.main_panel.minimize()
    me.wait("document.querySelector('#usarmjx-head').hidden")
    show.page.server.gui.main_panel.expand()
    me.wait("!document.querySelector('#usarmjx-head').hidden")


def test_another_world_is_shown(show, me):
    me.choose("World", "world 1")
    wait_until(lambda: show.page.world == 1)
    me.choose("World", "world 0")
    wait_until(lambda: show.page.world == 0)


def test_the_view_follows_a_robot_and_lets_go(show, me):
    me.click("button", "Next robot")
    me.wait_for_text("You are with Own")
    me.wait_for_text("driven")  # its state is told
    me.click("button", "Free")
    me.wait_for_text("You look freely")


def test_every_layer_can_be_switched(show, me, caplog):
    me.unfold("Show", "Laser fans")
    for layer in show.page.layers.values():
        was_on = layer in show.page._switches.on
        me.tick(layer.name)
        wait_until(lambda layer=layer, was_on=was_on: (layer in show.page._switches.on) != was_on)
    assert [record.message for record in caplog.records if record.levelno >= logging.ERROR] == []


def test_who_has_the_controls_spawns_drives_and_removes(show, me):
    me.click("button", TAKE)
    me.wait_for_text(LEAVE)
    me.unfold("New robot", "Class")
    me.click("button", "Spawn")
    wait_until(lambda: len(show.names()) == 2)
    (name,) = set(show.names()) - {"Own"}
    me.choose("Robot", name)
    me.wait_for_text("from this page")
    forward = me.place(".drivepad button[aria-label=ahead]")
    before = show.place(name)
    me.press(forward)
    wait_until(lambda: np.linalg.norm(show.place(name)[:2] - before[:2]) > 0.1)
    me.release(forward)
    wait_until(lambda: not show.setpoint(name).any())
    me.js("document.querySelector('.drivepad').focus()")
    me.key("ArrowLeft")
    wait_until(lambda: show.setpoint(name)[1] > 0 > show.setpoint(name)[0])
    me.key("ArrowLeft", down=False)
    wait_until(lambda: not show.setpoint(name).any())
    me.click("button", "Remove")
    wait_until(lambda: show.names() == ["Own"])


def test_what_joins_the_panel_does_not_keep_an_arrow_held(show, me):
    (user,) = show.page.viewers.values()
    show.controls.spawn(0, CLASS, "Held", (1.0, -1.0, 0.0), 0.0)
    me.choose("Robot", "Held")
    me.wait_for_text("from this page")
    ahead = me.place(".drivepad button[aria-label=ahead]")
    for hold, release in (
        (lambda: me.press(ahead), lambda: me.release(ahead)),
        (lambda: me.key("ArrowUp"), lambda: me.key("ArrowUp", down=False)),
    ):
        me.js("document.querySelector('.drivepad').focus()")
        hold()
        wait_until(lambda: show.setpoint("Held").any())
        me.js("document.querySelector('.drivepad').old = true")
        note = user.client.gui.add_markdown("something new")
        me.wait("!document.querySelector('.drivepad').old")
        release()
        wait_until(lambda: not show.setpoint("Held").any())
        note.remove()
    show.controls.remove(0, show.robot("Held").slot)
    wait_until(lambda: show.names() == ["Own"])
    assert me.errors == []


def test_time_stands_still_goes_by_steps_and_on(show, me):
    me.click("button", "Pause")
    wait_until(lambda: show.clock.paused)
    me.wait_for_text("paused")
    before = show.worlds[0].time
    me.click("button", "Single step")
    wait_until(lambda: show.worlds[0].time > before)
    assert show.worlds[0].time == pytest.approx(before + show.worlds[0].period)
    me.click("button", "Go on")
    wait_until(lambda: not show.clock.paused)
    me.click("button", "Reset")
    me.click("button", "Reset it")
    wait_until(lambda: int(show.worlds[0].one_world()[0].episode) == 1)


def test_a_page_that_stands_still_takes_its_news_without_complaint(show, me):
    (user,) = show.page.viewers.values()
    folders = user.client.gui._container_handle_from_uuid
    wait_until(lambda: len(folders) == 1 + OWN_FOLDERS)
    show.controls.spawn(0, CLASS, "Brief", (1.0, -1.0, 0.0), 0.0)
    me.choose("Robot", "Brief")
    me.wait_for_text("from this page")
    assert len(folders) > 1 + OWN_FOLDERS
    me.js(f"setTimeout(() => {{ const end = Date.now() + {1000 * STALL}; while (Date.now() < end); }}, 0), 1")
    show.controls.remove(0, show.robot("Brief").slot)
    wait_until(lambda: show.names() == ["Own"])
    me.wait_for_text("from this page", there=False)
    wait_until(lambda: len(folders) == 1 + OWN_FOLDERS)
    assert me.errors == []


def test_a_second_person_only_watches(show, me, other):
    show.controls.spawn(0, CLASS, "Mine", (1.0, 1.0, 0.0), 0.0)
    other.choose("Robot", "Mine")
    other.wait_for_text("from this page")
    for words in (TAKE, "Pause", "New robot", "Take over"):
        assert words not in other.text()
    assert other.js("document.querySelector('.drivepad')") is None
    assert me.errors + other.errors == []


def test_who_goes_stops_its_robots_and_frees_the_controls(show, me, other):
    me.choose("Robot", "Mine")
    me.wait_for_text("from this page")
    forward = me.place(".drivepad button[aria-label=ahead]")
    me.press(forward)
    wait_until(lambda: show.setpoint("Mine").any())
    me.leave()
    wait_until(lambda: show.lock.holder is None)
    wait_until(lambda: not show.setpoint("Mine").any())
    other.click("button", TAKE)
    other.wait_for_text("Pause")


def test_on_a_phone_all_can_be_reached(other):
    other.resize(390, 800, mobile=True)
    other.wait("innerWidth === 390")
    other.place(".drivepad")
    assert other.js("document.documentElement.scrollWidth <= innerWidth"), "nothing sticks out"
    assert other.errors == []
    other.leave()
