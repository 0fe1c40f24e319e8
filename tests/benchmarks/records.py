"""Records against the schema that all commands of `usarmjx bench` share."""

import json
from functools import cache

import jsonschema

import dev

SCHEMA = dev.ROOT / "benchmarks" / "record_schema.json"


@cache
def validator():
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def faults(record):
    """What is wrong with a record, a line each."""
    return [f"{error.json_path}: {error.message[:200]}" for error in validator().iter_errors(record)]
