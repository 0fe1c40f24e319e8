"""What the numbers of a sensor's value are, for whoever puts them into words and turns them into his axes."""

from collections.abc import Sequence
from dataclasses import dataclass

from usarmjx.base.errors import SpecError

FORMS = {"number": 1, "count": 1, "flag": 1, "yaw": 1, "vector": 3, "angles": 3}
"""Kinds of quantities, and of how many numbers each is. `count` is a whole number, `flag` is 1 or 0, `yaw` an
angle about the vertical to the left [rad], `vector` has x, y, z, and `angles` are roll, pitch, yaw [rad]."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """Numbers of a sensor's value that are one thing.

    Attributes:
        key: What it is called in messages, one word.
        form: Which of `FORMS` it is.
    """

    key: str
    form: str = "number"

    def __post_init__(self) -> None:
        """Refuse what no message can carry.

        Raises:
            SpecError: A form that there is not, or a key that is not one word.
        """
        if self.form not in FORMS:
            raise SpecError(f"{self.key} is a {self.form!r}, expected one of {', '.join(FORMS)}")
        if not self.key.isalnum():
            raise SpecError(f"the key of a quantity is {self.key!r}, expected one word")

    @property
    def size(self) -> int:
        """How many numbers it is."""
        return FORMS[self.form]


def total_size(quantities: Sequence[Quantity]) -> int:
    """Return of how many numbers some quantities are."""
    return sum(quantity.size for quantity in quantities)
