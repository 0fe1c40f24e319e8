"""Ports of served policies open before JAX is imported and anything is compiled: clients connect and wait."""

import json
import os
import subprocess
import sys

import pytest

import dev
from tests.scripts import python_path
from tests.server.peers import PATIENCE

AT_JAX = """
import json, socket, sys, threading, time
from importlib.abc import MetaPathFinder

words, port, patience = json.loads(sys.argv[1])

class Met(BaseException):
    pass

class Gate(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name != "jax" or threading.current_thread() is not threading.main_thread():
            return
        until = time.monotonic() + patience
        while time.monotonic() < until:
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
            except OSError:
                time.sleep(0.05)
            else:
                print("a client connects")
                raise Met
        print("nobody listens")
        raise Met

sys.meta_path.insert(0, Gate())
from usarmjx.cli.app import app
try:
    app(words, standalone_mode=False)
except Met:
    pass
"""


@pytest.mark.parametrize(
    "words",
    [
        ("play", "drive-to-goal", "--serve"),
        pytest.param(
            ("train", "drive-to-goal", "--out", "run", "--serve"),
            marks=pytest.mark.skipif(os.name == "nt", reason="train --serve needs POSIX"),
        ),
    ],
    ids=lambda words: words[0],
)
def test_a_client_connects_before_jax_is_imported(tmp_path, words):
    """For `train` it is the process of `play` that listens; the offset moves its other ports, too."""
    offset = 2000 + os.getpid() % 10000  # the highest port is one of the radio's, above 50000
    port = 3000 + offset
    words = [*words, "--port", "3000", "--port-offset", str(offset)]
    done = subprocess.run(
        [sys.executable, "-c", AT_JAX, json.dumps([words, port, PATIENCE])],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": python_path(dev.ROOT)},
        timeout=3 * PATIENCE,
    )
    assert done.stdout.splitlines()[-1:] == ["a client connects"], done.stderr
