"""`python -m usarmjx`."""

from usarmjx.cli.app import app

app()
