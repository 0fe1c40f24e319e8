from typing import Any

Summary: Any
