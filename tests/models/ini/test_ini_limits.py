"""Ini files that would take long to read, or do not end: bounded, and said in one line."""

import time
from pathlib import Path

import pytest

from usarmjx.base.errors import SpecError
from usarmjx.models.ini.items import MAX_BASE_CLASSES
from usarmjx.models.ini.parse import MAX_INI_BYTES, MAX_LINES, parse_ini, read_ini
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS

BRIEFLY = 10.0
"""Seconds of a processor; looking at all lines for each takes minutes."""


def test_many_lines_are_removed_one_by_one():
    count = MAX_LINES // 2 - 10
    lines = [f"Key={i}" for i in range(count)] + [f"-Key={i + 2}" for i in range(count)]
    start = time.process_time()
    left = parse_ini("\n".join(["[A]", *lines])).section("a").lines
    assert time.process_time() - start < BRIEFLY
    assert [line.value for line in left] == [0, 1]


def test_many_sections_are_looked_up_by_name():
    count = MAX_LINES // 2 - 10
    file = parse_ini("\n".join(f"[S{i % (count // 2)}]\nkey={i}" for i in range(count)))
    start = time.process_time()
    found = [file.section(f"s{i}").lines[-1].value for i in range(count // 2)]
    assert time.process_time() - start < BRIEFLY
    assert found == [i + count // 2 for i in range(count // 2)]


def test_a_file_has_so_many_lines_and_bytes(tmp_path):
    with pytest.raises(SpecError, match=rf"<text>:{MAX_LINES + 1}: this is line .* at most {MAX_LINES}"):
        parse_ini("[A]\n" + "a=1\n" * MAX_LINES)
    path = tmp_path / "a.ini"
    path.write_bytes(b"\n" * (MAX_INI_BYTES + 1))
    with pytest.raises(SpecError, match=rf"a\.ini: has more than {MAX_INI_BYTES} bytes, which are too many"):
        read_ini(path)
    with pytest.raises(SpecError, match="has more than"):
        read_ini(Path("/dev/zero"))


def test_a_whole_number_with_more_digits_than_python_reads_is_refused():
    with pytest.raises(SpecError, match="a whole number of 5000 characters; expected at most 400"):
        parse_ini("[A]\na=" + "0" * 4999 + "1")


@pytest.mark.parametrize("own", ["", "ChassisMass=9.0\n"])
def test_classes_that_are_based_on_each_other_without_end_are_refused(own, tmp_path):
    """Robots, and items: the bases come last, so that each round finds one."""
    root = "P2AT" if own else "RangeScanner"
    bases = [root, *(f"C{i}" for i in range(1499))]
    text = "".join(
        f"[USARBot.C{i}]\nBaseClass=class'USARBot.{base}'\n{own}" for i, base in reversed([*enumerate(bases)])
    )
    path = tmp_path / "a.ini"
    path.write_text(text)
    with pytest.raises(SpecError, match=rf"a\.ini:\d+: .* in a row; expected at most {MAX_BASE_CLASSES}"):
        load_robots([path], ROBOTS)


def test_a_robot_has_so_many_parts_and_a_package_so_many_links(tmp_path):
    path, joint = tmp_path / "a.ini", "JointClass=KDHinge,Size=(X=0.1,Y=0.1,Z=0.1)"
    path.write_text(
        "[USARBot.A]\n" + "".join(f"JointParts({i})=(PartName=P{i},{joint})\n" for i in range(501))
    )
    with pytest.raises(SpecError, match=r"a\.ini:502: this is part 501; expected a robot of at most 500"):
        load_robots([path], ROBOTS)
    path.write_text("[USARMisPkg.A]\n" + "".join(f"+Links=(Number={i})\n" for i in range(1, 202)))
    with pytest.raises(SpecError, match=r"a\.ini:202: this is link 201 of a package; expected at most 200"):
        load_robots([path], ROBOTS)


def test_numbers_that_nobody_can_compute_with_are_refused(tmp_path):
    path = tmp_path / "a.ini"
    path.write_text("[USARBot.P2AT]\nWeight=1e300\n")
    with pytest.raises(
        SpecError, match=r"a\.ini:2: Weight is 1e\+300; expected a number above 0, at most 1e\+12"
    ):
        load_robots([path], ROBOTS)


def test_a_robot_that_mujoco_does_not_build_is_one_line(tmp_path):
    path, wheel = tmp_path / "a.ini", "JointClass=KCarWheelJoint,bSteeringLocked=True,Radius=0.1,Width=0.05"
    text = "[USARBot.A]\nDimensions=(X=1e-320,Y=0.4,Z=0.3)\nWeight=20\nChassisMass=1e-300\n"
    for i, y in enumerate((0.2, -0.2)):
        text += f"JointParts({i})=(PartName=W{i},ParentPos=(X=0.1,Y={y},Z=0.1),{wheel})\n"
    path.write_text(text)
    with pytest.raises(SpecError, match=r"a\.ini:2: A cannot be built: Error: ") as caught:
        load_robots([path], ROBOTS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("odd", ["\x1b[2J", "\x1c", "\u2028"])
def test_names_are_printable_as_they_go_into_messages_and_reports(odd, tmp_path):
    path = tmp_path / "a.ini"
    for text in (
        f'(PkgName="C{odd}T",PkgClass=CameraPanTilt)',
        f'(PkgName="C",PkgClass="Camera{odd}PanTilt")',
    ):
        path.write_text(f"[USARBot.P2AT]\nMisPkgs={text}\n", encoding="utf-8")
        with pytest.raises(
            SpecError, match=r"a\.ini:2: Pkg(Name|Class) is 'C.*'; expected a (name|class)"
        ) as caught:
            load_robots([path], ROBOTS)
        assert str(caught.value).isprintable()
    with pytest.raises(SpecError, match="is no section header"):
        parse_ini(f"[USARBot.P{odd[0]}AT]\n")
