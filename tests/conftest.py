"""What all tests share: how jax compiles, which examples hypothesis tries, and why a test is skipped."""

import gc
import importlib.util
import logging
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Generator, Iterator
from importlib import import_module
from pathlib import Path

import hypothesis
import jax
import pytest
from jax._src import compilation_cache
from jax._src.interpreters import mlir

from tests.offline import cut_network
from tests.program_cache import folder_of_programs, limit_kept
from usarmjx.base.compilation import fast_compilation_flags
from usarmjx.base.process import return_freed_memory

MUCH, MORE = 2.5e9, 0.8e9
"""Memory at which a process of tests forgets programs, and growth after which it does so again [bytes]."""
SHARE = 1 / 6
"""Share of the machine's memory that may be more than `MUCH`: a run has four such processes."""

ASKED = pytest.StashKey[Path]()
"""File of what was asked of other machines."""

MODULES_OF_A_CONTEXT = 200
"""Programs that are lowered in one MLIR context: it keeps all types and constants that it has met."""

IN_ONE_PIECE = "--xla_cpu_parallel_codegen_split_count=1"
"""XLA flag of the tests, in addition to `fast_compilation_flags`."""

# A run is the same on every machine and tries few examples; `dev.py fuzz` looks for what no run has met.
# No deadlines: a loaded machine is no failure.
hypothesis.settings.register_profile("same", derandomize=True, database=None, deadline=None, max_examples=25)
hypothesis.settings.register_profile(
    "fuzz", derandomize=False, max_examples=2000, print_blob=True, deadline=None
)
hypothesis.settings.load_profile("same")


def write_whole_entries(folder: str) -> None:
    """Let JAX keep programs there so that another process reads all of one or nothing."""
    usual = compilation_cache.LRUCache.put

    def put(cache: compilation_cache.LRUCache, key: str, value: bytes) -> None:
        if str(cache.path) != folder:
            usual(cache, key, value)
            return
        entry = Path(folder, f"{key}-cache")
        if not entry.exists():
            part = Path(folder, f"{key}.{os.getpid()}")
            part.write_bytes(value)
            part.replace(entry)

    compilation_cache.LRUCache.put = put


def share_contexts() -> None:
    """Let the programs that a thread lowers share an MLIR context: a new one for each takes 4 ms of the CPU.

    The tests compile ten programs in a second, most of them one operation.
    """
    usual, own = mlir.make_ir_context, threading.local()

    def make_ir_context() -> mlir.ir.Context:
        own.lowered = getattr(own, "lowered", 0) + 1
        if own.lowered % MODULES_OF_A_CONTEXT == 1:
            own.context = usual()
        return own.context

    mlir.make_ir_context = make_ir_context


