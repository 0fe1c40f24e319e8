"""Pictures that are maps of walls, which nobody shall take for terrain."""

from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError, UsageError
from usarmjx.base.settings.yaml_file import read_yaml
from usarmjx.models.files.images import read_grey
from usarmjx.models.files.maps import is_map

MAP_VALUES = (0, 205, 254, 255)
"""Grey values that map_server's saver writes: occupied, unknown, free, and white."""
ADVICE = (
    "for walls, load a YAML file with `image: {name}`, `resolution: 0.05` (metres a pixel) and "
    "`origin: [0, 0]`; for hills, one with `heightfield: {{file: {name}, size: [10, 10], height: 1}}`"
)
"""Lines to write in place of such a picture."""


def check_picture(path: Path) -> None:
    """Refuse a picture that is a map of walls: it has two values only, map_server's, or a map's YAML file.

    Raises:
        ArenaFileError: It is one; says what to write.
    """
    for suffix in (".yaml", ".yml"):
        beside = path.with_suffix(suffix)
        if beside.is_file() and _names(beside, path):
            raise ArenaFileError(f"{path}: is the picture of the map {beside.name}: load that file")
    grey, _ = read_grey(path)
    values = np.unique(np.rint(grey))
    if len(values) <= 2 or np.isin(values, MAP_VALUES).all():
        shown = ", ".join(f"{value:g}" for value in values.tolist())
        advice = ADVICE.format(name=path.name)
        raise ArenaFileError(f"{path}: has the grey values {shown} only, as a map of walls: {advice}")


def _names(file: Path, picture: Path) -> bool:
    """Return whether a YAML file is a map with that picture."""
    try:
        value = read_yaml(file, ArenaFileError)
    except UsageError:
        return False
    if not is_map(value):
        return False
    name = value.mapping()["image"].data
    return isinstance(name, str) and Path(name).name == picture.name
