"""`typings/mujoco` is true: what it names exists, and what we use is named there."""

import ast
from importlib import import_module
from pathlib import Path

import mujoco
import pytest

ROOT = Path(__file__).parents[2]
STUB = ast.parse((ROOT / "typings/mujoco/__init__.pyi").read_text())
CLASSES = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}
NAMES = {node.name for node in STUB.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
NAMES |= {node.target.id for node in STUB.body if isinstance(node, ast.AnnAssign)}
OF_INSTANCES = {"_Enum", "_View", "_JointView", "_NumericView", "_Vector", "_MjContact"}
"""What has another name in MuJoCo, or one for each kind of element; an instance has it."""
SCENE = """
<mujoco>
  <custom><numeric name="n" data="1"/></custom>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="b"><joint name="j"/><geom name="g" size="1"/></body>
  </worldbody>
</mujoco>
"""


def members(node):
    """Yield the names in a class body."""
    for item in node.body:
        if isinstance(item, ast.FunctionDef):
            yield item.name
        elif isinstance(item, ast.AnnAssign):
            yield item.target.id
        elif isinstance(item, ast.Assign):
            yield item.targets[0].id


def used():
    """Return every `mujoco.<name>` of the package, and the enumerators behind a name."""
    found = set()
    for path in (ROOT / "usarmjx").rglob("*.py"):
        text = path.read_text()
        if "mujoco." not in text:  # parsing is what takes time
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                if node.value.id == "mujoco":
                    found.add((node.attr,))
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute):
                owner = node.value
                if isinstance(owner.value, ast.Name) and owner.value.id == "mujoco":
                    found.add((owner.attr, node.attr))
    return sorted(found - {("mjx",)})


@pytest.mark.parametrize("name", sorted(NAMES - OF_INSTANCES))
def test_what_the_stub_names_exists(name):
    real = getattr(mujoco, name, None) or getattr(import_module("mujoco._structs"), name)
    if name in CLASSES:
        assert [member for member in members(CLASSES[name]) if not hasattr(real, member)] == []


def test_what_the_stub_says_of_views_and_contacts_exists():
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    instances = {
        "_View": model.geom("g"),
        "_JointView": model.joint("j"),
        "_NumericView": model.numeric("n"),
        "_MjContact": data.contact[0],
        "_Enum": mujoco.mjtGeom.mjGEOM_BOX,
    }
    for name, instance in instances.items():
        assert [member for member in members(CLASSES[name]) if not hasattr(instance, member)] == [], name


def in_stub(name, *of_it):
    """Return whether the stub has a name, and an enumerator or a member of it."""
    if name not in NAMES:
        return False
    inherited = {"__members__"} if name.startswith("mjt") else set()
    return name not in CLASSES or set(of_it) <= set(members(CLASSES[name])) | inherited


def test_what_we_use_is_in_the_stub():
    paths = used()
    assert ("MjSpec",) in paths
    assert [".".join(path) for path in paths if not in_stub(*path)] == []


@pytest.mark.parametrize(
    "path", [("MjSpoc",), ("MjSpec", "compole"), ("mjtGeom", "mjGEOM_BALL")], ids=".".join
)
def test_what_the_stub_lacks_is_noticed(path):
    assert not in_stub(*path)
