"""Settings from texts, data and instances: one reader, on top of pydantic's core.

pydantic-core checks types and limits, walks through lists and mappings and knows where it is. This module
says which schema stands for which type hint, reads texts by the grammar of `text`, and words the refusals.
"""

import math
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import is_dataclass
from difflib import get_close_matches
from enum import Enum
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, cast, get_args, get_origin, get_type_hints

from pydantic_core import InitErrorDetails, PydanticCustomError, SchemaValidator, ValidationError
from pydantic_core.core_schema import (
    CoreSchema,
    bool_schema,
    dict_schema,
    float_schema,
    int_schema,
    list_schema,
    no_info_before_validator_function,
    no_info_plain_validator_function,
    no_info_wrap_validator_function,
    str_schema,
    tuple_schema,
    typed_dict_field,
    typed_dict_schema,
)

from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.base.settings.declaration import (
    LARGEST,
    MAPPINGS,
    SEQUENCES,
    SMALLEST,
    RenamedSettingWarning,
    Setting,
    SettingField,
    bare,
    choices_of,
    describe,
    expectation,
    is_named_tuple,
    is_record,
    members_of,
    note_of,
    single_precision,
)
from usarmjx.base.settings.files import FileValue, shown
from usarmjx.base.settings.text import (
    LARGEST_WHOLE,
    Text,
    is_none,
    nested_texts,
    parse_list,
    parse_mapping,
    parse_number,
    parse_truth,
)

T = TypeVar("T")
Special = Mapping[Any, Callable[[Any], Any]]
"""Functions that read types given in another way, as meshes by the name of a file; they take a `FileValue`
where there is a file, else what was given."""
Rules = Mapping[type, Callable[[Any], str]]
"""Functions that say what is wrong with an instance; an empty text: nothing."""


class _Onto(NamedTuple):
    """Settings of an instance that a mapping changes only some of."""

    base: object
    given: object


class _Record(NamedTuple):
    """All that reading a dataclass takes: its fields, the names that they go by, and its validator."""

    fields: dict[str, SettingField]
    names: dict[str, str]
    old_names: dict[str, str]
    validator: SchemaValidator


def _plain(value: object) -> object:
    """Return a value without its place, and numbers of NumPy as numbers."""
    if isinstance(value, FileValue):
        return value.data
    kind = type(value)
    if kind.__module__ == "numpy" and getattr(value, "shape", None) == () and hasattr(value, "dtype"):
        return cast(Any, value).item()
    return value


def _onto(old: object, given: object) -> object:
    """Return a value, or the old dataclass with the settings that a mapping gives."""
    return _Onto(old, given) if is_dataclass(old) and isinstance(_plain(given), Mapping) else given


def _refusal(value: object, problem: str, kind: str = "value") -> PydanticCustomError:
    """Return the refusal of a value; pydantic-core adds the names that lead to it."""
    place = getattr(value, "place", "") if isinstance(value, FileValue | Text) else ""
    return PydanticCustomError("setting", "{problem}", {"problem": problem, "place": place, "kind": kind})


def _unexpected(value: object, expects: str) -> PydanticCustomError:
    return _refusal(value, f"is {shown(_plain(value))}, expected {expects}")


def _with_names(error: ValidationError, names: Mapping[str | None, str]) -> ValidationError:
    """Return an error whose values go by other names."""
    # Only the first one: later errors often follow from it.
    lines: list[InitErrorDetails] = [
        {
            "type": PydanticCustomError(
                "setting", "{problem}", one.get("ctx", {"problem": f": {one['msg']}"})
            ),
            "loc": tuple(names.get(str(name), name) if i == 0 else name for i, name in enumerate(one["loc"])),
            "input": None,  # the problem has it in words
        }
        for one in error.errors(include_url=False, include_input=False)[:1]
    ]
    return ValidationError.from_exception_data(error.title, lines)


