"""Tables of records, as Markdown."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from statistics import median
from typing import Any

from benchmarks.report.records import BenchRecord
from benchmarks.serving.clients import rows as figure_rows
from usarmjx.base.tables import markdown_table
from usarmjx.plots.training_plots import fields_of_record
from usarmjx.train.task_names import recorded_name

NOTHING = "No record yet.\n"
MILLION, BILLION = 1e6, 1e9
MarkdownRow = Sequence[str]


def table(head: MarkdownRow, rows: Iterable[MarkdownRow]) -> str:
    """Return a Markdown table; a sentence where there are no rows."""
    known = list(rows)
    return markdown_table(head, known) + "\n" if known else NOTHING


def of(records: Iterable[BenchRecord], benchmark: str) -> list[BenchRecord]:
    """Return the records of a benchmark."""
    return [record for record in records if record.benchmark == benchmark]


def number(value: float | None, unit: float = 1.0) -> str:
    """Return a number with three digits that count; a dash where there is none."""
    if value is None:
        return "-"
    value /= unit
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def records_table(
    records: Iterable[BenchRecord],
    benchmark: str,
    head: MarkdownRow,
    rows_of: Callable[[BenchRecord], Iterable[MarkdownRow]],
) -> str:
    """Return a Markdown table of a benchmark's records.

    Args:
        records: Of all benchmarks.
        benchmark: Which of them.
        head: Titles of the columns behind when, commit and machine.
        rows_of: Makes the cells below `head`: a record's rows.
    """
    rows = (
        [record.when, record.data["commit"], record.where, *cells]
        for record in of(records, benchmark)
        for cells in rows_of(record)
    )
    return table(("when", "commit", "on", *head), rows)


def baseline(record: BenchRecord, name: str) -> float | None:
    """Return the rate of a record's baseline; None where it has none."""
    return record.data.get("baselines", {}).get(name, {}).get("rate")


def physics_words(case: Mapping[str, Any]) -> list[str]:
    """Return the settings of a case's physics: their name, and what replaces theirs."""
    solver = [f"solver {case['solver']}"] if case.get("solver") else []
    step = [f"steps of {1e3 * case['timestep']:g} ms"] if case.get("timestep") else []
    return [case.get("physics", "reference"), *solver, *step]


def _scene_words(record: BenchRecord) -> str:
    case = record.case
    arena = f"{case['generated']} x {case['arena']}" if case.get("generated") else case.get("arena", "-")
    extra = [word for word in ("radio",) if case.get(word)]
    extra += [word for word in physics_words(case) if word != "reference"]
    extra += [f"graphs {case['graph']}"] if case.get("graph", "step") != "step" else []
    extra += [record.data["variant"]] if "variant" in record.data else []
    return ", ".join([arena, *extra])


def step_table(records: Sequence[BenchRecord]) -> str:
    """The whole step and bare physics."""
    head = (
        "engine", "worlds x robots", "arena", "robots in real time", "whole, M/s", "bare, M/s",
        "`mujoco.rollout`, M/s", "bare MJX, M/s", "contacts, rows, iterations of a world",
    )  # fmt: skip
    return records_table(records, "step", head, _step_rows)


def _step_rows(record: BenchRecord) -> Iterator[MarkdownRow]:
    data, scene = record.data, record.data.get("scene") or {}
    met = [scene.get(name) for name in ("contacts", "constraint_rows", "solver_iterations")]
    yield [
        record.case["engine"],
        f"{record.case['worlds']} x {record.roster}",
        _scene_words(record),
        number(data.get("robots_in_real_time", data["robot_steps_per_s"] * data["timestep"])),
        number(data["robot_steps_per_s"], MILLION),
        number(data["bare_robot_steps_per_s"], MILLION),
        number(baseline(record, "mujoco_rollout"), MILLION),
        number(baseline(record, "bare_mjx"), MILLION),
        ", ".join(number(one["mean"]) if one else "-" for one in met) if any(met) else "-",
    ]


def parts_table(records: Sequence[BenchRecord]) -> str:
    """Shares of a step's time: physics, sensors, all else."""
    head = (
        "when",
        "commit",
        "engine",
        "worlds x robots",
        "arena",
        "step [ms]",
        "physics",
        "sensors",
        "all else",
    )
    rows = []
    for record in of(records, "step"):
        data = record.data
        if "blind_times_s" not in data:
            continue
        whole, blind, bare = (median(data[f"{name}_times_s"]) for name in ("whole", "blind", "bare"))
        shares = bare / whole, (whole - blind) / whole, (blind - bare) / whole
        rows.append(
            [
                record.when,
                data["commit"],
                record.case["engine"],
                f"{record.case['worlds']} x {record.roster}",
                _scene_words(record),
                number(1e3 * whole / record.case["steps"]),
                *(f"{share:.0%}" for share in shares),
            ]
        )
    return table(head, rows)


