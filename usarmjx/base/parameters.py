"""Form of the parameters of an operation of a sensor or an effecter: how many numbers, and their limits."""

from dataclasses import dataclass

from usarmjx.base.settings import Setting

_NO_LIMITS = Setting()


@dataclass(frozen=True, slots=True)
class Parameters:
    """Form of the parameters of an operation.

    Attributes:
        fewest: Fewest numbers.
        most: Most numbers.
        note: Their limits and unit.
    """

    fewest: int = 0
    most: int = 1
    note: Setting = _NO_LIMITS

    @property
    def expects(self) -> str:
        """The form in words."""
        if self.most == 1:
            return f"{'a' if self.fewest else 'at most one'} number{self.note.limits_and_unit}"
        counts = str(self.most) if self.fewest == self.most else f"{self.fewest} to {self.most}"
        return f"{counts} numbers{self.note.limits_and_unit}"


ANY_PARAMETERS = Parameters(0, 64)
"""Form of an operation that declares none."""
