"""The log for machines: one JSON object per line."""

import json
import logging
import re
from datetime import UTC, datetime

PEER = re.compile(r"(?:world (?P<world>\d+), )?(?P<peer>[\d.]+:\d+|[0-9a-f:]*:[0-9a-f:]*:\d+): ")
"""How a line about a client begins: the world, if there are several, and the client's address."""


class JsonFormatter(logging.Formatter):
    """Formats a record as a JSON object.

    It has `time` (ISO 8601, UTC), `level`, `logger` and `message`; `world` and `peer` where the message is
    about a client; `exception` where there was one.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; it has no line end inside, whatever the message holds."""
        message = record.getMessage()
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
        }
        if about := PEER.match(message):
            message = message[about.end() :]
            if about["world"] is not None:
                line["world"] = int(about["world"])
            line["peer"] = about["peer"]
        line["message"] = message
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line)


def configure_log(*, verbose: bool = False, as_json: bool = False) -> None:
    """Log to the standard error stream: warnings, and of this package what happens if it is to be verbose."""
    logging.basicConfig(format="%(levelname)s %(name)s: %(message)s", level=logging.WARNING)
    logging.getLogger("usarmjx").setLevel(logging.INFO if verbose else logging.WARNING)
    if as_json:
        logging.captureWarnings(True)
        for handler in logging.getLogger().handlers:
            handler.setFormatter(JsonFormatter())