def rays_table(records: Sequence[BenchRecord]) -> str:
    """Laser scans."""
    head = (
        "worlds x robots", "geoms in a world", "cast by", "G rays/s",
        "brute force, G rays/s", "`mj_multiRay` on all cores, G rays/s",
    )  # fmt: skip

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        yield [
            f"{record.case['worlds']} x {record.roster}",
            str(record.data["geoms_per_world"]),
            record.data.get("caster", "-"),
            number(record.data["rays_per_s"], BILLION),
            number(record.data["brute_force_rays_per_s"], BILLION),
            number(baseline(record, "mj_multiray"), BILLION),
        ]

    return records_table(records, "rays", head, rows)


def radio_table(records: Sequence[BenchRecord]) -> str:
    """Radio links."""
    head = (
        "worlds x robots", "walls", "counted on", "walls of its own, G links/s",
        "one arena for all, G links/s", "first wall by `mj_multiRay`, G links/s",
    )  # fmt: skip

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        yield [
            f"{record.case['worlds']} x {record.case['robots']}",
            str(record.case["walls"]),
            record.data.get("counted_on", "-"),
            number(record.data["links_per_s"], BILLION),
            number(record.data["links_per_s_shared_walls"], BILLION),
            number(baseline(record, "mj_multiray"), BILLION),
        ]

    return records_table(records, "radio", head, rows)


def camera_table(records: Sequence[BenchRecord]) -> str:
    """Pictures."""
    head = (
        "worlds x robots", "arena", "pixels", "pictures/s",
        "MuJoCo Warp's, with and without shadows", "`mj_multiRay`, no colours",
    )  # fmt: skip

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        yield [
            f"{record.case['worlds']} x {record.roster}",
            _scene_words(record),
            f"{record.case['width']} x {record.case['height']}",
            number(record.data["frames_per_s"]),
            ", ".join(number(one["frames_per_s"]) for one in record.data["peer"] or ()) or "-",
            number(baseline(record, "mj_multiray")),
        ]

    return records_table(records, "camera", head, rows)


def train_table(records: Sequence[BenchRecord]) -> str:
    """Training runs."""
    head = (
        "task", "engine", "worlds", "processes", "seed", "agent steps",
        "agent-steps/s, all waits", "median", "host waits", "GPU busy", "score", "baseline",
    )  # fmt: skip

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        yield [
            ", ".join(filter(None, [recorded_name(record.data["task"]), fields_of_record(record.data)])),
            record.data["engine"],
            str(record.data["worlds"]),
            str(record.data.get("processes", 1)),
            str(record.data["seed"]),
            number(record.data["agent_steps"]),
            *_training_rates(record.data),
            number(record.data["score"]),
            number(record.data["baseline"]),
        ]

    return records_table(records, "train", head, rows)


def wait_texts(waits: Mapping[str, float]) -> list[str]:
    """Return the shares of a training's time that the host waited, by reason; none that rounds to 0 %."""
    return [f"{reason} {share:.0%}" for reason, share in waits.items() if share >= 0.005]


def _training_rates(data: Mapping[str, Any]) -> list[str]:
    """Return the mean and the median rate, the host's waits, and the GPU's utilisation.

    Older records have the median alone.
    """
    if "median_agent_steps_per_s" not in data:
        return ["-", number(data["agent_steps_per_s"]), "-", "-"]
    waits = ", ".join(wait_texts(data["waits"]))
    busy = "-" if data["gpu_busy"] is None else f"{data['gpu_busy']:.0%}"
    mean, middle = data["agent_steps_per_s"], data["median_agent_steps_per_s"]
    return [number(mean), number(middle), waits or "-", busy]


def serve_table(records: Sequence[BenchRecord]) -> str:
    """Waiting times of clients: our own server of each record."""
    wanted: Mapping[str, Callable[[str], bool]] = {
        "listening, cold [s]": lambda name: name == "start cold listening_s",
        "INIT of a P2AT, cold [s]": lambda name: name == "init cold P2AT first_sta_s",
        "16 driving, CPU s/s": lambda name: name == "load 16 robots driving cpu_per_simulated_s",
        "64 driving, CPU s/s": lambda name: name == "load 64 robots driving cpu_per_simulated_s",
    }

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        figures = dict(figure_rows(record.data["servers"][0]["figures"]))
        cells = [
            next((number(figure["median"]) for name, figure in figures.items() if fits(name)), "-")
            for fits in wanted.values()
        ]
        yield [*cells, record.data.get("note") or "-"]

    return records_table(records, "serve", (*wanted, "note"), rows)


