"""Wander through an arena by sonar, without touching a wall.

    python -m usarmjx serve --arena yellow &
    python examples/wander.py --port 3000 --seconds 20 --json log.json

The controller itself is usarmjx/client/wander.py, by which `usarmjx demo` drives too.
"""

import importlib
import importlib.util
import sys

if importlib.util.find_spec("usarmjx") is None:
    importlib.import_module("usarsim_client")  # which finds usarmjx in this clone

if __name__ == "__main__":
    sys.exit(importlib.import_module("usarmjx.client.wander").main())
