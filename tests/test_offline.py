"""Nothing is downloaded at run time: commands work where nobody else can be reached, and ask for nobody.

What asks is written down, also where the library that asked gets over the answer.
"""

import ast
import os
import re
import signal
import socket
import subprocess
import sys

import pytest

import dev

GUARD = """
import os, socket, sys

HERE = ("127.", "::1", "localhost", "0.0.0.0")
LOADERS = {"curl", "wget", "git", "pip", "pip3", "ssh", "scp", "rsync", "aria2c"}

def is_here(host):
    host = host.decode() if isinstance(host, bytes) else host
    return host is None or host in ("", "::") or host == socket.gethostname() or host.startswith(HERE)

def refuse(what):
    with open(os.environ["ASKED"], "a") as file:
        file.write(what + "\\n")
    raise OSError(101, "Network is unreachable")

def guard(event, args):
    if event in ("socket.connect", "socket.sendto", "socket.sendmsg"):
        address = args[1]
        if isinstance(address, tuple) and not is_here(address[0]):
            refuse(f"{event} {address}")
    elif event in ("socket.getaddrinfo", "socket.gethostbyname") and not is_here(args[0]):
        refuse(f"{event} {args[0]}")
    elif event == "subprocess.Popen":
        words = [os.path.basename(str(word)) for word in (args[0], *args[1])]
        if LOADERS & set(words):
            refuse(f"{event} {words}")

sys.addaudithook(guard)
"""
"""`sitecustomize`, which Python imports before anything else, also in processes that a process starts."""

USE = """
import sys
from pathlib import Path
from typer.testing import CliRunner
from usarmjx.cli.app import app

folder = Path(sys.argv[1])
small = "--task drive-to-goal --engine c --worlds 2 --steps 4 --quiet --set rollout=2 --set minibatches=1"
small += " --set epochs=1 --set layers=4 --set critic_layers=4"
for words in (
    ["list"],
    ["train", *small.split(), "--out", str(folder / "run")],
    ["export", str(folder / "run"), str(folder / "policy.npz")],
    ["curves", str(folder / "run"), "--out", str(folder / "curves.png")],
    ["arena", "draw", "yellow", "--png", str(folder / "plan.png")],
    ["radio-map", "yellow", str(folder / "radio.png"), "--from", "3,3,0.5"],
):
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, (words, result.output, result.exception)
print("done")
"""
REMOTE = ("urllib.request", "http.client", "ftplib", "requests", "httpx", "aiohttp", "urllib3", "boto3")
REMOTE += ("huggingface_hub", "pooch", "gdown", "pip", "websockets.client", "websockets.asyncio.client")
SUSPECT = re.compile(rf"^\s*(from|import) +({'|'.join({name.partition('.')[0] for name in REMOTE})})", re.M)
MAY_ASK = {"usarmjx/bench/chaos/soak.py": {"urllib.request"}}
"""It reads the figures of a server that it has started on this machine."""


@pytest.fixture
def cut(tmp_path):
    """Settings of a process without network, and the file of what it asked for."""
    (tmp_path / "guard").mkdir()
    (tmp_path / "guard" / "sitecustomize.py").write_text(GUARD)
    asked = tmp_path / "asked"
    asked.touch()
    path = os.pathsep.join((str(tmp_path / "guard"), str(dev.ROOT)))
    return {**os.environ, "PYTHONPATH": path, "ASKED": str(asked), "JAX_PLATFORMS": "cpu"}, asked


def run(code, settings, *words):
    command = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(command, env=settings, capture_output=True, text=True, timeout=600)


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
    """Which sees also what the commands below do not come to."""
    files = [*(dev.ROOT / "usarmjx").rglob("*.py"), *(dev.ROOT / "examples").rglob("*.py")]
    found = {
        file.relative_to(dev.ROOT).as_posix(): loaders(file.read_text(encoding="utf-8")) for file in files
    }
    assert {name: names for name, names in found.items() if names} == MAY_ASK
    for text in ("import urllib.request", "from urllib import request", "def f():\n    import requests as r"):
        assert loaders(text), text
    assert not loaders("import urllib.parse\nfrom websockets.asyncio.server import serve")


def test_the_guard_sees_downloads_of_all_kinds_and_nothing_else(cut, tmp_path):
    """Also those whose failure is swallowed, and those of another program."""
    settings, asked = cut
    code = """
import contextlib, socket, subprocess, sys, urllib.request
for attempt in (
    lambda: urllib.request.urlopen("http://files.example/model.npz", timeout=5),
    lambda: socket.create_connection(("192.0.2.1", 80), timeout=5),
    lambda: subprocess.run(["curl", "files.example"]),
    lambda: subprocess.run([sys.executable, "-m", "pip", "install", "x"]),
):
    with contextlib.suppress(OSError):
        attempt()
with socket.create_server(("localhost", 0)) as server:
    socket.create_connection(server.getsockname()).close()
child = "import contextlib, socket\\n"
child += "with contextlib.suppress(OSError): socket.create_connection(('192.0.2.2', 80))"
subprocess.run([sys.executable, "-c", child])
"""
    done = run(code, settings)
    assert done.returncode == 0, done.stderr
    lines = asked.read_text().splitlines()
    assert len(lines) == 5
    for part, line in zip(("files.example", "192.0.2.1", "curl", "pip", "192.0.2.2"), lines, strict=True):
        assert part in line


def test_commands_work_without_network_and_ask_for_none(cut, tmp_path):
    """Lists, a batch of C MuJoCo that trains, a policy's file, drawings."""
    settings, asked = cut
    done = run(USE, settings, tmp_path)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr
    assert {"plan.png", "radio.png", "curves.png", "policy.npz"} <= {path.name for path in tmp_path.iterdir()}
    assert asked.read_text() == ""


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
