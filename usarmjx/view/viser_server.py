"""Viser's server as we want it: silent, and on this machine only."""

import threading

import rich
import viser

_start_lock = threading.Lock()


class LocalViserServer(viser.ViserServer):
    """A server that hands its page to nobody else: viser would send it through a public server on request."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Do nothing, whoever asks."""
        del verbose
        return None


def make_viser_server(host: str, port: int) -> viser.ViserServer:
    """Return a server that listens.

    Args:
        host: Address to listen on.
        port: Port to listen on; 0: a free one.
    """
    with _start_lock:
        rich.get_console().quiet = True  # viser tells the terminal where it listens, in a frame
        return LocalViserServer(host, port, verbose=False)
