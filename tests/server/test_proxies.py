"""Encryption by real proxies, with the settings of docs/security.md, where they are installed.

The certificates are made by openssl for the name sim.example.org.
"""

import asyncio
import contextlib
import os
import re
import shutil
import socket
import ssl
import subprocess
import time

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

import dev
from tests.server.peers import PATIENCE, Peer, serving
from tests.server.still_world import StillWorld, init
from usarmjx.server.network.access import AccessRules
from usarmjx.server.rosbridge.net import RosbridgeServer, RosSettings

NAME = "sim.example.org"
STUNNEL = shutil.which("stunnel4") or shutil.which("stunnel")
CADDY = shutil.which("caddy")
TOKEN = "a-secret"


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


@contextlib.contextmanager
def running(command, port, folder):
    """A proxy that listens at a port."""
    environment = os.environ | {"HOME": str(folder), "XDG_DATA_HOME": str(folder)}
    with (folder / "proxy.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, env=environment)
    try:
        end = time.monotonic() + PATIENCE
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
                break
            assert process.poll() is None, (folder / "proxy.log").read_text()
            assert time.monotonic() < end
            time.sleep(0.05)
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """Two certificates that sign themselves, each with its key: sim.pem and me.pem."""
    folder = tmp_path_factory.mktemp("certificates")
    for name, subject in (("sim", NAME), ("me", "me")):
        words = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"]
        about = [
            "-nodes",
            "-days",
            "2",
            "-subj",
            f"/CN={subject}",
            "-addext",
            f"subjectAltName=DNS:{subject}",
        ]
        files = ["-keyout", str(folder / "key"), "-out", str(folder / "cert")]
        subprocess.run([*words, *about, *files], check=True, capture_output=True)
        (folder / f"{name}.pem").write_bytes((folder / "key").read_bytes() + (folder / "cert").read_bytes())
    return folder


def stunnel_settings(certificates, number, ports):
    """The block of the page with that number, with other ports and places; `checkHost` as it is there."""
    text = (dev.ROOT / "docs/security.md").read_text(encoding="utf-8")
    block = [one for one in re.findall(r"```text\n(.*?)```", text, re.DOTALL) if one.startswith("[robots]")][
        number
    ]
    for old, new in (
        ("/etc/stunnel/sim.pem", certificates / "sim.pem"),
        ("/etc/stunnel/clients.pem", certificates / "me.pem"),
        ("/etc/stunnel/me.pem", certificates / "me.pem"),
        ("/etc/ssl/certs/ca-certificates.crt", certificates / "sim.pem"),
        (f"{NAME}:3443", f"127.0.0.1:{ports['tls']}"),
        ("accept = 3443", f"accept = 127.0.0.1:{ports['tls']}"),
        ("connect = 127.0.0.1:3000", f"connect = 127.0.0.1:{ports['server']}"),
        ("accept = 127.0.0.1:3000", f"accept = 127.0.0.1:{ports['client']}"),
    ):
        block = block.replace(old, str(new))
    return f"foreground = yes\npid =\n{block}"


@pytest.mark.skipif(STUNNEL is None, reason="stunnel is not installed")
def test_a_robot_drives_through_stunnel_at_both_ends_and_nobody_without_a_certificate(certificates, tmp_path):
    with serving(StillWorld(), realtime_factor=1.0) as (server, _), contextlib.ExitStack() as stack:
        ports = {"server": server, "tls": free_port(), "client": free_port()}
        for number, port in ((0, "tls"), (1, "client")):
            folder = tmp_path / port
            folder.mkdir()
            (folder / "stunnel.conf").write_text(stunnel_settings(certificates, number, ports))
            stack.enter_context(running([STUNNEL, str(folder / "stunnel.conf")], ports[port], folder))
        peer = Peer(ports["client"], init("R1"))
        assert len(peer.sta_times(3)) == 3
        peer.close()
        context = ssl.create_default_context(cafile=certificates / "sim.pem")
        stranger = socket.create_connection(("127.0.0.1", ports["tls"]), PATIENCE)
        with contextlib.suppress(OSError), context.wrap_socket(stranger, server_hostname=NAME) as wrapped:
            assert wrapped.recv(1) == b"", "it has no certificate, and is not greeted"


@pytest.mark.skipif(CADDY is None, reason="caddy is not installed")
def test_a_browser_talks_through_caddy_by_tls(certificates, tmp_path):
    """As the page has it, but with a certificate of its own; a wrong name and a wrong token are refused."""
    world, tls = StillWorld(), free_port()
    settings = RosSettings(port=0, names=(NAME,), access=AccessRules(token=TOKEN))
    ros = RosbridgeServer(world, settings)
    with serving(world, [ros], realtime_factor=1.0) as (_, server):
        ros.server = server
        (tmp_path / "Caddyfile").write_text(
            f"{{\n admin off\n auto_https off\n}}\nhttps://{NAME}:{tls} {{\n"
            f" tls {certificates / 'cert.pem'} {certificates / 'key.pem'}\n"
            f" reverse_proxy 127.0.0.1:{ros.port}\n}}\n"
        )
        text = (certificates / "sim.pem").read_text()
        (certificates / "cert.pem").write_text(text[text.index("-----BEGIN CERT") :])
        (certificates / "key.pem").write_text(text[: text.index("-----BEGIN CERT")])
        with running([CADDY, "run", "--config", str(tmp_path / "Caddyfile")], tls, tmp_path):
            context = ssl.create_default_context(cafile=certificates / "sim.pem")

            # The blocking client reads and writes TLS in two threads, of which one sometimes waits for ever.
            def come(path):
                address = f"wss://{NAME}:{tls}{path}"
                return connect(address, host="127.0.0.1", port=tls, ssl=context, server_hostname=NAME)

            async def talk():
                async with come(f"/?token={TOKEN}") as browser:
                    await browser.send('{"op": "call_service", "service": "/rosapi/topics", "id": "1"}')
                    assert '"result": true' in await asyncio.wait_for(browser.recv(), PATIENCE)
                for path in ("/", "/?token=wrong"):
                    with pytest.raises(InvalidStatus, match="HTTP 403"):
                        await come(path)

            asyncio.run(talk())
