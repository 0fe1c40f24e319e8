import pytest
import viser

from tests.view.browser import Browser, find_browser


@pytest.fixture(scope="session")
def _server():
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def scene(_server):
    """A scene of viser that is empty at first, and that nobody looks at."""
    yield _server.scene
    _server.scene.reset()


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """A browser for all tests that look at pages."""
    binary = find_browser()
    if binary is None:
        pytest.skip("no Chromium on this machine")
    running = Browser(binary, tmp_path_factory.mktemp("browser"))
    yield running
    running.close()
