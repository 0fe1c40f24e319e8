import pytest
import viser


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
