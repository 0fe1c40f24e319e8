"""A mission that several tests look at."""

import pytest

from tests.recording.missions import drive_mission


@pytest.fixture(scope="session")
def mission(tmp_path_factory):
    """A recording, and where robots were after each of its steps, by name."""
    path = tmp_path_factory.mktemp("mission") / "mission.mcap"
    return path, drive_mission(path)
