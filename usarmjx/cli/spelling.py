"""Options as they were once spelt: they still work, are in no help, and each tells its present spelling."""

from collections.abc import Callable, Mapping, Sequence

RENAMED: Mapping[str, Mapping[str, str]] = {
    "serve": {"--viewer": "--view", "--no-viewer": "--no-view"},
    "radio-map": {"--ini": "--radio-ini"},
    "chaos": {"--page-port": "--spectator-port"},
}
"""By commands: old options and what they are called now."""
COUNTED: Mapping[str, tuple[str, str]] = {
    "bench rays": ("P2AT", "16"),
    "bench camera": ("P2AT", "1"),
    "bench viewer": ("P2AT", ""),
    "bench radio": ("P2AT", "16"),
    "bench serve": ("P2AT", ""),
}
"""Commands with a roster that once had `--robots` and `--robot`, and what these were if not given."""
ROBOTS = ("--robots", "--robot")
OTHER_ROBOT = {"bench serve"}
"""Commands of these in which `--robot` is something else, and stays."""


def respelt(words: Sequence[str], tell: Callable[[str], None]) -> list[str]:
    """Return a command line with all options as they are spelt now.

    Args:
        words: What was typed after `usarmjx`.
        tell: Takes a line for each old spelling.
    """
    path = " ".join(words[:2]) if " ".join(words[:2]) in COUNTED else "".join(words[:1])
    names, done = RENAMED.get(path, {}), list[str]()
    for word in words:
        option, equals, value = word.partition("=")
        new = names.get(option)
        if new is not None:
            tell(f"{option} is called {new} now")
        done.append(word if new is None else f"{new}{equals}{value}")
    if path not in COUNTED:
        return done
    return _with_roster(done, *COUNTED[path], tell, ("--robots",) if path in OTHER_ROBOT else ROBOTS)


def _with_roster(
    words: Sequence[str], kind: str, count: str, tell: Callable[[str], None], old: Sequence[str]
) -> list[str]:
    """Return a command line with `--roster CLASS:COUNT` for `--robots COUNT` and `--robot CLASS`."""
    rest, counts, kinds = list[str](), list[str](), list[str]()
    given = iter(words)
    for word in given:
        option, equals, value = word.partition("=")
        if option in old:
            (counts if option == "--robots" else kinds).append(value if equals else next(given, ""))
        else:
            rest.append(word)
    if not (counts or kinds):
        return rest
    rosters = [f"{(kinds or [kind])[-1]}:{number}".rstrip(":") for number in counts or [count]]
    told = f"{old[0]} is" if len(old) == 1 else f"{' and '.join(old)} are"
    tell(f"{told} --roster now: --roster {' --roster '.join(rosters)}")
    return [*rest, *(word for roster in rosters for word in ("--roster", roster))]
