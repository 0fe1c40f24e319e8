"""What the tests of training share."""

import pytest
from jax._src import compiler

OPTIMISED = 1
"""XLA's level of optimisation of `optimised_programs`: more does not pay in runs of seconds."""


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """Folder of what programs compile that tests start."""
    return tmp_path_factory.mktemp("compiled")


@pytest.fixture
def optimised_programs(monkeypatch):
    """Compile with optimisation: a test that learns for seconds gains more by it than compiling takes."""
    usual = compiler.get_compile_options

    def compile_options(*args, **settings):
        options = usual(*args, **settings)
        flags = options.executable_build_options.debug_options
        flags.xla_backend_optimization_level = max(flags.xla_backend_optimization_level, OPTIMISED)
        return options

    monkeypatch.setattr(compiler, "get_compile_options", compile_options)