def viewer_table(records: Sequence[BenchRecord]) -> str:
    """The live page."""
    head = ("robots", "CPU ms an update", "with sending", "KiB/s to a browser")

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        for name, row in record.data["updates"].items():
            yield [
                name,
                number(row["update_cpu_ms"]),
                number(row["process_cpu_ms"]),
                number(row["bytes_per_s"], 1024),
            ]

    return records_table(records, "viewer", head, rows)


def compile_table(records: Sequence[BenchRecord]) -> str:
    """The way to the first step."""
    head = (
        "engine", "worlds x robots", "cache", "imports [s]", "scene [s]", "batch [s]",
        "tracing [s]", "XLA [s]", "first step [s]",
    )  # fmt: skip

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        for temperature, stages in record.data["stages"].items():
            yield [
                record.case["engine"],
                f"{record.case['worlds']} x {record.roster}",
                temperature,
                *(number(one and one["median"]) for one in stages.values()),
            ]

    return records_table(records, "compile", head, rows)


def memory_table(records: Sequence[BenchRecord]) -> str:
    """Memory of worlds."""
    head = (
        "engine", "robots", "worlds", "state [MB]", "of it physics",
        "a step more [MB]", "peak on the device [MB]",
    )  # fmt: skip

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        for row in record.data["rows"]:
            yield [
                record.case["engine"],
                record.roster,
                str(row["worlds"]),
                number(row["state_bytes"], MILLION),
                f"{row['parts']['physics'] / row['state_bytes']:.0%}",
                number(row["compiled"] and row["compiled"]["temp_bytes"], MILLION),
                number(row["device_peak_bytes"], MILLION),
            ]

    return records_table(records, "memory", head, rows)


def sweep_table(records: Sequence[BenchRecord]) -> str:
    """Sweeps: how many cells in how long."""
    head = (
        "sweep", "engine", "cells", "failed", "batches", "compilations", "episodes", "to the last cell [s]",
        "of it compilation [s]", "agent-steps/s with it", "score, 95 % interval",
    )  # fmt: skip

    def rows(record: BenchRecord) -> Iterator[MarkdownRow]:
        data, rates = record.data, record.data["rates"]
        yield [
            record.case["sweep"],
            ", ".join(record.case["engines"]),
            *(number(data[name]) for name in ("cells", "failed", "batches", "compilations", "episodes")),
            number(data["wall_s"]),
            number(data["compile_s"]),
            number(rates["agent_steps"]["rate"] if "agent_steps" in rates else None),
            "; ".join(
                f"{recorded_name(row['task'])}, {row['policy']}: {number(row['score'])} "
                f"({number(row['low'])} to {number(row['high'])})"
                for row in data["scores"]
            ),
        ]

    return records_table(records, "sweep", head, rows)


RATE_KEYS = {
    "step": ("robot_steps_per_s", "robot-steps/s"),
    "rays": ("rays_per_s", "rays/s"),
    "radio": ("links_per_s", "links/s"),
    "camera": ("frames_per_s", "pictures/s"),
}
"""The rate of each benchmark whose history is told, in records of any form."""


def history_table(records: Sequence[BenchRecord]) -> str:
    """The same case at several commits."""
    kept: dict[tuple[str, ...], list[BenchRecord]] = {}
    for record in records:
        if record.benchmark in RATE_KEYS:
            case = record.case
            rest = _scene_words(record), str(case.get("walls", "-")), str(case.get("width", "-"))
            engine = case.get("engine", "-")
            key = record.benchmark, record.where, engine, f"{case['worlds']} x {record.roster}", *rest
            kept.setdefault(key, []).append(record)
    rows = []
    for (benchmark, where, engine, size, *_), same in kept.items():
        if len(same) < 2:
            continue
        name, unit = RATE_KEYS[benchmark]
        rates = [record.data[name] for record in same]
        told = ", ".join(
            f"{number(rate)} ({record.data['commit']})" for rate, record in zip(rates, same, strict=True)
        )
        rows.append([benchmark, where, engine, size, unit, told, f"{rates[-1] / rates[0]:.2f}"])
    return table(
        ("benchmark", "on", "engine", "worlds x robots", "unit", "oldest first", "last to first"), rows
    )
