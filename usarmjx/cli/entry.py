"""Entry point of `usarmjx`."""

from usarmjx.base.early_signals import catch_signals, restore_signals


def main() -> None:
    """Import the command line and run it."""
    # First of all: importing the command line takes long enough for an impatient Ctrl-C.
    catch_signals()
    try:
        from usarmjx.cli.app import app

        app()
    finally:
        restore_signals()
