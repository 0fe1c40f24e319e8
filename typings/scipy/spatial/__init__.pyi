# Everything of scipy.spatial but `transform` is read from where it is installed.
from typing import Any

def __getattr__(name: str) -> Any: ...
