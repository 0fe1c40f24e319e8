import json
import math
import subprocess
import sys
import types
import warnings
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usarmjx.base.errors import ArenaFileError, SpecError, UnknownNameError, UsageError
from usarmjx.base.settings import (
    NOT_NEGATIVE,
    POSITIVE,
    SHARE,
    Setting,
    Text,
    describe,
    from_data,
    from_text,
    json_schema,
    parse_assignments,
    read_file,
    rows_of,
    settings_markdown,
    settings_table,
    to_data,
    to_text,
    to_yaml,
    validate,
)
from usarmjx.base.settings.declaration import UncheckedSettingWarning
from usarmjx.base.settings.reader import Reader
from usarmjx.base.settings.text import parse_list, parse_mapping, parse_number


class Colour(Enum):
    RED = "red"
    DEEP_BLUE = "blue"


class Group(NamedTuple):
    name: str
    size: int


GROUP = Group("a", 1)


class Opaque:
    """No settings: built in Python only."""


@dataclass(frozen=True, kw_only=True)
class Solver:
    """A solver.

    Attributes:
        timestep: Time of a step [s].
        kind: Which one.
    """

    timestep: Annotated[float, POSITIVE] = 0.005
    kind: Literal["CG", "Newton"] = "CG"

    def __post_init__(self):
        validate(self)


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run.

    Attributes:
        radius: Distance at which a goal counts [m]. More is
            told here.
        gamma: Discount of the next step's value.
        low, high: Range of the sensor [m].
    """

    radius: Annotated[float, POSITIVE] = 0.5
    gamma: Annotated[float, SHARE, Setting(aliases=("discount",))] = 0.99
    num_worlds: Annotated[int, Setting(ge=1, le=10**9)] = 64
    hidden_sizes: Annotated[tuple[Annotated[int, Setting(ge=1)], ...], Setting(min_length=1)] = (64, 64)
    shared: bool = False
    yaw: Annotated[float, Setting(unit="rad", help="Angle about the vertical.")] = 0.0
    schedule: Annotated[str, Setting(choices=("constant", "Linear"))] = "constant"
    engine: Annotated[str, Setting(choices=lambda: ("c", "planar"))] = "c"
    name: Annotated[str, Setting(max_length=20)] = "mine"
    colour: Colour = Colour.RED
    solver: Solver = Solver()
    physics: Solver | str = "reference"
    radio: Solver | None = None
    span: tuple[float, float] | float | None = None
    corners: tuple[tuple[float, float], ...] = ()
    roster: dict[str, Annotated[int, Setting(ge=1)]] = field(default_factory=dict)
    file: Path | None = None
    reach: Annotated[float, Setting(gt=0, finite=False)] = math.inf
    limit: float | None = None
    group: Group = GROUP
    low: Annotated[float, NOT_NEGATIVE] = 0.1
    high: float = 5.0
    robot: str | Opaque = "P2AT"

    def __post_init__(self):
        validate(self)

    def problem(self) -> str:
        return "" if self.low < self.high else f"low is {self.low:g}, expected below high, {self.high:g}"


@dataclass(frozen=True)
class Needed:
    size: Annotated[float, POSITIVE]
    name: str = "it"


def from_pairs(*pairs: str) -> Run:
    return from_text(Run, parse_assignments(pairs, "--set"))


def refusal(action, *args, **kwargs) -> str:
    with pytest.raises(UsageError) as caught:
        action(*args, **kwargs)
    text = str(caught.value)
    assert "\n" not in text
    return text


# One value, three doors: a text, data and Python.

SAME = [
    ("radius", "1e-3", 1e-3, 0.001),
    ("radius", ".5", 0.5, 0.5),
    ("radius", "2", 2, 2.0),
    ("radius", "50cm", "50cm", 0.5),
    ("radius", "50 cm", "50 cm", 0.5),
    ("radius", "0.5m", "0.5m", 0.5),
    ("yaw", "90deg", "90deg", math.pi / 2),
    ("yaw", "-1.5", -1.5, -1.5),
    ("num_worlds", "1e6", 1e6, 1_000_000),
    ("num_worlds", "1_000", 1000, 1000),
    ("hidden_sizes", "64,32", [64, 32], (64, 32)),
    ("hidden_sizes", "(64, 32)", (64, 32), (64, 32)),
    ("hidden_sizes", "[64]", [64], (64,)),
    ("hidden_sizes", "64", [64], (64,)),
    ("shared", "yes", True, True),
    ("shared", "ON", True, True),
    ("shared", "0", False, False),
    ("schedule", "LINEAR", "linear", "Linear"),
    ("engine", "planar", "planar", "planar"),
    ("name", "1e-3", "1e-3", "1e-3"),
    ("colour", "blue", "blue", Colour.DEEP_BLUE),
    ("colour", "deep_blue", "DEEP_BLUE", Colour.DEEP_BLUE),
    ("physics", "fast", "fast", "fast"),
    ("radio", "none", None, None),
    ("span", "None", None, None),
    ("span", "1.5", 1.5, 1.5),
    ("span", "1,2", [1, 2], (1.0, 2.0)),
    ("corners", "(0,1),(2,3)", [[0, 1], [2, 3]], ((0.0, 1.0), (2.0, 3.0))),
    ("corners", "[]", [], ()),
    ("roster", "P2AT:4,Kenaf:2", {"P2AT": 4, "Kenaf": 2}, {"P2AT": 4, "Kenaf": 2}),
    ("roster", "{P2AT: 4}", {"P2AT": 4}, {"P2AT": 4}),
    ("file", "a/b.yaml", "a/b.yaml", Path("a/b.yaml")),
    ("reach", "inf", math.inf, math.inf),
    ("limit", "null", None, None),
    ("limit", "3", 3, 3.0),
    ("group", "b,3", ["b", 3], Group("b", 3)),
]


@pytest.mark.parametrize(("name", "text", "data", "value"), SAME)
def test_doors_agree(name, text, data, value):
    expected = Run(**{name: value})
    found = getattr(expected, name)
    assert found == value
    assert type(found) is type(value)
    for run in (from_pairs(f"{name}={text}"), from_data(Run, {name: data}), Run(**{name: data})):
        assert run == expected
        assert type(getattr(run, name)) is type(value)


# What no door takes: a text, data (None: the same as Python's), and the allowed values that are named.

NUMBER, WHOLE = "a number above 0 [m]", "a whole number from 1 to 1e+09"
REFUSED = [
    ("radius", "nan", math.nan, NUMBER),
    ("radius", "inf", math.inf, NUMBER),
    ("radius", "1e999", 10**400, NUMBER),
    ("radius", "-1", -1, NUMBER),
    ("radius", "0", 0.0, NUMBER),
    ("radius", "far", "far", NUMBER),
    ("radius", "", "", NUMBER),
    ("radius", "5 deg", "5 deg", NUMBER),
    ("radius", "true", True, NUMBER),
    ("radius", "1,2", [1.0], NUMBER),
    ("radius", "none", None, NUMBER),
    ("radius", "1e-45", 1e-45, "magnitudes from 1.2e-38 to 3.4e+38"),
    ("radius", "1e39", 1e39, "magnitudes from 1.2e-38 to 3.4e+38"),
    ("gamma", "1.01", 1.01, "a number from 0 to 1"),
    ("num_worlds", "64.7", 64.7, WHOLE),
    ("num_worlds", "0", 0, WHOLE),
    ("num_worlds", "true", True, WHOLE),
    ("num_worlds", "1e300", 1e300, WHOLE),
    ("num_worlds", "9" * 500, 10**499, WHOLE),
    ("hidden_sizes", "64.7,64", [64.7, 64], "hidden_sizes[0] is"),
    ("hidden_sizes", "64,0", [64, 0], "hidden_sizes[1] is"),
    ("hidden_sizes", "[]", [], "a list of at least 1 whole numbers from 1"),
    ("hidden_sizes", "[64", "64", "a list of"),
    ("shared", "maybe", "true", "true or false"),
    ("shared", "2", 1, "true or false"),
    ("schedule", "liner", "liner", "one of constant, Linear; did you mean 'Linear'?"),
    ("schedule", "4", 4, "one of constant, Linear"),
    ("engine", "mujoco", "mujoco", "one of c, planar"),
    ("name", "a" * 21, "a" * 21, "a text of at most 20 characters"),
    ("colour", "green", 3, "one of red, blue"),
    ("solver", "fast", "fast", "settings of Solver"),
    ("radio", "fast", "fast", "settings of Solver or none"),
    ("span", "1,2,3", [1, 2, 3], "a list of 2 numbers"),
    ("corners", "1,2", [1, 2], "corners[0] is"),
    ("corners", "(1,2", [[1]], "a list of"),
    ("roster", "P2AT:0", {"P2AT": 0}, "roster.P2AT is"),
    ("roster", "P2AT", ["P2AT"], "a mapping of names to whole numbers from 1"),
    ("file", "", 3, "a path"),
    ("reach", "nan", math.nan, "a number above 0 or inf"),
    ("group", "b", ["b"], "a list of name (a text), size (a whole number)"),
]


@pytest.mark.parametrize(("name", "text", "data", "allowed"), REFUSED)
def test_all_doors_refuse(name, text, data, allowed):
    doors = {
        "--set: ": refusal(from_pairs, f"{name}={text}"),
        "run.yaml: ": refusal(from_data, Run, {name: data}, where="run.yaml"),
        "Run: ": refusal(Run, **{name: data}),
    }
    for start, said in doors.items():
        assert said.startswith(start + name)
        assert allowed in said
        assert " is " in said


def test_plain_texts_are_no_numbers_of_data():
    assert "radius is '0.5'" in refusal(from_data, Run, {"radius": "0.5"})


def test_refusals_quote_no_more_than_a_line_of_a_value():
    said = refusal(from_data, Run, {"radius": "\n" * 1000})
    assert len(said) < 400


# Nested settings.


def test_dots_lead_into_nested_settings():
    run = from_pairs("solver.timestep=2ms", "radio.kind=newton", "physics.timestep=1")
    assert run == Run(
        solver=Solver(timestep=0.002), radio=Solver(kind="Newton"), physics=Solver(timestep=1.0)
    )


def test_nested_refusals_name_the_way():
    assert refusal(from_pairs, "solver.timestep=0").startswith(
        "--set: solver.timestep is '0', expected a number"
    )
    said = refusal(from_data, Run, {"radio": {"timestep": 1, "knd": "CG"}}, where="a")
    assert said == "a: radio: Solver has no setting 'knd'; did you mean 'kind'? It has: timestep, kind"


@pytest.mark.parametrize("pairs", [("solver=x", "solver.kind=CG"), ("solver.kind=CG", "solver=x")])
def test_a_setting_is_not_given_whole_and_in_parts(pairs):
    assert "too" in refusal(from_pairs, *pairs)


@pytest.mark.parametrize("name", [".radius", "solver.", ""])
def test_empty_names_are_refused(name):
    refusal(from_text, Run, {name: "1"})


def test_the_class_that_knows_the_keys_is_meant():
    @dataclass(frozen=True)
    class Either:
        one: str | Solver | Needed = ""

    assert from_data(Either, {"one": {"size": 1}}).one == Needed(1.0)
    assert from_data(Either, {"one": {"timestep": 1}}).one == Solver(timestep=1.0)
    assert "one.size is 0, expected" in refusal(from_data, Either, {"one": {"size": 0, "name": "x"}})


def test_instances_are_taken_as_they_are():
    robot, solver = Opaque(), Solver(timestep=1)
    run = Run(robot=robot, solver=solver)
    assert run.robot is robot
    assert run.solver is solver
    assert "a text or a value of type Opaque" in refusal(Run, robot=3)


# Names.


def test_unknown_names_are_refused_with_the_likely_one():
    said = refusal(from_pairs, "raduis=1")
    assert said.startswith(
        "--set: Run has no setting 'raduis'; did you mean 'radius'? It has: radius, gamma,"
    )
    with pytest.raises(UnknownNameError):
        from_data(Run, {"nothing like it": 1})


def test_old_names_are_accepted_with_one_warning():
    with pytest.warns(DeprecationWarning, match="^--set: discount of Run is called gamma now") as caught:
        assert from_pairs("discount=0.5") == Run(gamma=0.5)
    assert len(caught) == 1


def test_an_old_name_beside_the_new_one_is_refused():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert "gamma is given twice, as 'discount' too" in refusal(from_pairs, "gamma=1", "discount=1")


def test_old_names_of_files_are_renamed_silently():
    assert Reader().current_names(Run, {"discount": 1, "radius": 2}) == {"gamma": 1, "radius": 2}
    assert Reader().names(Run)["discount"] == "gamma"


def test_the_manuals_keys_are_names_where_a_spelling_is_given():
    @dataclass(frozen=True)
    class Sonar:
        max_range: float = 5.0
        power: Annotated[float, Setting(manual_key="dBmTXPower")] = 1.0

    def spelling(key: str) -> str:
        return key.lower().replace("maxrange", "max_range")

    reader = Reader(spelling=spelling)
    assert reader.from_data(Sonar, {"MaxRange": 2, "dBmTXPower": 3}) == Sonar(2.0, 3.0)
    said = refusal(reader.from_data, Sonar, {"MaxRange": 2, "dBmTXPower": "x"}, where="Sonar F1")
    assert said == "Sonar F1: dBmTXPower is 'x', expected a number"  # by the name that was given
    assert reader.from_data(Sonar, {"max_range": 2, "power": 3}) == Sonar(2.0, 3.0)
    assert "has no setting 'dBmTXPower'" in refusal(from_data, Sonar, {"dBmTXPower": 3})


def test_an_alias_is_not_the_name_of_another_setting():
    @dataclass(frozen=True)
    class Clash:
        a: Annotated[int, Setting(aliases=("b",))] = 1
        b: int = 2

    assert "alias 'b'" in refusal(from_data, Clash, {})


def test_missing_names_are_refused():
    assert refusal(from_data, Needed, {"name": "x"}, where="a.yaml") == (
        "a.yaml: has no 'size', expected a number above 0"
    )
    assert Reader().from_data(Needed, {}, defaults={"size": 2}) == Needed(2.0)


# Instances to start from, and rules between settings.


def test_settings_over_an_instance_keep_its_others():
    base = Run(radius=3.0, solver=Solver(timestep=1.0), radio=Solver(kind="Newton"))
    found = from_data(
        Run, {"solver": {"kind": "Newton"}, "radio": {"timestep": 2}, "physics": "x"}, base=base
    )
    assert found == replace(
        base,
        solver=Solver(timestep=1.0, kind="Newton"),
        radio=Solver(timestep=2.0, kind="Newton"),
        physics="x",
    )
    assert from_text(Run, {"solver.kind": "newton"}, base=base).solver == Solver(timestep=1.0, kind="Newton")


def test_settings_that_do_not_go_together_are_refused_at_all_doors():
    for action in (lambda: from_pairs("low=6"), lambda: from_data(Run, {"low": 6}), lambda: Run(low=6)):
        assert "low is 6, expected below high, 5" in refusal(action)


def test_rules_and_types_of_a_reader():
    reader = Reader(
        special={Opaque: lambda value: Opaque()},
        rules={Needed: lambda one: "" if one.size < 9 else "is too large"},
        refusal=ArenaFileError,
    )
    assert isinstance(reader.from_data(Run, {"robot": {"any": "thing"}}).robot, Opaque)
    assert reader.from_data(Needed, {"size": 8}) == Needed(8.0)
    with pytest.raises(ArenaFileError, match=r"^a[.]yaml: is too large"):
        reader.from_data(Needed, {"size": 9}, where="a.yaml")
    with pytest.raises(ArenaFileError, match="no setting 'x'"):
        reader.from_data(Needed, {"x": 9})


def test_checked_values_are_those_that_are_given():
    assert Reader().text_values(Run, {"radius": "1", "solver.kind": "CG"}) == {
        "radius": 1.0,
        "solver": Solver(),
    }


def test_python_values_become_those_of_the_fields():
    run = Run(
        radius=1,
        hidden_sizes=[np.int64(3)],
        gamma=np.float32(0.5),
        shared=np.bool_(True),
        limit=np.float64(2),
    )
    found = (run.radius, run.hidden_sizes, run.gamma, run.shared, run.limit)
    assert [type(one) for one in found] == [float, tuple, float, bool, float]
    assert found == (1.0, (3,), 0.5, True, 2.0)
    assert type(run.hidden_sizes[0]) is int


def test_a_derived_class_with_another_default_keeps_the_limits():
    @dataclass(frozen=True, kw_only=True)
    class Longer(Run):
        radius: float = 2.0
        gamma: Annotated[float, Setting(lt=0.9)] = 0.5

    assert NUMBER in refusal(from_data, Longer, {"radius": -1})
    assert "from 0, below 0.9" in refusal(from_data, Longer, {"gamma": 0.95})


# Files.


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_refusals_of_files_name_the_line(tmp_path):
    path = write(tmp_path / "run.yaml", "radius: 1\nsolver:\n  kind: CG\n  timestep: 0\n")
    assert refusal(from_data, Run, read_file(path)) == (
        f"{path}:4: solver.timestep is 0, expected a number above 0 [s]"
    )
    path = write(tmp_path / "run.yaml", "radius: 1\n\nhidden_sizes: [1,\n  .nan]\n")
    assert refusal(from_data, Run, read_file(path)).startswith(f"{path}:4: hidden_sizes[1] is nan, expected")
    path = write(tmp_path / "run.yaml", "solver:\n  knd: 3\n")
    assert refusal(from_data, Run, read_file(path)).startswith(
        f"{path}:2: solver: Solver has no setting 'knd'"
    )
    path = write(tmp_path / "run.yaml", "name: x\nlow: 9\n")
    assert refusal(from_data, Run, read_file(path)).startswith(f"{path}:1: ")
    path = write(tmp_path / "run.toml", "[solver]\ntimestep = 0\n")
    assert refusal(from_data, Run, read_file(path)).startswith(f"{path}: solver.timestep is 0")


def test_texts_of_an_ini_file_name_their_own_line():
    said = refusal(from_text, Run, {"radius": Text("-1", "robots.ini:12"), "yaw": "1"}, where="robots.ini")
    assert said.startswith("robots.ini:12: radius is '-1'")


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".yaml", "radius: 1e-3\nyaw: 90deg\nhidden_sizes: [3]\nfile: a.png\nreach: .inf\nshared: on\n"),
        (".json", '{"radius": 1e-3, "yaw": "90deg", "hidden_sizes": [3], "file": "a.png", "shared": true}'),
        (".toml", 'radius = 1e-3\nyaw = "90deg"\nhidden_sizes = [3]\nfile = "a.png"\nshared = true\n'),
    ],
)
def test_files_of_all_kinds_say_the_same(tmp_path, suffix, text):
    found = from_data(Run, read_file(write(tmp_path / f"run{suffix}", text)))
    file = tmp_path / "a.png"  # from the file's folder
    assert found == Run(radius=0.001, yaw=math.pi / 2, hidden_sizes=(3,), file=file, shared=True)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", ": is empty"),
        ("a: [1", "is no YAML"),
        ("a: 1\na: 2", ":2: key 'a' is there twice"),
        ("? [1]\n: 2", "a key is a word"),
        ("k" * 101 + ": 2", "a key of 101 characters"),
        ("a: &a [*a]", "contains itself"),
        ("a: " + "1" * 101, "a number of 101 characters"),
        ("a: !!python/object:os.system x", "is no YAML"),
        ("a: " + "[" * 5000, "nested too deeply"),
        ("a: &a [1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b]\n"
         "d: &d [*c,*c,*c,*c,*c,*c,*c,*c]\ne: &e [*d,*d,*d,*d,*d,*d,*d,*d]\nf: &f [*e,*e,*e,*e,*e,*e,*e,*e]\n"
         "g: [*f,*f]", "more than 500000 values"),
    ],
)  # fmt: skip
def test_files_beyond_the_limits_are_refused(tmp_path, text, problem):
    path = write(tmp_path / "a.yaml", text)
    with pytest.raises(ArenaFileError) as caught:
        read_file(path, ArenaFileError)
    assert str(caught.value).startswith(str(path))
    assert problem in str(caught.value)


def test_files_that_do_not_read_are_refused(tmp_path):
    assert "cannot be read" in refusal(read_file, tmp_path / "none.yaml")
    assert "is no TOML" in refusal(read_file, write(tmp_path / "a.toml", "a = "))
    with (tmp_path / "large.yaml").open("wb") as file:
        file.truncate(16_000_001)
    assert "too many" in refusal(read_file, tmp_path / "large.yaml")


# The grammar of texts.


@pytest.mark.parametrize(
    ("text", "items"),
    [
        ("", []),
        ("()", []),
        ("a", ["a"]),
        ("a, b,", ["a", "b"]),
        ("a,,b", ["a", "", "b"]),
        ("(0,1),(2,3)", ["(0,1)", "(2,3)"]),
        ("[(0,1),(2,3)]", ["(0,1)", "(2,3)"]),
        ("[a)", None),
        ("a]", None),
        ("((a)", None),
    ],
)
def test_lists_of_texts(text, items):
    assert parse_list(text) == items


@pytest.mark.parametrize(
    ("text", "number"),
    [("1", 1), ("+1.", 1.0), (".5", 0.5), ("1E3", 1000.0), ("-.inf", -math.inf), ("1 m", 1), ("1km", 1000.0)]
    + [
        (text, None)
        for text in ("", "m", "1e", "1e5x", "0x10", "1 2", "--1", "\u0661", "1 deg", "1m m", "_1", "1,5")
    ],
)
def test_numbers_of_texts(text, number):
    found = parse_number(text, "m")
    assert found == number
    assert type(found) is type(number)


def test_mappings_of_texts():
    assert parse_mapping("a:1, b: (2,3)") == {"a": "1", "b": "(2,3)"}
    assert [parse_mapping(text) for text in ("a", ":1", "a:1,a:2", "{a:1")] == [None] * 4
    assert parse_mapping("{}") == {}


def test_assignments():
    assert parse_assignments(["a=b=c", " d = "], "--set") == {"a": "b=c", "d": ""}
    assert "--set: 'a' is not of the form name=value" in refusal(parse_assignments, ["a"], "--set")
    assert "not of the form" in refusal(parse_assignments, ["=1"])
    assert "--set: a is given twice: '1' and '2'" in refusal(parse_assignments, ["a=1", "a=2"], "--set")


# What is written is read again.

finite = st.floats(allow_nan=False, allow_infinity=False, width=32, allow_subnormal=False)
positive = st.floats(2.0**-126, 1e30, allow_subnormal=False)
words = st.text(st.characters(codec="ascii", exclude_categories=["C"]), max_size=20).map(str.strip)
solvers = st.builds(Solver, timestep=positive, kind=st.sampled_from(["CG", "Newton"]))
names = st.text("abcXYZ", min_size=1, max_size=5)
runs = st.builds(
    Run,
    radius=positive,
    gamma=st.floats(0, 1, allow_subnormal=False).filter(lambda x: x == 0 or x > 1e-30),
    num_worlds=st.integers(1, 10**9),
    hidden_sizes=st.lists(st.integers(1, 2**60), min_size=1, max_size=4).map(tuple),
    shared=st.booleans(),
    yaw=finite,
    schedule=st.sampled_from(["constant", "Linear"]),
    name=words,
    colour=st.sampled_from(Colour),
    solver=solvers,
    physics=solvers | names,
    radio=st.none() | solvers,
    span=st.none() | finite | st.tuples(finite, finite),
    corners=st.lists(st.tuples(finite, finite), max_size=3).map(tuple),
    roster=st.dictionaries(names, st.integers(1, 9), max_size=3),
    reach=positive | st.just(math.inf),
    group=st.builds(Group, names, st.integers(-5, 5)),
)


def flat(value: Any, name: str = "") -> dict[str, str]:
    """Settings as one types them: nested ones by dots."""
    if isinstance(value, Run | Solver):
        start = f"{name}." if name else ""
        pairs = [flat(getattr(value, one.name), start + one.name) for one in fields(value)]
        return {key: text for pair in pairs for key, text in pair.items()}
    return {name: to_text(value)}


@settings(max_examples=25, deadline=None)
@given(runs)
def test_round_trips(run):
    assert from_data(Run, to_data(run)) == run
    assert from_data(Run, json.loads(json.dumps(to_data(run), allow_nan=False))) == run
    assert from_data(Run, to_data(run, changed_only=True)) == run
    assert from_text(Run, flat(run)) == run
    assert Run(**{one.name: getattr(run, one.name) for one in fields(Run)}) == run


@settings(max_examples=25, deadline=None)
@given(run=runs)
def test_yaml_round_trips(tmp_path_factory, run):
    path = tmp_path_factory.getbasetemp() / "round_trip.yaml"
    assert from_data(Run, read_file(write(path, to_yaml(run)))) == run


def test_texts_that_look_like_numbers_stay_texts(tmp_path):
    for name in ("1e-3", "on", "null", "1:30", "0x1F", "=", "~", "2020-01-01", "90deg", ".5", "1_000"):
        path = write(tmp_path / "run.yaml", to_yaml(Run(name=name)))
        assert from_data(Run, read_file(path)).name == name


def test_arrays_are_not_written():
    assert "ndarray" in refusal(to_data, {"a": np.zeros(2)})


def test_a_printed_file_explains_itself():
    lines = to_yaml(Run()).splitlines()
    assert lines[:2] == ["# Distance at which a goal counts: a number above 0 [m]", "radius: 0.5"]


# What there is to set.


def test_description_of_a_field():
    found = {one.name: one for one in describe(Run)}
    radius, low, schedule = found["radius"], found["low"], found["schedule"]
    assert list(found) == [one.name for one in fields(Run)]
    assert (radius.expects, radius.default, radius.note.unit) == (NUMBER, 0.5, "m")
    assert radius.note.help == "Distance at which a goal counts [m]. More is told here."
    assert (low.note.help, low.note.unit) == ("Range of the sensor [m].", "m")
    assert found["yaw"].note.help == "Angle about the vertical."
    assert schedule.choices == ("constant", "Linear")
    assert (found["shared"].choices, found["colour"].choices) == (("true", "false"), ("red", "blue"))
    assert found["gamma"].note.aliases == ("discount",)
    assert (found["solver"].nested, found["radio"].nested, found["radius"].nested) == (Solver, Solver, None)
    assert describe(Needed)[0].default is MISSING
    assert describe(Needed)[0].required


@pytest.mark.parametrize(
    ("note", "limits"),
    [
        (Setting(gt=0), " above 0"),
        (Setting(ge=1, le=2), " from 1 to 2"),
        (Setting(gt=1, le=2), " above 1 to 2"),
        (Setting(ge=1, lt=2), " from 1, below 2"),
        (Setting(le=2), " up to 2"),
        (Setting(lt=2), " below 2"),
        (Setting(finite=False), " or inf"),
        (Setting(), ""),
    ],
)
def test_limits_in_words(note, limits):
    assert note.limits == limits


@pytest.mark.parametrize(
    ("limit", "least", "most"), [({"gt": 0.5}, 1, 9), ({"ge": 0.5}, 1, 9), ({"lt": 3.5}, -9, 3)]
)
def test_limits_of_whole_numbers_need_not_be_whole(limit, least, most):
    @dataclass(frozen=True)
    class Whole:
        n: Annotated[int, Setting(**limit)] = 1

    allowed = []
    for n in range(-9, 10):
        try:
            allowed.append(from_data(Whole, {"n": n}).n)
        except SpecError:
            continue
    assert allowed == list(range(least, most + 1))


def test_tables_have_all_settings():
    names = [row[0] for row in rows_of(Run)]
    assert {"radius", "solver.timestep", "radio.kind", "high"} <= set(names)
    assert rows_of(Run, Run(radius=3))[0][2] == "3"
    table = settings_table(Run).splitlines()
    assert len(table) == len(names)
    assert table[0].split()[:2] == ["radius", "0.5"]
    assert "Distance at which a goal counts" in table[0]
    assert "| `radius` | `0.5` | a number above 0 [m] | Distance" in settings_markdown(Run)
    assert ("size", "a number above 0", "required", "") in rows_of(Needed)


def test_schema_agrees_with_the_reader():
    jsonschema = pytest.importorskip("jsonschema")
    check = jsonschema.Draft202012Validator(json_schema(Run)).is_valid
    assert check(json.loads(json.dumps(to_data(Run(radio=Solver(), span=(1, 2))), allow_nan=False)))
    for data in (
        {"radius": 0},
        {"gamma": 2},
        {"num_worlds": 1.5},
        {"shared": 1},
        {"x": 1},
        {"hidden_sizes": []},
    ):
        assert not check(data)
        refusal(from_data, Run, data)
    assert not jsonschema.Draft202012Validator(json_schema(Needed)).is_valid({})


def test_declaring_settings_imports_no_reader():
    code = (
        "import sys; from usarmjx.base.settings import Setting, describe, validate; "
        "print(sorted({'pydantic_core', 'pydantic', 'yaml', 'numpy', 'jax'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_type_for_type_checkers_only_leaves_one_field_unchecked():
    module = types.ModuleType("tests_of_hints")
    code = """
from __future__ import annotations
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated
from usarmjx.base.settings import POSITIVE
if TYPE_CHECKING:
    from elsewhere import Route

@dataclass(frozen=True)
class Patrol:
    route: Route | None = None
    speed: Annotated[float, POSITIVE] = 1.0
"""
    sys.modules["tests_of_hints"] = module
    try:
        exec(code, module.__dict__)
        with pytest.warns(
            UncheckedSettingWarning, match=r"Patrol\.route is not checked: its type 'Route \| None'"
        ):
            route, speed = describe(module.Patrol)
        assert (route.expects, speed.expects) == ("a value of type Route | None", "a number above 0")
        assert from_data(module.Patrol, {"route": [1], "speed": 2}) == module.Patrol([1], 2.0)
        with pytest.raises(SpecError, match="speed is -1, expected a number above 0"):
            from_data(module.Patrol, {"speed": -1})
    finally:
        del sys.modules["tests_of_hints"]
