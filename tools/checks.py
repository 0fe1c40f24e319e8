"""The steps of `dev.py test`: lint, format check, types, layers and tests, as command lines of Python."""

from pathlib import Path

from tools.environment import Beside

ROOT = Path(__file__).resolve().parents[1]
WORKERS = ("-n", "2", "--dist", "loadfile")
"""A world compiles on every core that it gets: more workers than two were not faster."""
NO_HANGING = (
    *("-o", "faulthandler_timeout=600", "-o", "faulthandler_exit_on_timeout=true"),
    "--max-worker-restart=0",
)
"""A test that hangs, or ends its process, ends the run; xdist with a new worker may wait for ever."""
SLOWEST = ("--durations=20", "--durations-min=5")
"""The report of a full run ends with the tests to look at first when it takes too long."""
QUICK = (
    "tests/base/test_registry.py",
    "tests/base/test_transforms.py",
    "tests/cli/test_sensor_tables.py",
    "tests/models/arenas/test_elements.py",
    "tests/models/generate",
    "tests/models/ini",
    "tests/models/roads",
    "tests/models/robots/test_ackermann.py",
    "tests/models/robots/test_manual_figures.py",
    "tests/models/robots/test_pioneer.py",
    "tests/sensors/test_limits.py",
    "tests/sensors/test_settings.py",
    "tests/server/protocol",
    "tests/server/messages/test_victims.py",
    "tests/server/wireless/test_dialect_a.py",
    "tests/server/wireless/test_dialect_b.py",
    "tests/test_conformance.py",
    "tests/test_dev.py",
    "tests/test_docs.py::test_commands_exist",
    "tests/test_docs.py::test_links_lead_to_files",
    "tests/test_names.py",
)
"""Tests of `test --quick`, which compile next to nothing."""
OPTIMISED = (
    "tests/sensors/cameras/test_every_camera.py",
    "tests/comms/test_attenuation.py",
    "tests/comms/test_mail.py",
    "tests/engines/test_engines.py::test_jax_drives_as_c_mujoco_does",
    "tests/models/compile/test_kinematic_tree.py",
    "tests/sensors/rays/test_raycast.py",
    "tests/sensors/test_nearest_warp.py",
    "tests/server/test_joints_wire.py",
    "tests/sim/test_control.py",
    "tests/train/envs/test_env.py::test_a_world_is_the_same_alone_as_in_a_batch[c]",
    "tests/train/learning/test_ppo.py",
)
"""A cross-section of the packages, run once more with the compiler's optimisation that users have."""
DOUBLE = (
    "tests/comms/test_mail.py",
    "tests/engines/test_planar_motion.py::test_where_a_robot_gets_to_has_the_slope_that_small_changes_show",
    "tests/sensors/test_scanners.py",
    "tests/sim/test_ages.py::test_batched_sensors_read_the_same_bits_at_any_age[c]",
    "tests/train/adapters/test_adapters.py",
    "tests/train/envs/test_env.py::test_a_world_is_the_same_alone_as_in_a_batch[c]",
    "tests/train/tasks/test_first_tasks.py",
)
"""Another one, run once more as beside a library that sets `jax_enable_x64`."""


def pytest(*args: str) -> list[str]:
    """Command line of the tests."""
    return ["-m", "pytest", *args]


def lint(*args: str) -> list[str]:
    """Command line of the style rules."""
    return ["-m", "ruff", "check", *args]


def formatter(*args: str) -> list[str]:
    """Command line of the code formatter."""
    return ["-m", "ruff", "format", *args]


def types(*args: str) -> list[str]:
    """Command line of the type checker."""
    return ["-m", "pyright", *args]


def layers(*args: str) -> list[str]:
    """Command line of the import rules; import-linter has no `-m` form."""
    run = "import sys; from importlinter.cli import lint_imports_command as main; sys.exit(main())"
    return ["-c", run, *args]


def files_with_mark(name: str) -> list[str]:
    """Return the test files that use a mark: collecting all files takes longer than these tests."""
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    found = [file for file in files if f"pytest.mark.{name}\n" in file.read_text(encoding="utf-8")]
    return [file.relative_to(ROOT).as_posix() for file in found]


def quick(*args: str) -> list[list[str]]:
    """Lint, format check, layers and the quick tests; the arguments go to pytest."""
    return [lint(), formatter("--check"), layers(), pytest(*WORKERS, *QUICK, *args)]


def everything(*args: str) -> list[list[str]]:
    """All checks of a change; `--all`: wheel, site, Ray, thorough tests; else pytest with the arguments."""
    if "--quick" in args:
        return quick(*(arg for arg in args if arg != "--quick"))
    if args and args != ("--all",):
        return [pytest(*args)]
    chosen = "" if args else " and not tools and not thorough"
    kept = ("-m", chosen.removeprefix(" and ")) if chosen else ()
    # In one process each: a worker would import and collect again, and the tests beside them use the cores.
    beside = [
        types(),
        pytest("--optimised", *NO_HANGING, *OPTIMISED),
        pytest("--double", *NO_HANGING, *kept, *DOUBLE),
    ]
    tests = [
        pytest(*WORKERS, *NO_HANGING, *SLOWEST, "-m", f"not alone{chosen}"),
        pytest(*NO_HANGING, "-m", f"alone{chosen}", *files_with_mark("alone")),
    ]
    return [lint(), formatter("--check"), layers(), *map(Beside, beside), *tests]
