"""When this process began to read the package: `usarmjx` imports this first."""

import time

STARTED = time.time()
"""[s since the epoch]"""
