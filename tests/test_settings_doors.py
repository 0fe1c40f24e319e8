"""One setting at all doors: command line, sweeps, YAML, ini, arena files and Python agree."""

from pathlib import Path

import pytest
import yaml

from usarmjx.base.errors import ArenaFileError, UsageError
from usarmjx.base.settings import Text, from_data, from_text, read_file
from usarmjx.cli.task_options import task_pairs
from usarmjx.models.files.maps import READER, MapDescription
from usarmjx.models.files.yaml_file import ARENA_READER
from usarmjx.models.ini.items import WarningLog, read_settings
from usarmjx.models.ini.parse import read_ini
from usarmjx.models.types.arena import Door
from usarmjx.models.types.robot import resolve_settings
from usarmjx.sensors.suite import SENSORS
from usarmjx.sweeps.resolve import typed_settings
from usarmjx.train import Config
from usarmjx.train.make import make_task, task_values
from usarmjx.train.policies.sources import task_settings

TASK = "drive-to-goal"
SONAR = SENSORS.get("Sonar").settings_class


def file_with(folder: Path, text: str, suffix: str = "yaml") -> Path:
    path = folder / f"a.{suffix}"
    path.write_text(text)
    return path


def plain(text: str) -> object:
    """A value as Python code would have it: YAML's, but for the numbers that YAML 1.1 takes for words."""
    try:
        return float(text)
    except ValueError:
        return yaml.safe_load(text)


def of_set(text, folder):
    return task_values(make_task(TASK), {"radius": text})["radius"]


def of_eval(text, folder):
    return task_settings(TASK, {}, [f"radius={text}"])[0]["radius"]


def of_sweep(text, folder):
    return typed_settings({"fields.radius": text}, [TASK])["fields.radius"]


def of_config(text, folder):
    pairs = task_pairs(TASK, [], file_with(folder, f"radius: {text}\n"))
    return task_settings(TASK, {}, pairs)[0]["radius"]


def of_python(text, folder):
    return make_task(TASK, radius=plain(text)).radius


def of_arena(text, folder):
    file = file_with(folder, f"{{name: a, at: [0, 0, 0], size: [{text}, 1, 1]}}\n")
    return ARENA_READER.from_data(Door, read_file(file, ArenaFileError)).size[0]


def of_map(text, folder):
    file = file_with(folder, f"image: a.png\nresolution: {text}\n")
    return READER.from_data(MapDescription, read_file(file, ArenaFileError)).resolution


def of_sensor(text, folder):
    return resolve_settings(SONAR, (("MinRange", 0.0), ("MaxRange", plain(text))), "Sonar F1").max_range


def of_ini(text, folder):
    section = "USARBot.SonarSensor"
    (line,) = read_ini(file_with(folder, f"[{section}]\nMaxRange={text}\n", "ini")).section(section).lines
    given = read_settings("Sonar", [("MaxRange", line, line.value)], {"Sonar": SONAR}, WarningLog())
    return resolve_settings(SONAR, (*given, ("MinRange", 0.0)), "Sonar F1").max_range


DOORS = (of_set, of_eval, of_sweep, of_config, of_python, of_arena, of_map, of_sensor, of_ini)


@pytest.mark.parametrize("door", DOORS)
def test_all_doors_convert_a_length_alike(door, tmp_path):
    found = [door(text, tmp_path) for text in ("1e-3", "2", "50cm", "0.25m")]
    assert found == [0.001, 2.0, 0.5, 0.25]
    if door is not of_sweep:  # its cells are found by a hash of the data as given
        assert {type(number) for number in found} == {float}


@pytest.mark.parametrize("text", ["nan", ".nan", "-1", "0", "inf", "-inf", "90deg", "true", "far", "1e-40"])
@pytest.mark.parametrize("door", DOORS)
def test_all_doors_refuse_the_same_lengths_in_the_same_words(door, text, tmp_path):
    if text == "1e-40" and door in (of_arena, of_map):
        assert door(text, tmp_path) == 1e-40, "compiled in double precision"
        return
    with pytest.raises(UsageError, match=r"expected a number above 0 \[m\]"):
        door(text, tmp_path)


@pytest.mark.parametrize(("text", "count"), [("64", 64), ("64.0", 64), ("1e3", 1000)])
def test_whole_numbers_are_whole_however_they_are_written(text, count, tmp_path):
    file = read_file(file_with(tmp_path, f"num_worlds: {text}\n"))
    found = (
        from_text(Config, {"num_worlds": Text(text)}).num_worlds,
        from_data(Config, file).num_worlds,
        Config(num_worlds=plain(text)).num_worlds,
    )
    assert found == (count,) * 3
    assert {type(number) for number in found} == {int}


@pytest.mark.parametrize("text", ["64.7", "nan", "true", "0", "-3"])
def test_all_doors_refuse_the_same_counts(text, tmp_path):
    file = read_file(file_with(tmp_path, f"num_worlds: {text}\n"))
    for door in (
        lambda: from_text(Config, {"num_worlds": Text(text)}),
        lambda: from_data(Config, file),
        lambda: Config(num_worlds=plain(text)),
    ):
        with pytest.raises(UsageError, match=r"num_worlds is .*, expected a whole number from 1"):
            door()


def test_lists_keep_to_the_type_of_their_items():
    with pytest.raises(UsageError, match=r"hidden_sizes\[0\] is '64\.7', expected a whole number from 1"):
        from_text(Config, {"hidden_sizes": Text("64.7,64")})
    with pytest.raises(UsageError, match=r"hidden_sizes\[0\] is 64\.7, expected a whole number from 1"):
        Config(hidden_sizes=(64.7, 64))
