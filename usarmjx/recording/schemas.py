"""JSON schemas of what other programs read: Foxglove's, by their published names and fields, and ours."""

import json
from typing import Any

Schema = dict[str, Any]

NUMBER: Schema = {"type": "number"}
INTEGER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
FLAG: Schema = {"type": "boolean"}


def _array(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _object(**properties: Schema) -> Schema:
    return {"type": "object", "properties": properties}


SECONDS = _object(sec=INTEGER, nsec=INTEGER)
VECTOR = _object(x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = _object(position=VECTOR, orientation=QUATERNION)
COLOUR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
TRANSFORM = _object(
    timestamp=SECONDS,
    parent_frame_id=TEXT,
    child_frame_id=TEXT,
    translation=VECTOR,
    rotation=QUATERNION,
)
BYTES: Schema = {"type": "string", "contentEncoding": "base64"}
ARROW = _object(
    pose=POSE,
    shaft_length=NUMBER,
    shaft_diameter=NUMBER,
    head_length=NUMBER,
    head_diameter=NUMBER,
    color=COLOUR,
)
LINE = _object(
    type=INTEGER,
    pose=POSE,
    thickness=NUMBER,
    scale_invariant=FLAG,
    points=_array(VECTOR),
    color=COLOUR,
    colors=_array(COLOUR),
    indices=_array(INTEGER),
)
MODEL = _object(
    pose=POSE, scale=VECTOR, color=COLOUR, override_color=FLAG, url=TEXT, media_type=TEXT, data=BYTES
)
ENTITY = _object(
    timestamp=SECONDS,
    frame_id=TEXT,
    id=TEXT,
    lifetime=SECONDS,
    frame_locked=FLAG,
    metadata=_array(_object(key=TEXT, value=TEXT)),
    arrows=_array(ARROW),
    cubes=_array(_object(pose=POSE, size=VECTOR, color=COLOUR)),
    spheres=_array(_object(pose=POSE, size=VECTOR, color=COLOUR)),
    cylinders=_array(_object(pose=POSE, size=VECTOR, bottom_scale=NUMBER, top_scale=NUMBER, color=COLOUR)),
    lines=_array(LINE),
    triangles=_array(
        _object(
            pose=POSE, points=_array(VECTOR), color=COLOUR, colors=_array(COLOUR), indices=_array(INTEGER)
        )
    ),
    texts=_array(
        _object(pose=POSE, billboard=FLAG, font_size=NUMBER, scale_invariant=FLAG, color=COLOUR, text=TEXT)
    ),
    models=_array(MODEL),
)
SCHEMAS: dict[str, Schema] = {
    "foxglove.FrameTransforms": _object(transforms=_array(TRANSFORM)),
    "foxglove.SceneUpdate": _object(
        deletions=_array(_object(timestamp=SECONDS, type=INTEGER, id=TEXT)), entities=_array(ENTITY)
    ),
    "foxglove.LaserScan": _object(
        timestamp=SECONDS,
        frame_id=TEXT,
        pose=POSE,
        start_angle=NUMBER,
        end_angle=NUMBER,
        ranges=_array(NUMBER),
        intensities=_array(NUMBER),
    ),
    "foxglove.PosesInFrame": _object(timestamp=SECONDS, frame_id=TEXT, poses=_array(POSE)),
    "foxglove.Log": _object(
        timestamp=SECONDS, level=INTEGER, message=TEXT, name=TEXT, file=TEXT, line=INTEGER
    ),
    "usarmjx.Lines": _object(peer=TEXT, robot=TEXT, sent=FLAG, text=TEXT),
    "usarmjx.Event": _object(kind=TEXT, robot=TEXT, slot=INTEGER, text=TEXT),
    "usarmjx.Score": _object(score=NUMBER),
}
"""The schemas by name."""


def schema_text(name: str) -> bytes:
    """Return a schema as JSON Schema; of what only we read, nothing."""
    if name not in SCHEMAS:
        return b""
    return json.dumps({"title": name, **SCHEMAS[name]}).encode()
