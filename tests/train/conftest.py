"""What the tests of training share."""

import pytest


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """Folder of what programs compile that tests start."""
    return tmp_path_factory.mktemp("compiled")
