"""Records against the schema that all commands of `usarmjx bench` share."""

import copy
import json
from functools import cache

import jsonschema

import dev
from benchmarks.cases import BaselineOptions

SCHEMA = dev.ROOT / "benchmarks" / "record_schema.json"


@cache
def validator():
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def faults(record):
    """What is wrong with a record, a line each."""
    return [f"{error.json_path}: {error.message[:200]}" for error in validator().iter_errors(record)]


def measured(module, measure, tmp_path, monkeypatch, line):
    """The record of a benchmark of served robots, of 3 robots in 2 s, twice, whose summary has a line."""
    monkeypatch.setattr(module, "measure", measure)
    file = tmp_path / "costs.jsonl"
    assert line in module.run(3, 2.0, 2, BaselineOptions(json=file, note=""))
    (text,) = file.read_text().splitlines()
    return json.loads(text)


def check_rates(record, expected):
    """Check that a record fits the schema and has these rates, of two repeats."""
    assert faults(record) == []
    rates = record["rates"] | record["baselines"]
    assert {name: one["rate"] for name, one in rates.items()} == expected
    assert {one["repeats"] for one in rates.values()} == {2}


def check_refusals(record, case):
    """Check that the schema refuses a record without a case, and one without a cost."""
    for name in ("rates", "rows"):
        lacking = copy.deepcopy(record)
        del lacking[name][case]
        assert any(f"'{case}' is a required property" in fault for fault in faults(lacking))
    del record["rows"]["off"][0]["cpu_per_simulated_s"]
    assert any("'cpu_per_simulated_s' is a required property" in fault for fault in faults(record))
