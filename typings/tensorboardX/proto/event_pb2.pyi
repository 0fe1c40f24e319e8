# Messages, which protobuf makes when they are imported.
from typing import Any

Event: Any
SessionLog: Any
