"""One setting at all doors: `--set` of train, eval and sweep, a file, Python; and the table of the page."""

from pathlib import Path

import pytest

from usarmjx.base.errors import UsageError
from usarmjx.base.settings import parse_assignments, settings_markdown
from usarmjx.cli.train_plan import TrainOptions, read_settings
from usarmjx.sweeps.resolve import resolve, typed_settings
from usarmjx.sweeps.spec import complete
from usarmjx.train.learning.config import Config, task_config
from usarmjx.train.make import make_task
from usarmjx.train.policies.sources import task_settings

TASK = "drive-to-goal"
PAGE = Path(__file__).parents[2] / "docs/training-settings.md"
OPTIONS = {"out": Path("x"), "engine": "c", "given": {}, "pairs": []}


def by_train(name, text):
    fields = read_settings(make_task(TASK), TrainOptions(**{**OPTIONS, "pairs": [f"{name}={text}"]})).fields
    return make_task(TASK, **task_settings(TASK, fields, ())[0])


def by_eval(name, text):
    return make_task(TASK, **task_settings(TASK, {}, [f"{name}={text}"])[0])


def by_sweep(name, text):
    given = typed_settings(parse_assignments([f"{name}={text}"]), [TASK])
    return resolve(complete({"task": TASK, "arena": "floor", **given}, "a cell")).task


TEXT_DOORS = (by_train, by_eval, by_sweep)


@pytest.mark.parametrize("door", TEXT_DOORS)
@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("radius", "1e-3", 0.001),
        ("radius", "50cm", 0.5),
        ("radius", "1", 1.0),
        ("shuffle", "on", True),
        ("shuffle", "no", False),
        ("episode_steps", "1e2", 100),
        ("ranges", "Sonar,IR", ("Sonar", "IR")),
    ],
)
def test_every_door_reads_the_same_texts(door, name, text, value):
    found = getattr(door(name, text), name)
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize("door", [by_eval, by_sweep])
@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("radius", "nan", "a number above 0"),
        ("radius", ".nan", "a number above 0"),
        ("radius", "-1", "a number above 0"),
        ("radius", "90deg", "a number above 0"),
        ("haste", "inf", "a number"),
        ("episode_steps", "64.7", "a whole number from 1"),
        ("shuffle", "perhaps", "true or false"),
    ],
)
def test_every_door_refuses_the_same_texts(door, name, text, expected):
    with pytest.raises(UsageError, match=rf"^--set: {name} is '?\.?{text.strip('.')}'?, expected {expected}"):
        door(name, text)


@pytest.mark.parametrize(
    ("name", "value"),
    [("radius", float("nan")), ("radius", -1), ("haste", float("inf")), ("radius", "1"), ("repeat", 0)],
)
def test_python_and_files_refuse_the_same_values(name, value, tmp_path):
    with pytest.raises(UsageError, match=rf"^DriveToGoal: {name} is .*, expected a"):
        make_task(TASK, **{name: value})
    file = tmp_path / "run.yaml"
    shown = {"nan": ".nan", "inf": ".inf"}.get(str(value), repr(value))
    file.write_text(f"gamma: 0.9\n{name}: {shown}\n")
    with pytest.raises(UsageError, match=rf"run.yaml:2: {name} is .*, expected a"):
        read_settings(make_task(TASK), TrainOptions(**OPTIONS, config=file))


@pytest.mark.parametrize("text", ["64.7,64", "0,64", "[]", "a"])
def test_widths_of_layers_are_whole_numbers(text):
    with pytest.raises(UsageError, match="expected a"):
        read_settings(make_task(TASK), TrainOptions(**{**OPTIONS, "pairs": [f"hidden_sizes={text}"]}))
    with pytest.raises(UsageError, match="expected a"):
        task_config(TASK, hidden_sizes=(64.7, 64))


def test_file_and_options_add_up(tmp_path):
    """The last counts: file, `--set`, own options; fields of the task are texts that records keep."""
    file = tmp_path / "run.yaml"
    file.write_text("gamma: 0.9\nradius: 1e-3\nradio: {cutoff: -60}\nphysics: fast\n")
    pairs = ["gamma=0.8", "radio.pdo=-40", "physics.iterations=3"]
    options = {**OPTIONS, "pairs": pairs, "given": {"num_worlds": 8}}
    found = read_settings(make_task(TASK), TrainOptions(**options, config=file))
    assert found.training == {"gamma": 0.8, "num_worlds": 8}
    assert found.fields == {
        "radius": "0.001", "radio.cutoff": "-60", "physics": "fast", "radio.pdo": "-40",
        "physics.iterations": "3",
    }  # fmt: skip


def test_a_setting_is_given_once():
    options = TrainOptions(**{**OPTIONS, "pairs": ["gamma=0.8"], "given": {"gamma": 0.9}})
    with pytest.raises(UsageError, match="gamma is given twice, by --gamma and by --set"):
        read_settings(make_task(TASK), options)


def test_the_page_has_the_table_of_the_declarations():
    table = PAGE.read_text().partition("<!-- settings of Config -->\n")[2].partition("<!-- end -->")[0]
    assert table.strip() == settings_markdown(Config).strip()
