"""The spectator's page in a browser: its console opens by a key, answers, and keeps what is typed."""

from tests.server.peers import serving
from tests.server.watchers import CYCLOPS, classes, gallery
from usarmjx.server.pictures.spectator_server import SpectatorServer, SpectatorSettings

TYPED = "editactor name=Eye msgTimer=0.5"


def press(page, key, where="window"):
    page.js(f"{where}.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}})); 1")


def test_the_console_opens_answers_and_closes(browser):
    with classes():
        world = gallery()
        world.spawn(CYCLOPS, "Eye", (0.0, 0.0, 0.188), (0.0, 0.0, 0.0))
        service = SpectatorServer(world, SpectatorSettings(port=0, size=(96, 72)))
        with serving(world, [service]):
            page = browser.open(f"http://127.0.0.1:{service.port}/")
            page.wait("document.getElementById('caption')?.textContent.startsWith('free view')")
            assert page.js("panel.hidden")
            press(page, "`")
            assert page.js("!panel.hidden && document.activeElement === line")
            page.js(f"line.value = '{TYPED}'")
            press(page, "Enter", "line")
            page.wait("told.textContent.includes('msgTimer=0.5 Weight')")
            assert world.robots[0].spec.msg_timer == 0.5
            assert page.js("line.value") == ""
            press(page, "ArrowUp", "line")
            assert page.js("line.value") == TYPED
            press(page, "w", "line")
            assert page.js("held.size") == 0, "what is typed does not move the view"
            press(page, "Escape", "line")
            assert page.js("panel.hidden")
            press(page, "w")
            assert page.js("held.has('w')")
            assert page.errors == []
            assert page.hosts == {f"127.0.0.1:{service.port}"}
            page.close()
