"""The client library, for the examples of a clone that is not installed: `usarmjx/client` of this clone.

Elsewhere, copy usarmjx/client/usarsim_client.py itself beside your program, or install usarmjx.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))

from usarmjx.client import *  # noqa: F403
