"""What Foxglove reads of a recording is as its schemas say: fields of foxglove-schemas-protobuf 0.4.0."""

import json

import pytest
from mcap.reader import make_reader

from usarmjx.recording.file import CHANNELS
from usarmjx.recording.foxglove import DELETE_ALL, INFO, SCHEMAS

FIELDS = """
Color: r number, g number, b number, a number
Vector3: x number, y number, z number
Quaternion: x number, y number, z number, w number
Pose: position Vector3, orientation Quaternion
Time: sec integer, nsec integer
KeyValuePair: key string, value string
FrameTransform: timestamp Time, parent_frame_id string, child_frame_id string, translation Vector3, rotation Quaternion
FrameTransforms: transforms FrameTransform[]
LaserScan: timestamp Time, frame_id string, pose Pose, start_angle number, end_angle number, ranges number[], intensities number[]
Log: timestamp Time, level integer, message string, name string, file string, line integer
PosesInFrame: timestamp Time, frame_id string, poses Pose[]
ArrowPrimitive: pose Pose, shaft_length number, shaft_diameter number, head_length number, head_diameter number, color Color
CubePrimitive: pose Pose, size Vector3, color Color
SpherePrimitive: pose Pose, size Vector3, color Color
CylinderPrimitive: pose Pose, size Vector3, bottom_scale number, top_scale number, color Color
LinePrimitive: type integer, pose Pose, thickness number, scale_invariant boolean, points Vector3[], color Color, colors Color[], indices integer[]
TriangleListPrimitive: pose Pose, points Vector3[], color Color, colors Color[], indices integer[]
TextPrimitive: pose Pose, billboard boolean, font_size number, scale_invariant boolean, color Color, text string
ModelPrimitive: pose Pose, scale Vector3, color Color, override_color boolean, url string, media_type string, data string
SceneEntityDeletion: timestamp Time, type integer, id string
SceneEntity: timestamp Time, frame_id string, id string, lifetime Time, frame_locked boolean, metadata KeyValuePair[], arrows ArrowPrimitive[], cubes CubePrimitive[], spheres SpherePrimitive[], cylinders CylinderPrimitive[], lines LinePrimitive[], triangles TriangleListPrimitive[], texts TextPrimitive[], models ModelPrimitive[]
SceneUpdate: deletions SceneEntityDeletion[], entities SceneEntity[]
"""  # noqa: E501 - a table
KINDS = {
    name: dict(field.split() for field in fields.split(", "))
    for name, fields in (line.split(": ") for line in FIELDS.strip().splitlines())
}
PLAIN = {"number": (int, float), "integer": int, "string": str, "boolean": bool}


def expected(kind):
    """The JSON schema of a kind of value, without what a schema may say beside types."""
    if kind.endswith("[]"):
        return {"type": "array", "items": expected(kind[:-2])}
    if kind in PLAIN:
        return {"type": kind}
    properties = {name: expected(its) for name, its in KINDS[kind].items()}
    return {"type": "object", "properties": properties}


def types_of(schema):
    """A JSON schema without what it says beside types."""
    kept = {key: value for key, value in schema.items() if key in ("type", "items", "properties")}
    if "items" in kept:
        kept["items"] = types_of(kept["items"])
    if "properties" in kept:
        kept["properties"] = {name: types_of(one) for name, one in kept["properties"].items()}
    return kept


def check(kind, value, where):
    """Hold a value against its kind: exactly these fields, of these types."""
    if kind.endswith("[]"):
        assert isinstance(value, list), where
        for one in value:
            check(kind[:-2], one, where)
    elif kind in PLAIN:
        assert isinstance(value, PLAIN[kind]), (where, value)
        assert isinstance(value, bool) == (kind == "boolean"), (where, value)
    else:
        assert value.keys() == KINDS[kind].keys(), where
        for name, its in KINDS[kind].items():
            check(its, value[name], f"{where}.{name}")


@pytest.mark.parametrize("name", sorted(name for name in CHANNELS.values() if name.startswith("foxglove.")))
def test_the_schemas_in_our_files_are_foxgloves(name):
    assert types_of(SCHEMAS[name]) == expected(name.removeprefix("foxglove."))


def test_every_message_of_a_mission_is_as_its_schema_says(mission):
    seen = set()
    with mission[0].open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if schema.name.startswith("foxglove."):
                assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                check(schema.name.removeprefix("foxglove."), json.loads(message.data), schema.name)
                seen.add(schema.name)
    assert seen == {name for name in CHANNELS.values() if name.startswith("foxglove.")}


def test_numbers_that_stand_for_words_are_foxgloves():
    assert (INFO, DELETE_ALL) == (
        2,
        1,
    )  # Log.Level: unknown, debug, info; SceneEntityDeletion.Type: matching, all
