"""Types of rosbridge's services: the fields of their requests and responses.

Those of rosapi are the .srv files of rosbridge_suite, without the reasons that some answers have there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from usarmjx.server.rosbridge.definitions import DURATION, TIME, MessageFields, RosVersion

TYPE_DEFINITION = "rosapi/TypeDef"
"""Name of rosapi's description of a type."""
TYPE_DEFINITION_FIELDS: MessageFields = {
    "type": "string",
    "fieldnames": "string[]",
    "fieldtypes": "string[]",
    "fieldarraylen": "int32[]",
    "examples": "string[]",
    "constnames": "string[]",
    "constvalues": "string[]",
}
_TYPEDEFS = {"typedefs": f"{TYPE_DEFINITION}[]"}
_NAME, _TOPIC, _SERVICE, _TYPE = ({key: "string"} for key in ("name", "topic", "service", "type"))


@dataclass(frozen=True)
class ServiceType:
    """Type of a service.

    Attributes:
        name: Its name, in ROS 1's form.
        request: Fields of a request.
        response: Fields of a response.
    """

    name: str
    request: MessageFields = field(default_factory=dict[str, str])
    response: MessageFields = field(default_factory=dict[str, str])

    def full_name(self, version: RosVersion) -> str:
        """Return the name in a version of ROS; those of other packages than rosapi are the same in both."""
        package, _, name = self.name.partition("/")
        is_later = package == "rosapi" and version == RosVersion.ROS2
        return f"rosapi_msgs/srv/{name}" if is_later else self.name


def _of_rosapi(
    name: str, request: MessageFields | None = None, response: MessageFields | None = None
) -> ServiceType:
    return ServiceType(f"rosapi/{name}", request or {}, response or {})


SERVICE_TYPES: Mapping[str, ServiceType] = {
    "/rosapi/topics": _of_rosapi("Topics", None, {"topics": "string[]", "types": "string[]"}),
    "/rosapi/topics_and_raw_types": _of_rosapi(
        "TopicsAndRawTypes",
        None,
        {"topics": "string[]", "types": "string[]", "typedefs_full_text": "string[]"},
    ),
    "/rosapi/topics_for_type": _of_rosapi("TopicsForType", _TYPE, {"topics": "string[]"}),
    "/rosapi/topic_type": _of_rosapi("TopicType", _TOPIC, _TYPE),
    "/rosapi/publishers": _of_rosapi("Publishers", _TOPIC, {"publishers": "string[]"}),
    "/rosapi/subscribers": _of_rosapi("Subscribers", _TOPIC, {"subscribers": "string[]"}),
    "/rosapi/message_details": _of_rosapi("MessageDetails", _TYPE, _TYPEDEFS),
    "/rosapi/service_request_details": _of_rosapi("ServiceRequestDetails", _TYPE, _TYPEDEFS),
    "/rosapi/service_response_details": _of_rosapi("ServiceResponseDetails", _TYPE, _TYPEDEFS),
    "/rosapi/action_servers": _of_rosapi("GetActionServers", None, {"action_servers": "string[]"}),
    "/rosapi/get_time": _of_rosapi("GetTime", None, {"time": TIME}),
    "/rosapi/nodes": _of_rosapi("Nodes", None, {"nodes": "string[]"}),
    "/rosapi/node_details": _of_rosapi(
        "NodeDetails",
        {"node": "string"},
        {"subscribing": "string[]", "publishing": "string[]", "services": "string[]"},
    ),
    "/rosapi/services": _of_rosapi("Services", None, {"services": "string[]"}),
    "/rosapi/service_type": _of_rosapi("ServiceType", _SERVICE, _TYPE),
    "/rosapi/service_node": _of_rosapi("ServiceNode", _SERVICE, {"node": "string"}),
    "/rosapi/service_providers": _of_rosapi("ServiceProviders", _SERVICE, {"providers": "string[]"}),
    "/rosapi/services_for_type": _of_rosapi("ServicesForType", _TYPE, {"services": "string[]"}),
    "/rosapi/get_param": _of_rosapi(
        "GetParam", {"name": "string", "default_value": "string"}, {"value": "string", "successful": "bool"}
    ),
    "/rosapi/set_param": _of_rosapi(
        "SetParam", {"name": "string", "value": "string"}, {"successful": "bool"}
    ),
    "/rosapi/has_param": _of_rosapi("HasParam", _NAME, {"exists": "bool"}),
    "/rosapi/delete_param": _of_rosapi("DeleteParam", _NAME, {"successful": "bool"}),
    "/rosapi/search_param": _of_rosapi("SearchParam", _NAME, {"global_name": "string"}),
    "/rosapi/get_param_names": _of_rosapi("GetParamNames", None, {"names": "string[]"}),
    "/simulator/spawn": ServiceType(
        "usarmjx_msgs/Spawn",
        {"class": "string", "name": "string", "pose": "geometry_msgs/Pose", "start": "string"},
        _NAME,
    ),
    "/simulator/remove": ServiceType("usarmjx_msgs/Remove", _NAME),
    "/republish_tfs": ServiceType(
        "tf2_web_republisher/RepublishTFs",
        {
            "source_frames": "string[]",
            "target_frame": "string",
            "angular_thres": "float32",
            "trans_thres": "float32",
            "rate": "float32",
            "timeout": DURATION,
        },
        {"topic_name": "string"},
    ),
}
"""Types by the names of services."""


def short_name(name: str) -> str:
    """Return the name of a type of a message or service in ROS 1's form, of either version's."""
    return name.replace("/msg/", "/").replace("/srv/", "/").replace("rosapi_msgs/", "rosapi/")


def find_service_type(name: str) -> ServiceType | None:
    """Return the type of a name in either version's form; None if no service has it."""
    return next((one for one in SERVICE_TYPES.values() if one.name == short_name(name)), None)
