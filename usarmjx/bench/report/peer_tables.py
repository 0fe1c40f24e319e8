"""Ours and other simulators of one run: rates, and what is in whose step."""

from collections.abc import Sequence

from usarmjx.bench.peering.results import device_of, devices_differ
from usarmjx.bench.report.records import BenchRecord
from usarmjx.bench.report.tables import NOTHING, number, of, table


def peers_text(records: Sequence[BenchRecord]) -> str:
    """Return a table of rates and one of what they are rates of, for each run, newest first."""
    runs = of(records, "peers")[::-1]
    return "\n".join(_run_text(record) for record in runs) if runs else NOTHING


def _run_text(record: BenchRecord) -> str:
    load = record.data["hardware"]["load_average"]
    begin, end = (number(load[when]) for when in ("begin", "end"))
    note = f" {record.data['note']}." if record.data["note"] else ""
    differ = devices_differ(record.data["rows"])
    rates = table(
        (
            "simulator", "variant", "worlds x robots", "robot-steps/s", "a step is [s]",
            "simulated robot-s per s", "least to most", "load", *(["on"] if differ else []),
        ),
        (
            [
                row["who"],
                row["variant"],
                f"{row['worlds']} x {row['robots']}",
                *(
                    [
                        number(row["robot_steps_per_s"]),
                        number(row["period_s"]),
                        number(row["robot_seconds_per_s"]),
                        " to ".join(
                            number(row["speed"][end] * row["period_s"]) for end in ("least", "most")
                        ),
                        number(row["load_average"]),
                    ]
                    if "speed" in row
                    else [f"not measured: {row['missing']}", "-", "-", "-", "-"]
                ),
                *([device_of(row)] if differ else []),
            ]
            for row in record.data["rows"]
        ),
    )  # fmt: skip
    told = {(row["who"], row["variant"]): row for row in record.data["rows"]}
    steps = table(
        (
            "simulator",
            "a robot is",
            "in its step",
            "beams of a robot",
            "not in it",
            "run with",
            "its authors say",
        ),
        (
            [
                f"{who}, {variant}",
                row["robot"],
                row["has"],
                str(row["beams"] or "-"),
                row["lacks"],
                row["settings"],
                f"{row['authors']} ({row['citation']})" if row["authors"] else "-",
            ]
            for (who, variant), row in told.items()
        ),
    )
    run = f"{record.when}, commit {record.data['commit']}, {record.where}"
    head = f"{run}, load average {begin} to {end}.{note}\n"
    return "\n".join([head, rates, steps])
