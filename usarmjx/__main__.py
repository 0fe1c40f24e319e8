"""`python -m usarmjx`."""

from usarmjx.cli import app

app()
