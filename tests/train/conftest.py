"""One run that several tests look at."""

import pytest


@pytest.fixture(scope="session")
def reference(tmp_path_factory):
    """Folder of an uninterrupted run in this process."""
    from tests.train.runs import run

    folder = tmp_path_factory.mktemp("reference") / "run"
    run(folder)
    return folder


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """Folder of what programs compile that tests start."""
    return tmp_path_factory.mktemp("compiled")
