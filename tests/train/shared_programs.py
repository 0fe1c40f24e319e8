"""Programs of toys that the runs of a process share, so that each is traced and compiled once."""

from usarmjx.base.program_cache import fingerprint

_programs = {}
_values = {}


class SharedPrograms:
    """As `ProgramCache`, in memory: a trainer takes what an earlier one of equal ingredients has traced.

    Args:
        ingredients: See `open_program_cache`.
    """

    def __init__(self, *ingredients):
        self._digest = fingerprint(*ingredients)
        self._names = set()

    def of(self, *ingredients):
        return SharedPrograms(self._digest, ingredients)

    def keep(self, name, compiled):
        if name in self._names:  # may be another function
            return compiled
        self._names.add(name)
        return _programs.setdefault((self._digest, name), compiled)

    def value(self, name, make):
        known = self._digest, name
        if known not in _values:
            _values[known] = make()
        return _values[known]
