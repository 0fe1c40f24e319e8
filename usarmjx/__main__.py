"""`python -m usarmjx`."""

from usarmjx.cli.entry import main

main()
