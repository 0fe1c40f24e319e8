"""Which worlds of a batch are served, as the command line names them."""

import pytest

from usarmjx.base.errors import UsageError
from usarmjx.server.worlds.instances import parse_instances


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("all", (0, 1, 2, 3, 4, 5, 6, 7)),
        (" ALL ", (0, 1, 2, 3, 4, 5, 6, 7)),
        ("3", (3,)),
        ("0,2-5", (0, 2, 3, 4, 5)),
        ("5 - 7, 0, 6", (0, 5, 6, 7)),
        ("7-7", (7,)),
    ],
)
def test_numbers_and_ranges(text, numbers):
    assert parse_instances(text, 8) == numbers


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "instances '' are not of the form all or 0,2-5: ''"),
        ("0,", "not of the form"),
        ("5-2", "not of the form all or 0,2-5: '5-2'"),
        ("-1", "not of the form"),
        ("1-", "not of the form"),
        ("1-2-3", "not of the form"),
        ("some", "not of the form"),
        ("8", "instance 8 is not among worlds 0 to 7"),
        ("2-99999999999999", "instance 99999999999999 is not among worlds 0 to 7"),
    ],
)
def test_anything_else_is_refused(text, says):
    with pytest.raises(UsageError, match=says):
        parse_instances(text, 8)
