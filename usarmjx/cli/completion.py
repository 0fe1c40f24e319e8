"""Names that a shell completes. They are written down here, as registries take a second or two to import.

A test compares them with the registries.
"""

ARENA_NAMES = (
    *("arda", "factory", "field", "orange", "outdoor", "pool", "red", "soccer", "yellow"),
    *("orange_2025", "red_2025", "yellow_2025"),
    *("DM-ARDA", "DM-Factory", "DM-Field", "DM-Outdoor", "DM-Pool", "DM-Soccer"),
    *("DM-USAR_orange", "DM-USAR_red", "DM-USAR_yellow"),
    *("DM-USAR_orange_2025", "DM-USAR_red_2025", "DM-USAR_yellow_2025"),
)
ROBOT_NAMES = (
    *("AirRobot", "ATRVJr", "ComStation", "Cooper", "ERS", "Hummer", "kenaf", "Kurt2D", "Kurt3D", "Lisa"),
    *("OmniP2AT", "OmniP2DX", "P2AT", "P2DX", "Passarola", "QRIO", "Rugbot", "Sedan", "SnowStorm", "Soryu"),
    *("StereoP2AT", "Submarine", "Talon", "Tarantula", "TeleMax", "UnitLoader", "Zerg"),
)
TASK_NAMES = (
    *("convoy", "drive-to-goal", "explore", "explore-v1", "explore-v2", "hover-inspect", "relay-chain"),
    *("soccer", "stairs", "victim-search", "victim-search-v1", "victim-search-v2", "wander"),
)
POLICY_NAMES = (
    "drive-to-goal",
    "explore",
    "explore-v2",
    "hover-inspect",
    "relay-chain",
    "stairs",
    "victim-search",
    "victim-search-v2",
    "wander",
)
ENGINE_NAMES = ("auto", "c", "jax", "planar", "warp")
KIND_NAMES = ("building", "collapsed", "maze", "ramps", "rubble", "steps")
LISTING_NAMES = ("arenas", "commands", "engines", "everything", "policies", "robots", "sensors", "tasks")


def complete_listings(incomplete: str) -> list[str]:
    """Return what can be listed whose names begin so."""
    return _beginning(LISTING_NAMES, incomplete)


def complete_arenas(incomplete: str) -> list[str]:
    """Return the arenas whose names begin so."""
    return _beginning(ARENA_NAMES, incomplete)


def complete_robots(incomplete: str) -> list[str]:
    """Return the robot classes whose names begin so."""
    return _beginning(ROBOT_NAMES, incomplete)


def complete_tasks(incomplete: str) -> list[str]:
    """Return the tasks whose names begin so."""
    return _beginning(TASK_NAMES, incomplete)


def complete_policies(incomplete: str) -> list[str]:
    """Return the packaged policies whose names begin so."""
    return _beginning(POLICY_NAMES, incomplete)


def complete_engines(incomplete: str) -> list[str]:
    """Return the engines whose names begin so."""
    return _beginning(ENGINE_NAMES, incomplete)


def complete_kinds(incomplete: str) -> list[str]:
    """Return the kinds of generated arenas whose names begin so."""
    return _beginning(KIND_NAMES, incomplete)


def _beginning(names: tuple[str, ...], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