class Reader:
    """Reads and checks settings; the module-level functions of the package use one without options.

    Args:
        special: Readers of some types.
        rules: Conditions between the fields of some dataclasses, beside their own `problem` method.
        refusal: Class of the errors; unknown names raise `UnknownNameError` if it is `SpecError`.
        spelling: Conversion of a key to a field's name, as `MaxRange` -> `max_range`; with it, the manual's
            keys are accepted too.
        single_precision: Whether to refuse numbers that are not normal in single precision, in which devices
            compute; False where they are compiled in double precision.
    """

    def __init__(
        self,
        *,
        special: Special | None = None,
        rules: Rules | None = None,
        refusal: type[UsageError] = SpecError,
        spelling: Callable[[str], str] | None = None,
        single_precision: bool = True,
    ) -> None:
        self._special, self._rules = dict(special or {}), dict(rules or {})
        self._refusal, self._spelling, self._single = refusal, spelling, single_precision
        self._unknown = UnknownNameError if refusal is SpecError else refusal
        self._records: dict[type, _Record] = {}
        self._validators: dict[Any, SchemaValidator] = {}

    def from_data(
        self,
        kind: type[T],
        data: object,
        *,
        where: str = "",
        base: T | None = None,
        defaults: Mapping[str, object] | None = None,
    ) -> T:
        """Return a dataclass from data of YAML, JSON, TOML or Python.

        Args:
            kind: The dataclass.
            data: A mapping by names of fields, or a `FileValue` of one.
            where: Its source, for refusals; a `FileValue` knows its own.
            base: Instance whose settings hold where the data has none, in nested settings too.
            defaults: Settings that hold where neither has any.

        Raises:
            UsageError: An unknown or missing name, or a value that is not allowed; names source, field,
                value and what is allowed.
        """
        with self._refusals(data, where):
            return cast(T, self._read(kind, data, base, defaults or {}))

    def convert(self, hint: Any, data: object, *, where: str = "") -> Any:  # noqa: ANN401 - a type hint
        """Return data as a value of any type hint, notes and all.

        Args:
            hint: The type hint.
            data: See `from_data`; a `Text` is read by the grammar of texts.
            where: Its source, for refusals.

        Raises:
            UsageError: See `from_data`.
        """
        if hint not in self._validators:
            # A validator is compiled once for a type: that takes longer than a reading.
            self._validators[hint] = SchemaValidator(self._schema(hint, Setting()))
        with self._refusals(data, where):
            return self._validators[hint].validate_python(data)

    def from_text(
        self, kind: type[T], texts: Mapping[str, str], *, where: str = "", base: T | None = None
    ) -> T:
        """Return a dataclass from texts by name; names of nested settings have dots, as `physics.timestep`.

        Args:
            kind: The dataclass.
            texts: The texts; `Text` may know a place of its own.
            where: Their source, for refusals.
            base: Instance whose settings hold where there is no text.

        Raises:
            UsageError: See `from_data`.
        """
        return self.from_data(kind, nested_texts(texts, where), where=where, base=base)

    def values(self, kind: type, data: object, *, where: str = "", base: object = None) -> dict[str, Any]:
        """Return checked values by field, of the fields that the data has.

        Args:
            kind: The dataclass.
            data: See `from_data`.
            where: Its source, for refusals.
            base: Instance whose nested settings hold where the data sets only some of them.

        Raises:
            UsageError: See `from_data`; a missing name is none.
        """
        with self._refusals(data, where):
            given = self._named(kind, data)
            for name, item in given.items():
                given[name] = _onto(getattr(base, name, None), item)
            return self._checked(kind, data, given)

    def text_values(
        self, kind: type, texts: Mapping[str, str], *, where: str = "", base: object = None
    ) -> dict[str, Any]:
        """Return checked values by field, of the fields that there are texts of; see `from_text`."""
        return self.values(kind, nested_texts(texts, where), where=where, base=base)

    def validate(self, instance: object) -> None:
        """Check an instance that was built in Python, from its `__post_init__`.

        Numbers become those of the fields' types: 1 a float, a list a tuple, NumPy's numbers Python's.

        Raises:
            UsageError: A value that is not allowed.
        """
        kind = type(instance)
        record = self._record(kind)
        # By fields, not by `vars`: instances may have slots.
        given = {name: getattr(instance, name) for name in record.fields}
        with self._refusals(given, kind.__name__):
            values = record.validator.validate_python(given)
        for name, value in values.items():
            if value is not given[name]:
                object.__setattr__(instance, name, value)  # the dataclass is frozen
        if problem := self._problem(instance):
            raise self._refusal(f"{kind.__name__}: {problem}")

    def current_names(self, kind: type, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return data by the names that fields have now; names of older versions are renamed silently."""
        old = self._record(kind).old_names
        return {old.get(name, name): value for name, value in data.items()}

    def names(self, kind: type) -> dict[str, str]:
        """Return the fields of a dataclass by all names that are accepted for them."""
        record = self._record(kind)
        return {**record.names, **record.old_names}

    # Reading of dataclasses.

    def _record(self, kind: type) -> _Record:
        if kind not in self._records:
            fields = {one.name: one for one in describe(kind)}
            names = {name: name for name in fields}
            if self._spelling is not None:
                names |= {
                    self._spelling(one.note.manual_key): one.name
                    for one in fields.values()
                    if one.note.manual_key
                }
            old = {alias: one.name for one in fields.values() for alias in one.note.aliases}
            if clash := sorted(set(old) & set(names)):
                raise UsageError(f"{kind.__name__}: alias {clash[0]!r} is the name of a setting")
            schema = {
                one.name: typed_dict_field(self._schema(one.hint, one.note), required=False)
                for one in fields.values()
            }
            self._records[kind] = _Record(fields, names, old, SchemaValidator(typed_dict_schema(schema)))
        return self._records[kind]

    def _read(self, kind: type, data: object, base: object, defaults: Mapping[str, object]) -> object:
        # Built in Python, and checked by its own `__post_init__`.
        if isinstance(data, kind):
            return data
        record = self._record(kind)
        given = self._named(kind, data)
        for name, field in record.fields.items():
            if base is not None:
                old = getattr(base, name)
                given[name] = _onto(old, given[name]) if name in given else old
            elif name not in given and name in defaults:
                given[name] = defaults[name]
            elif name not in given and field.required:
                raise _refusal(data, f"has no {name!r}, expected {field.expects}")
        values = self._checked(kind, data, given)
        try:
            made = kind(**values)
            problem = self._problem(made)
        except UsageError as error:
            raise _refusal(data, f": {error}") from error
        if problem:
            raise _refusal(data, f": {problem}")
        return made

    def _checked(self, kind: type, data: object, given: dict[str, Any]) -> dict[str, Any]:
        """Return the checked values of fields; refusals have the names that the data has for them."""
        try:
            return self._record(kind).validator.validate_python(given)
        except ValidationError as error:
            plain, names = _plain(data), self._name_of
            spelt = {names(kind, key): key for key in cast(Mapping[str, Any], plain)}
            # The reader's own names mean nothing to the author of a file in the manual's spelling.
            raise _with_names(error, spelt) from None

    def _name_of(self, kind: type, key: object) -> str | None:
        """Return the field of a name or a key of the manual; None: there is none, now at least."""
        names = self._record(kind).names
        return names.get(cast(str, key)) or names.get(self._spelt(key))

    def _spelt(self, key: object) -> str:
        """Return a key in the spelling of fields."""
        return self._spelling(key) if self._spelling is not None and isinstance(key, str) else str(key)

    def _problem(self, instance: object) -> str:
        own = getattr(instance, "problem", None)
        problem = str(own()) if callable(own) else ""
        rule = self._rules.get(type(instance))
        return problem or (rule(instance) if rule is not None else "")

    def _named(self, kind: type, data: object) -> dict[str, Any]:
        """Return what a mapping holds by the names of fields.

        Raises:
            PydanticCustomError: It is no mapping, or a name is unknown or there twice.
        """
        record, plain = self._record(kind), _plain(data)
        if not isinstance(plain, Mapping):
            raise _unexpected(data, f"settings of {kind.__name__}")
        found: dict[str, Any] = {}
        for key, item in cast(Mapping[object, object], plain).items():
            name = self._name_of(kind, key)
            if name is None and key in record.old_names:
                name = record.old_names[cast(str, key)]
                place = getattr(item, "place", "") if isinstance(item, FileValue | Text) else ""
                start = f"{place}: " if place else ""
                text = f"{start}{key} of {kind.__name__} is called {name} now; the old name goes next version"
                warnings.warn(text, RenamedSettingWarning, stacklevel=2)
            if name is None:
                raise _refusal(item, _unknown(str(key), self._spelt(key), kind, record), "name")
            if name in found:
                raise _refusal(item, f": {name} is given twice, as {shown(key)} too")
            found[name] = item
        return found

    # Refusals.

    @contextmanager
    def _refusals(self, data: object, where: str) -> Generator[None]:
        """Turn refusals of data, of pydantic-core's kinds, into ours."""
        start = data.name if isinstance(data, FileValue) else ""
        try:
            yield
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            context = first.get("ctx", {"problem": f": {first['msg']}"})
            raise self._error_of(context, first["loc"], where, start) from None
        except PydanticCustomError as error:
            raise self._error_of(error.context or {}, (), where, start) from error.__cause__

    def _error_of(
        self, context: Mapping[str, Any], names: Sequence[int | str], where: str, start: str
    ) -> UsageError:
        kind = self._unknown if context.get("kind") == "name" else self._refusal
        place, problem = context.get("place") or where, str(context["problem"])
        name = start + "".join(f"[{n}]" if isinstance(n, int) else f".{n}" for n in names)
        name = name.lstrip(".")
        text = name + problem if problem.startswith(": ") else f"{name} {problem}"
        return kind(f"{place}: {text.strip(': ')}" if place else text.strip(": "))

    # Schemas of type hints.

    def _schema(self, hint: Any, note: Setting) -> CoreSchema:  # noqa: ANN401 - a type hint
        hint, note = bare(hint), note_of(hint, note)
        expects, origin = expectation(hint, note), get_origin(hint) or hint
        if members := members_of(hint):
            return self._union(members, note, expects)
        if hint in _SCALARS and not (hint is str and note.choices):
            return _scalar(hint, note, expects, single=self._single)
        if hint not in self._special:
            if origin in SEQUENCES:
                return self._sequence(hint, note, expects)
            if origin in MAPPINGS:
                return self._mapping(hint, note, expects)
            if is_named_tuple(hint):
                return self._named_tuple(hint, note, expects)
        return no_info_plain_validator_function(self._function(hint, note, expects))

    def _function(self, hint: Any, note: Setting, expects: str) -> Callable[[Any], Any]:  # noqa: ANN401
        """Return the function that reads a type which pydantic-core has no schema of."""
        origin = get_origin(hint) or hint
        if hint in self._special:
            return self._special_reader(hint)
        if origin is Literal or choices_of(hint, note) or hint is str:
            return _choice_reader(hint, note)
        if hint is Path:
            return _path_reader(expects)
        if is_record(hint):
            return self._record_reader(hint)
        if not isinstance(origin, type) or origin is Any:  # Any is a class since Python 3.11
            return _deep_plain
        return _instance_reader(cast("type[Any]", origin), expects)

    def _special_reader(self, hint: Any) -> Callable[[Any], Any]:  # noqa: ANN401 - a type hint
        action = self._special[hint]

        def read(value: object) -> object:
            return value if isinstance(hint, type) and isinstance(value, hint) else action(value)

        return read

    def _record_reader(self, kind: type) -> Callable[[Any], Any]:
        # The validator of the inner class is made at its first use: classes may hold each other.
        def read(value: object) -> object:
            if isinstance(value, _Onto):
                return self._read(type(value.base), value.given, value.base, {})
            return self._read(kind, value, None, {})

        return read

    def _union(self, members: Sequence[Any], note: Setting, expects: str) -> CoreSchema:
        """Return the schema of a union: of what can be meant by a value's form, the first that takes it."""
        # Texts go last: every word is one.
        ordered = sorted(members, key=lambda one: _rank(bare(one)))
        branches = [(bare(one), SchemaValidator(self._schema(one, note))) for one in ordered]

        def read(value: object) -> object:
            fitting = [row for row in branches if row[0] in self._special or _may_be(row[0], value)]
            keys = _plain(value)
            if len(fitting) > 1 and isinstance(keys, Mapping) and all(is_record(one) for one, _ in fitting):
                # The class that knows the most of the keys is meant; its refusal names the others.
                fitting = [
                    max(fitting, key=lambda row: len(self.names(row[0]).keys() & cast(Any, keys).keys()))
                ]
            # None fits all scalars, and its refusal does not name the other members.
            if len(fitting) == 1 and fitting[0][0] is not type(None) and not isinstance(value, Text):
                return fitting[0][1].validate_python(value)
            for _, validator in fitting:
                try:
                    return validator.validate_python(value)
                except ValidationError:
                    continue
            raise _unexpected(value, expects)

        return no_info_plain_validator_function(read)

    def _sequence(self, hint: Any, note: Setting, expects: str) -> CoreSchema:  # noqa: ANN401 - a type hint
        inner, origin = get_args(hint), get_origin(hint) or hint
        fixed = origin is tuple and inner and inner[-1] is not Ellipsis
        # A tuple of a fixed form has as many items as its type names.
        least, most = (len(inner), len(inner)) if fixed else (note.min_length, note.max_length)

        def read(value: object) -> list[Any]:
            found = _plain(value)
            if isinstance(found, Text):
                texts = parse_list(found)
                found = None if texts is None else [Text(text, found.place) for text in texts]
            if not isinstance(found, list | tuple):
                raise _unexpected(value, expects)
            items = list(cast(Sequence[Any], found))
            if len(items) < (least or 0) or (most is not None and len(items) > most):
                raise _unexpected(value, expects)
            return items

        item = self._schema(inner[0] if inner else Any, note.of_items)
        if fixed:
            schema = tuple_schema([self._schema(one, note.of_items) for one in inner])
        else:
            schema = tuple_schema([item], variadic_item_index=0) if origin in _TUPLES else list_schema(item)
        return no_info_before_validator_function(read, schema)

    def _mapping(self, hint: Any, note: Setting, expects: str) -> CoreSchema:  # noqa: ANN401 - a type hint
        inner = get_args(hint) or (str, Any)

        def read(value: object) -> dict[Any, Any]:
            found = _plain(value)
            if isinstance(found, Text):
                texts = parse_mapping(found)
                found = texts and {key: Text(text, found.place) for key, text in texts.items()}
            if not isinstance(found, Mapping):
                raise _unexpected(value, expects)
            pairs = cast(Mapping[Any, Any], found)
            if len(pairs) < (note.min_length or 0) or len(pairs) > (note.max_length or len(pairs)):
                raise _unexpected(value, expects)
            # A key of a file is a text, whatever the type.
            return {Text(key) if isinstance(key, str) else key: item for key, item in pairs.items()}

        schema = dict_schema(self._schema(inner[0], Setting()), self._schema(inner[1], note.of_items))
        return no_info_before_validator_function(read, schema)

    def _named_tuple(self, hint: Any, note: Setting, expects: str) -> CoreSchema:  # noqa: ANN401 - a class
        kinds = list(get_type_hints(hint, include_extras=True).values())
        inner = self._sequence(tuple[tuple(kinds)], note, expects)

        def gather(value: object, validate: Callable[[object], tuple[Any, ...]]) -> object:
            return value if isinstance(value, hint) else hint(*validate(value))

        return no_info_wrap_validator_function(gather, inner)


_SCALARS = (float, int, bool, str)
_TUPLES = (tuple, Sequence)
_RANKS = (type(None), int, float, bool)


def _rank(hint: Any) -> int:  # noqa: ANN401 - a type hint
    return _RANKS.index(hint) if hint in _RANKS else 9 if hint is str else 5


def _may_be(hint: object, value: object) -> bool:
    """Return whether a value has the form of a type of a union."""
    if isinstance(value, _Onto):
        return is_record(hint) and isinstance(value.base, cast(type, hint))
    plain, origin = _plain(value), get_origin(hint) or hint
    if isinstance(plain, Text):
        return True
    if isinstance(plain, Mapping):
        return is_record(hint) or origin in MAPPINGS
    if isinstance(plain, list | tuple):
        return origin in SEQUENCES or (isinstance(hint, type) and issubclass(hint, tuple))
    return origin not in MAPPINGS and (origin not in SEQUENCES or isinstance(plain, str))


class _PrecisionError(ValueError):
    """A number that single precision does not hold."""


PRECISION = f"numbers that are not 0 have magnitudes from {SMALLEST:.2g} to {LARGEST:.2g}"
"""Limits of single precision, in which the devices compute."""


def _scalar(hint: type, note: Setting, expects: str, *, single: bool) -> CoreSchema:
    """Return the schema of a number, a truth value or a text; all refusals are worded alike."""
    limits = {"gt": note.gt, "ge": note.ge, "lt": note.lt, "le": note.le}
    if hint is float:
        numbers: dict[str, Any] = limits
        prepare, schema = _number_reader(note, single=single), float_schema(strict=True, **numbers)
    elif hint is int:
        wholes: dict[str, Any] = _whole_limits(limits)
        prepare, schema = _whole_reader(note), int_schema(strict=True, **wholes)
    elif hint is bool:
        prepare, schema = _truth, bool_schema(strict=True)
    else:
        counts: dict[str, Any] = {"min_length": note.min_length, "max_length": note.max_length}
        prepare, schema = _word, str_schema(strict=True, **counts)

    def read(value: object, validate: Callable[[object], object]) -> object:
        try:
            return validate(prepare(_plain(value)))
        except ValidationError:
            plain = _plain(value)
            endless = note.finite and isinstance(plain, float) and math.isinf(plain)
            raise _unexpected(value, f"{expects}, finite" if endless else expects) from None
        except _PrecisionError:
            raise _unexpected(value, f"{expects}; {PRECISION}") from None

    return no_info_wrap_validator_function(read, schema)


def _whole_limits(limits: Mapping[str, float | None]) -> dict[str, int | None]:
    """Return limits as pydantic-core takes them of whole numbers, which are whole themselves."""
    ceil = ("ge", "lt")
    return {
        name: None if one is None else math.ceil(one) if name in ceil else math.floor(one)
        for name, one in limits.items()
    }


def _number_reader(note: Setting, *, single: bool) -> Callable[[object], object]:
    def read(value: object) -> object:
        if isinstance(value, str):
            value = parse_number(value, note.unit, unit_needed=not isinstance(value, Text))
        if isinstance(value, int) and not isinstance(value, bool):
            # `float` refuses integers beyond its range: from here on they count as infinite.
            value = float(value) if abs(value) < LARGEST_WHOLE**2 else math.inf if value > 0 else -math.inf
        if isinstance(value, float):
            if math.isnan(value) or (note.finite and math.isinf(value)):
                return None  # no schema of a number takes it
            if single and not single_precision(value):
                raise _PrecisionError
            return float(value)  # not one of a class derived from float, as NumPy's
        return value

    return read


def _whole_reader(note: Setting) -> Callable[[object], object]:
    def read(value: object) -> object:
        if isinstance(value, str):
            value = parse_number(value, note.unit, unit_needed=not isinstance(value, Text))
        if isinstance(value, float) and value.is_integer() and abs(value) <= LARGEST_WHOLE:
            return int(value)
        return value

    return read


def _truth(value: object) -> object:
    return parse_truth(value) if isinstance(value, Text) else value


def _word(value: object) -> object:
    return str(value) if isinstance(value, Text) else value


def _choice_reader(hint: Any, note: Setting) -> Callable[[object], object]:  # noqa: ANN401 - a type hint
    """Return the reader of a value of a list: a literal, an enumeration, None, or a word of some."""

    def read(value: object) -> object:
        plain, expects = _plain(value), expectation(hint, note)
        known = _known(hint, note)
        for one in known.values():
            # By type, too: True equals 1.
            if type(plain) is type(one) and plain == one:
                return one
        if isinstance(plain, str):
            if hint is type(None) and isinstance(plain, Text) and is_none(plain):
                return None
            for word, one in known.items():
                # A literal number is one of the text door only.
                if word.lower() == plain.strip().lower() and (isinstance(one, str | Enum) or _is_text(plain)):
                    return one
            near = get_close_matches(plain.lower(), [word.lower() for word in known], n=1)
            hint_text = next((f"; did you mean {word!r}?" for word in known if [word.lower()] == near), "")
            raise _unexpected(value, expects + hint_text)
        raise _unexpected(value, expects)

    return read


def _is_text(value: str) -> bool:
    return isinstance(value, Text)


def _known(hint: Any, note: Setting) -> dict[str, Any]:  # noqa: ANN401 - a type hint
    """Return the values that one may choose from, by the words for them."""
    if get_origin(hint) is Literal:
        return {str(one): one for one in get_args(hint)}
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {**{one.name: one for one in hint}, **{str(one.value): one for one in hint}}
    return {"none": None} if hint is type(None) else {word: word for word in note.words}


def _path_reader(expects: str) -> Callable[[object], Path]:
    def read(value: object) -> Path:
        plain = _plain(value)
        if isinstance(plain, Path):
            return plain
        if not isinstance(plain, str) or not plain or "\0" in plain:
            raise _unexpected(value, expects)
        # A path in a file starts from the file's folder.
        return value.path.parent / plain if isinstance(value, FileValue) else Path(plain)

    return read


def _instance_reader(kind: type, expects: str) -> Callable[[object], object]:
    def read(value: object) -> object:
        if isinstance(value, kind):
            return value
        raise _unexpected(value, expects)

    return read


def _deep_plain(value: object) -> object:
    """Return data of a file without its places."""
    plain = _plain(value)
    if isinstance(value, FileValue) and isinstance(plain, dict):
        return {key: _deep_plain(item) for key, item in cast(dict[str, object], plain).items()}
    if isinstance(value, FileValue) and isinstance(plain, list):
        return [_deep_plain(item) for item in cast(list[object], plain)]
    return str(plain) if isinstance(plain, Text) else plain


def _unknown(key: str, spelt: str, kind: type, record: _Record) -> str:
    near = get_close_matches(spelt, [*record.names, *record.old_names], n=1)
    meant = f"did you mean {near[0]!r}? It" if near else "it"
    return f": {kind.__name__} has no setting {shown(key)}; {meant} has: {', '.join(record.fields)}"


DEFAULT = Reader()
"""The reader of the package's functions."""
