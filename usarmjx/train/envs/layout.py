"""Layout of observations and actions of robots that choose: which numbers belong to which choice.

This module imports neither JAX nor anything that needs it, as files of policies are read by it.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np


class Span(NamedTuple):
    """Numbers of an observation that lie side by side.

    Attributes:
        first: Index of the first one.
        rows: Things that they describe.
        numbers: Numbers of each thing.
    """

    first: int
    rows: int
    numbers: int

    @property
    def end(self) -> int:
        """Index behind the last one."""
        return self.first + self.rows * self.numbers


class Picture(NamedTuple):
    """Size of a picture of maps.

    Attributes:
        levels: Scales.
        width: Points along a side of each.
        channels: Numbers of a point.
    """

    levels: int = 0
    width: int = 0
    channels: int = 0

    @property
    def size(self) -> int:
        """All its numbers."""
        return self.levels * self.width * self.width * self.channels


class ActionVector(NamedTuple):
    """Numbers of an action behind those of its choices.

    Attributes:
        size: Count of the numbers; 0: there are none.
        choices: Number of the last choices, with which alone they count.
    """

    size: int = 0
    choices: int = 0


NO_PICTURE, NO_VECTOR = Picture(), ActionVector()
LARGEST = 10**6
"""Largest number in a layout of a file."""


@dataclass(frozen=True)
class ObservationLayout:
    """Parts of an observation, in their order; the mask of valid choices follows them.

    Attributes:
        own: Count of numbers about the robot itself.
        others: Number of other robots, and numbers of each; the first of these is 1 if there is one, else 0.
        choices: Number of choices, and numbers of each.
        kinds: Kind of each choice, from 0: choices of a kind are alike.
        picture: Levels, width and channels of a picture of maps (levels, width, width, channels); zeros:
            there is none.
    """

    own: int
    others: tuple[int, int]
    choices: tuple[int, int]
    kinds: tuple[int, ...]
    picture: tuple[int, int, int] = NO_PICTURE

    @property
    def picture_size(self) -> Picture:
        """Size of the picture."""
        return Picture(*self.picture)

    @property
    def own_span(self) -> Span:
        """Place of the robot's own numbers."""
        return Span(0, 1, self.own)

    @property
    def others_span(self) -> Span:
        """Place of the others."""
        return Span(self.own_span.end, *self.others)

    @property
    def choices_span(self) -> Span:
        """Place of the choices."""
        return Span(self.others_span.end, *self.choices)

    @property
    def picture_span(self) -> Span:
        """Place of the picture."""
        return Span(self.choices_span.end, 1, self.picture_size.size)

    @property
    def mask_span(self) -> Span:
        """Place of the mask of valid choices."""
        # Last: distributions read the mask from the end of an observation.
        return Span(self.picture_span.end, self.choices[0], 1)

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        return self.mask_span.end

    @property
    def tokens(self) -> int:
        """Number of tokens of a network over sets: the robot, the others and the choices."""
        return 1 + self.others[0] + self.choices[0]

    @property
    def sets(self) -> tuple[Span, Span]:
        """Spans of things that are alike."""
        return self.others_span, self.choices_span

    @property
    def as_they_are(self) -> np.ndarray:
        """Which numbers are neither shifted nor scaled: marks of presence, picture and mask (size,)."""
        found = np.zeros(self.size, bool)
        # One slice for picture and mask, which are the last spans.
        found[self.picture_span.first :] = True
        # A slice cannot step by 0, as it would in a task without others.
        found[self.others_span.first : self.others_span.end : max(self.others[1], 1)] = True
        return found

    def misfit(self, obs_size: int, choices: int) -> str:
        """Return the conflict with the sizes of observations and choices, in words; empty: there is none."""
        if self.size != obs_size or self.choices[0] != choices or len(self.kinds) != choices:
            return (
                f"the layout has {self.size} numbers and {self.choices[0]} choices, kinds of "
                f"{len(self.kinds)}; the observation has {obs_size} and {choices}"
            )
        return ""


ROWS = {"others": 2, "choices": 2, "kinds": 0, "picture": 3}
"""Lists in the record of a layout, and their lengths; 0: any length from 1."""


def layout_record(layout: ObservationLayout) -> dict[str, Any]:
    """Return a layout as a file holds it, in JSON."""
    rows = {name: [*getattr(layout, name)] for name in ROWS}
    return {"own": layout.own, **rows}


def layout_from_record(held: Any) -> ObservationLayout:  # noqa: ANN401 - whatever a file has
    """Return the layout of a record in a file.

    Raises:
        ValueError: It has none, or one with other numbers than whole ones from 0.
    """
    # Exactly these parts: one that is not known here would be dropped silently.
    if not isinstance(held, dict) or cast(dict[str, Any], held).keys() != {"own", *ROWS}:
        raise ValueError(f"its layout has other parts than own, {', '.join(ROWS)}")
    parts = cast(dict[str, Any], held)
    rows = {name: _whole_numbers(f"{name} of its layout", parts[name], count) for name, count in ROWS.items()}
    (own,) = _whole_numbers("own of its layout", [parts["own"]], 1)
    others, choices, picture = (rows[name] for name in ("others", "choices", "picture"))
    return ObservationLayout(
        own=own,
        others=(others[0], others[1]),
        choices=(choices[0], choices[1]),
        kinds=rows["kinds"],
        picture=(picture[0], picture[1], picture[2]),
    )


def vector_from_record(held: Any, action_size: int) -> ActionVector:  # noqa: ANN401 - whatever a file has
    """Return the vector of a record in a file, for actions of a size.

    Raises:
        ValueError: It is no pair of whole numbers from 1, or leaves too few choices.
    """
    size, choices = _whole_numbers("vector of its group", held, 2)
    if not size or not choices or size + choices > action_size:
        raise ValueError(f"vector of its group is {[size, choices]}, in actions of {action_size} numbers")
    return ActionVector(size, choices)


def _whole_numbers(name: str, value: Any, count: int) -> tuple[int, ...]:  # noqa: ANN401 - whatever a file has
    """Return the whole numbers of a list of `count` numbers; 0: any length from 1."""
    # Cut, as a file may hold a value of any length.
    text, rows = str(value)[:40], cast(list[Any], value) if isinstance(value, list) else []
    # A bool is an int in Python: `true` must not pass for 1.
    whole = all(isinstance(one, int) and not isinstance(one, bool) and 0 <= one <= LARGEST for one in rows)
    if not rows or not whole or (count and len(rows) != count):
        raise ValueError(f"{name} is {text}")
    return tuple(rows)