def compile_kernels_fast(folder: Path) -> None:
    """Let Warp compile for the processor without optimisation: its kernels took twice as long.

    Its keys of kept kernels contain the level.

    Args:
        folder: Folder for its precompiled header, which each thread of XLA made for itself, in 2 s.
    """
    # A GPU's compiler has faults at this level, and its tests need the speed.
    if shutil.which("nvidia-smi") is not None or importlib.util.find_spec("warp") is None:
        return
    import_module("warp").config.optimization_level = 0
    folder.mkdir()
    import_module("warp._src.context").Runtime.get_clang_pch_dir = lambda _: str(folder)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the runs that compile as users do, and with JAX in double precision."""
    parser.addoption("--optimised", action="store_true", help="compile with XLA's default optimisation")
    parser.addoption("--double", action="store_true", help="as beside a library that sets jax_enable_x64")


def pytest_configure(config: pytest.Config) -> None:
    """Set what jax reads when it starts its backend."""
    # On two cores two batched factorisations deadlock in its pool of two threads.
    os.environ.setdefault("NPROC", "8")
    # Most of the time of the tests goes into compiling, which so takes less than half as long.
    if not config.getoption("optimised"):
        os.environ.setdefault("XLA_FLAGS", " ".join([*fast_compilation_flags(), IN_ONE_PIECE]))
    if config.getoption("double"):
        os.environ["JAX_ENABLE_X64"] = "1"  # for programs that tests start
        jax.config.update("jax_enable_x64", True)
    # Tests read programs that other tests have compiled from a folder: this saves a fifth of the time of
    # training's tests. The processes of a run share the folder. It starts empty, unless a variable names one.
    own = tempfile.TemporaryDirectory(prefix="usarmjx-tests-")
    config.add_cleanup(own.cleanup)
    if not config.getoption("optimised"):
        compile_kernels_fast(Path(own.name) / "header")
    limit_kept(os.environ)
    folder = str(folder_of_programs(os.environ, Path(own.name)))
    write_whole_entries(folder)
    share_contexts()
    # Nothing is downloaded at run time, so no test may reach another machine.
    config.stash[ASKED] = Path(own.name) / "asked-of-others"
    config.stash[ASKED].touch()
    cut_network(config.stash[ASKED])
    os.environ["USARMJX_CACHE"] = "off"
    os.environ["USARMJX_QUIET"] = "1"
    os.environ["JAX_COMPILATION_CACHE_DIR"] = folder  # for programs that tests start
    # To read a small program takes a quarter of the time of compiling it, and most are small.
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    # Else each program that tests start, and each run, would parse all sources and rewrite asserts again.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem(name: str) -> Generator[None, object, object]:
    """Mark the cases that `every_run` does not name as thorough.

    Raises:
        ValueError: It names a case that the test does not have.
    """
    made = yield
    cases = [item for item in made if item.get_closest_marker("every_run")] if isinstance(made, list) else []
    if not cases:
        return made
    named = cases[0].get_closest_marker("every_run").args
    by_id = {item.callspec.id: item for item in cases}
    if unknown := set(named) - set(by_id):
        raise ValueError(f"{name} has no case {', '.join(sorted(unknown))}")
    for case in by_id.keys() - set(named):
        by_id[case].add_marker(pytest.mark.thorough)
    return made


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip slow tests unless `-m` names them, and GPU tests where there is no GPU."""
    expression = config.getoption("markexpr")
    slow_wanted = "slow" in expression
    gpu_here = shutil.which("nvidia-smi") is not None
    for item in items:
        if item.get_closest_marker("slow") and not slow_wanted:
            item.add_marker(pytest.mark.skip(reason="slow; run with -m slow"))
        if item.get_closest_marker("gpu") and not gpu_here:
            item.add_marker(pytest.mark.skip(reason="no NVIDIA GPU on this machine"))


def pytest_collection_finish() -> None:
    """Spare the garbage collector what stays until the end: tracing took a sixth less with fewer rounds."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


def resident() -> float:
    """Return the memory that this process holds [bytes]; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm") as file:
            return float(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0.0


@pytest.fixture(scope="session")
def memory_limit() -> list[float]:
    """Memory of this process at which it forgets programs next [bytes]."""
    try:
        whole = float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError):  # no POSIX system
        whole = 0.0
    return [max(MUCH, SHARE * whole)]


@pytest.fixture(autouse=True, scope="module")
def forget_what_is_compiled(memory_limit: list[float]) -> Iterator[None]:
    """Drop what JAX has compiled when a process has grown large: all of it together takes 5 GB.

    Live arrays may keep memory above the limit: the next limit is higher, or every module would compile anew.
    """
    yield
    if resident() > memory_limit[0]:
        jax.clear_caches()
        gc.collect()
        return_freed_memory()
        memory_limit[0] = max(memory_limit[0], resident() + MORE)


@pytest.fixture(autouse=True)
def asked_of_others(request: pytest.FixtureRequest) -> Iterator[Path]:
    """File of what a test asks of other machines, which must be empty in the end."""
    file = request.config.stash[ASKED]
    yield file
    if file.stat().st_size:
        found = file.read_text()
        file.write_text("")
        pytest.fail(f"reached for another machine:\n{found}")


@pytest.fixture(autouse=True)
def own_log() -> Iterator[None]:
    """Let no test change what the next ones log: a server that is started in this process does."""
    package = logging.getLogger("usarmjx")
    level, handlers = package.level, list(package.handlers)
    yield
    package.setLevel(level)
    package.handlers[:] = handlers


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an uninterrupted training run, which tests of several packages look at."""
    from tests.train.runs import run

    folder = tmp_path_factory.mktemp("reference") / "run"
    run(folder)
    return folder
