"""Nothing is downloaded at run time. All tests run without network (`conftest.py`); some more is here."""

import ast
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest

import dev
from tests.offline import SITE
from tests.scripts import python_path

REMOTE = ("urllib.request", "http.client", "ftplib", "requests", "httpx", "aiohttp", "urllib3", "boto3")
REMOTE += ("huggingface_hub", "pooch", "gdown", "pip", "websockets.client", "websockets.asyncio.client")
SUSPECT = re.compile(rf"^\s*(from|import) +({'|'.join({name.partition('.')[0] for name in REMOTE})})", re.M)
FOLDERS = "usarmjx", "benchmarks", "tools", "examples"
MAY_ASK = {
    "benchmarks/chaos/onlookers.py": {"websockets.asyncio.client"},
    "benchmarks/chaos/soak.py": {"urllib.request"},
    "benchmarks/rosbridge.py": {"websockets.asyncio.client"},
}
"""They look at a server that the benchmark has started on this machine."""


def imported(tree):
    """The modules that a file imports, wherever in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def loaders(text):
    """What a program imports that is there to fetch something."""
    if not SUSPECT.search(text):
        return set()
    names = set(imported(ast.parse(text)))
    return {remote for remote in REMOTE for name in names if name == remote or name.startswith(remote + ".")}


def test_no_module_imports_what_fetches_something():
    """Which sees also what no test comes to."""
    files = [file for folder in FOLDERS for file in (dev.ROOT / folder).rglob("*.py")]
    found = {
        file.relative_to(dev.ROOT).as_posix(): loaders(file.read_text(encoding="utf-8")) for file in files
    }
    assert {name: names for name, names in found.items() if names} == MAY_ASK
    for text in ("import urllib.request", "from urllib import request", "def f():\n    import requests as r"):
        assert loaders(text), text
    assert not loaders("import urllib.parse\nfrom websockets.asyncio.server import serve")


@pytest.mark.parametrize(
    ("reach", "told"),
    [
        (
            lambda: urllib.request.urlopen("http://files.example/x.npz", timeout=5),
            "getaddrinfo files.example",
        ),
        (lambda: socket.create_connection(("192.0.2.1", 80), timeout=5), "192.0.2.1"),
        (lambda: socket.socket(type=socket.SOCK_DGRAM).sendto(b"x", ("192.0.2.3", 9)), "192.0.2.3"),
        (lambda: subprocess.run(["curl", "files.example"]), "curl files.example"),
        (lambda: subprocess.run([sys.executable, "-m", "pip", "install", "x"]), "pip install x"),
    ],
)
def test_a_test_that_reaches_for_another_machine_fails(reach, told, asked_of_others):
    """Here, where it is meant to, what it asked for is struck out again."""
    with pytest.raises(OSError, match=r"unreachable|urlopen"):
        reach()
    assert told in asked_of_others.read_text()
    asked_of_others.write_text("")


def test_this_machine_is_reached():
    with socket.create_server(("localhost", 0)) as server:
        socket.create_connection(server.getsockname()).close()
    assert subprocess.run([sys.executable, "-c", "pass"]).returncode == 0


@pytest.fixture
def cut(tmp_path):
    """Settings of a process without network, and the file of what it, or what it starts, asked for."""
    (tmp_path / "sitecustomize.py").write_text(SITE)
    asked = tmp_path / "asked_there"
    asked.touch()
    path = python_path(tmp_path, dev.ROOT)
    return {**os.environ, "PYTHONPATH": path, "ASKED": str(asked), "JAX_PLATFORMS": "cpu"}, asked


def test_a_world_is_served_without_network_and_asks_for_none(cut):
    settings, asked = cut
    ports = [word for name in ("", "image-", "wss-", "wss2-", "position-") for word in (f"--{name}port", "0")]
    command = [sys.executable, "-m", "usarmjx", "serve", *ports]
    with subprocess.Popen(command, env=settings, stdout=subprocess.PIPE, text=True) as server:
        port = int(re.search(r"127\.0\.0\.1:(\d+)", server.stdout.readline())[1])
        with socket.create_connection(("127.0.0.1", port), timeout=300) as client:
            client.sendall(b"INIT {ClassName USARBot.P2AT} {Name R}\r\n")
            lines = client.makefile("r", encoding="latin-1")
            assert any(line.startswith("SEN ") for line in lines)
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=300)
    assert asked.read_text() == ""


def test_the_network_of_a_process_is_cut_with_that_of_its_children(cut):
    settings, asked = cut
    reach = "import contextlib, socket\n"
    reach += "with contextlib.suppress(OSError): socket.create_connection(('192.0.2.2', 80))"
    code = f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', {reach!r}])"
    subprocess.run([sys.executable, "-c", code], env=settings, check=True)
    assert asked.read_text() == "socket.connect ('192.0.2.2', 80)\n"
