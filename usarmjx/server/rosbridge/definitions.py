"""ROS messages as data: fields and types in ROS 1 and ROS 2, times, headers, and services of ROS 2.

Names of services' parts have three components, as `std_srvs/srv/Empty_Request`. A message without fields has
one byte, as ROS 2's own have.
"""

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, TypeAlias, cast

EMPTY: Mapping[str, str] = {"structure_needs_at_least_one_member": "uint8"}
"""Fields of a message without fields."""
RESULT = "simulation_interfaces/Result"
INTERFACES: dict[str, Mapping[str, str]] = {
    "builtin_interfaces/Duration": {"sec": "int32", "nanosec": "uint32"},
    "rmw_dds_common/Gid": {"data": "char[16]"},
    "rmw_dds_common/NodeEntitiesInfo": {
        "node_namespace": "string<=256",
        "node_name": "string<=256",
        "reader_gid_seq": "rmw_dds_common/Gid[]",
        "writer_gid_seq": "rmw_dds_common/Gid[]",
    },
    "rmw_dds_common/ParticipantEntitiesInfo": {
        "gid": "rmw_dds_common/Gid",
        "node_entities_info_seq": "rmw_dds_common/NodeEntitiesInfo[]",
    },
    "service_msgs/ServiceEventInfo": {
        "event_type": "uint8",
        "stamp": "builtin_interfaces/Time",
        "client_gid": "char[16]",
        "sequence_number": "int64",
    },
    "rcl_interfaces/ParameterValue": {
        "type": "uint8",
        "bool_value": "bool",
        "integer_value": "int64",
        "double_value": "float64",
        "string_value": "string",
        "byte_array_value": "byte[]",
        "bool_array_value": "bool[]",
        "integer_array_value": "int64[]",
        "double_array_value": "float64[]",
        "string_array_value": "string[]",
    },
    "rcl_interfaces/Parameter": {"name": "string", "value": "rcl_interfaces/ParameterValue"},
    "rcl_interfaces/FloatingPointRange": {"from_value": "float64", "to_value": "float64", "step": "float64"},
    "rcl_interfaces/IntegerRange": {"from_value": "int64", "to_value": "int64", "step": "uint64"},
    "rcl_interfaces/ParameterDescriptor": {
        "name": "string",
        "type": "uint8",
        "description": "string",
        "additional_constraints": "string",
        "read_only": "bool",
        "dynamic_typing": "bool",
        "floating_point_range": "rcl_interfaces/FloatingPointRange[<=1]",
        "integer_range": "rcl_interfaces/IntegerRange[<=1]",
    },
    "rcl_interfaces/SetParametersResult": {"successful": "bool", "reason": "string"},
    "rcl_interfaces/ListParametersResult": {"names": "string[]", "prefixes": "string[]"},
    "rcl_interfaces/srv/GetParameters_Request": {"names": "string[]"},
    "rcl_interfaces/srv/GetParameters_Response": {"values": "rcl_interfaces/ParameterValue[]"},
    "rcl_interfaces/srv/GetParameterTypes_Request": {"names": "string[]"},
    "rcl_interfaces/srv/GetParameterTypes_Response": {"types": "uint8[]"},
    "rcl_interfaces/srv/SetParameters_Request": {"parameters": "rcl_interfaces/Parameter[]"},
    "rcl_interfaces/srv/SetParameters_Response": {"results": "rcl_interfaces/SetParametersResult[]"},
    "rcl_interfaces/srv/SetParametersAtomically_Request": {"parameters": "rcl_interfaces/Parameter[]"},
    "rcl_interfaces/srv/SetParametersAtomically_Response": {"result": "rcl_interfaces/SetParametersResult"},
    "rcl_interfaces/srv/DescribeParameters_Request": {"names": "string[]"},
    "rcl_interfaces/srv/DescribeParameters_Response": {"descriptors": "rcl_interfaces/ParameterDescriptor[]"},
    "rcl_interfaces/srv/ListParameters_Request": {"prefixes": "string[]", "depth": "uint64"},
    "rcl_interfaces/srv/ListParameters_Response": {"result": "rcl_interfaces/ListParametersResult"},
    "std_srvs/srv/Empty_Request": EMPTY,
    "std_srvs/srv/Empty_Response": EMPTY,
    "simulation_interfaces/Resource": {"uri": "string", "resource_string": "string"},
    RESULT: {"result": "uint8", "error_message": "string"},
    "simulation_interfaces/srv/SpawnEntity_Request": {
        "name": "string",
        "allow_renaming": "bool",
        "entity_resource": "simulation_interfaces/Resource",
        "entity_namespace": "string",
        "initial_pose": "geometry_msgs/PoseStamped",
    },
    "simulation_interfaces/srv/SpawnEntity_Response": {"result": RESULT, "entity_name": "string"},
    "simulation_interfaces/srv/DeleteEntity_Request": {"entity": "string"},
    "simulation_interfaces/srv/DeleteEntity_Response": {"result": RESULT},
    "simulation_interfaces/srv/ResetSimulation_Request": {"scope": "uint8"},
    "simulation_interfaces/srv/ResetSimulation_Response": {"result": RESULT},
}
"""Fields by types' names."""
MessageFields: TypeAlias = Mapping[str, str]
"""Types of a message's fields by their names, in the order of their definition.

`[]` after a type is a list, `[9]` one of that length.
"""
RosMessage: TypeAlias = dict[str, Any]
"""A message: its fields by names; bytes where the type is uint8[], None for a number that is not known."""
TIME, DURATION = "builtin_interfaces/Time", "builtin_interfaces/Duration"
BUILTIN = {TIME: "time", DURATION: "duration"}
"""Types that are primitive in ROS 1, by their names in ROS 2."""
ALSO_TAKEN = {"geometry_msgs/TwistStamped": "geometry_msgs/Twist"}
"""Types that topics of another type listen to, too."""


def json_object(value: object) -> RosMessage | None:
    """Return a value of JSON if it is an object, else None."""
    return cast(RosMessage, value) if isinstance(value, dict) else None


class RosVersion(IntEnum):
    """ROS version, which decides the names of types and the form of times."""

    ROS1 = 1
    ROS2 = 2

    def type_name(self, name: str) -> str:
        """Return the full name of a type such as `nav_msgs/Odometry`; parts of services have theirs."""
        is_short = self == RosVersion.ROS2 and name.count("/") == 1
        return name.replace("/", "/msg/") if is_short else name

    def stamp(self, time: float) -> RosMessage:
        """Return a time [s] in the form of messages."""
        seconds = math.floor(time)
        rest = round((time - seconds) * 1e9)
        if rest >= 1_000_000_000:
            # Rounding may give a full second of nanoseconds, which ROS refuses.
            seconds, rest = seconds + 1, 0
        names = ("sec", "nanosec") if self == RosVersion.ROS2 else ("secs", "nsecs")
        return dict(zip(names, (seconds, rest), strict=True))

    def header(self, time: float, frame: str) -> RosMessage:
        """Return the header of data of a time [s] in a frame."""
        header: RosMessage = {"stamp": self.stamp(time), "frame_id": frame}
        # ROS 1's own publishers overwrite seq; nobody may rely on it.
        return {"seq": 0, **header} if self == RosVersion.ROS1 else header

    def fields(self, name: str) -> MessageFields:
        """Return the fields of a type, by its short name."""
        # The version's own table first: types there have fields of other names, such as CameraInfo's.
        return _ONLY[self].get(name) or SHARED[name]

    def text(self, name: str) -> str:
        """Return the definition of a type with all types that it contains, in the form of bags."""
        listed, waiting, parts = [name], [name], list[str]()
        while waiting:
            # From the front: types are listed in the order in which they are first named.
            one = waiting.pop(0)
            fields = self.fields(one)
            body = "\n".join(f"{self._spelled(kind)} {field}" for field, kind in fields.items())
            head = "" if one == name else f"{'=' * 80}\nMSG: {self.type_name(one)}\n"
            parts.append(head + body)
            for kind in fields.values():
                base = kind.partition("[")[0]
                if "/" in base and base not in listed and base not in BUILTIN:
                    listed.append(base)
                    waiting.append(base)
        return "\n".join(parts) + "\n"

    def _spelled(self, kind: str) -> str:
        return BUILTIN.get(kind, kind) if self == RosVersion.ROS1 else kind


SHARED: dict[str, MessageFields] = {
    "geometry_msgs/Point": {"x": "float64", "y": "float64", "z": "float64"},
    "geometry_msgs/Vector3": {"x": "float64", "y": "float64", "z": "float64"},
    "geometry_msgs/Quaternion": {"x": "float64", "y": "float64", "z": "float64", "w": "float64"},
    "geometry_msgs/Pose": {"position": "geometry_msgs/Point", "orientation": "geometry_msgs/Quaternion"},
    "geometry_msgs/PoseStamped": {"header": "std_msgs/Header", "pose": "geometry_msgs/Pose"},
    "geometry_msgs/PoseWithCovariance": {"pose": "geometry_msgs/Pose", "covariance": "float64[36]"},
    "geometry_msgs/Twist": {"linear": "geometry_msgs/Vector3", "angular": "geometry_msgs/Vector3"},
    "geometry_msgs/TwistStamped": {"header": "std_msgs/Header", "twist": "geometry_msgs/Twist"},
    "geometry_msgs/TwistWithCovariance": {"twist": "geometry_msgs/Twist", "covariance": "float64[36]"},
    "geometry_msgs/Transform": {
        "translation": "geometry_msgs/Vector3",
        "rotation": "geometry_msgs/Quaternion",
    },
    "geometry_msgs/TransformStamped": {
        "header": "std_msgs/Header",
        "child_frame_id": "string",
        "transform": "geometry_msgs/Transform",
    },
    "std_msgs/String": {"data": "string"},
    "tf2_msgs/TFMessage": {"transforms": "geometry_msgs/TransformStamped[]"},
    "tf2_web_republisher/TFArray": {"transforms": "geometry_msgs/TransformStamped[]"},
    "tf2_web_republisher/TFSubscriptionFeedback": {"transforms": "geometry_msgs/TransformStamped[]"},
    "tf2_web_republisher/TFSubscriptionActionFeedback": {
        "header": "std_msgs/Header",
        "status": "actionlib_msgs/GoalStatus",
        "feedback": "tf2_web_republisher/TFSubscriptionFeedback",
    },
    "actionlib_msgs/GoalID": {"stamp": TIME, "id": "string"},
    "actionlib_msgs/GoalStatus": {"goal_id": "actionlib_msgs/GoalID", "status": "uint8", "text": "string"},
    "rosgraph_msgs/Clock": {"clock": TIME},
    "nav_msgs/Odometry": {
        "header": "std_msgs/Header",
        "child_frame_id": "string",
        "pose": "geometry_msgs/PoseWithCovariance",
        "twist": "geometry_msgs/TwistWithCovariance",
    },
    "nav_msgs/MapMetaData": {
        "map_load_time": TIME,
        "resolution": "float32",
        "width": "uint32",
        "height": "uint32",
        "origin": "geometry_msgs/Pose",
    },
    "nav_msgs/OccupancyGrid": {
        "header": "std_msgs/Header",
        "info": "nav_msgs/MapMetaData",
        "data": "int8[]",
    },
    "sensor_msgs/LaserScan": {
        "header": "std_msgs/Header",
        "angle_min": "float32",
        "angle_max": "float32",
        "angle_increment": "float32",
        "time_increment": "float32",
        "scan_time": "float32",
        "range_min": "float32",
        "range_max": "float32",
        "ranges": "float32[]",
        "intensities": "float32[]",
    },
    "sensor_msgs/Imu": {
        "header": "std_msgs/Header",
        "orientation": "geometry_msgs/Quaternion",
        "orientation_covariance": "float64[9]",
        "angular_velocity": "geometry_msgs/Vector3",
        "angular_velocity_covariance": "float64[9]",
        "linear_acceleration": "geometry_msgs/Vector3",
        "linear_acceleration_covariance": "float64[9]",
    },
    "sensor_msgs/CompressedImage": {"header": "std_msgs/Header", "format": "string", "data": "uint8[]"},
    "sensor_msgs/Image": {
        "header": "std_msgs/Header",
        "height": "uint32",
        "width": "uint32",
        "encoding": "string",
        "is_bigendian": "uint8",
        "step": "uint32",
        "data": "uint8[]",
    },
    "sensor_msgs/PointField": {
        "name": "string",
        "offset": "uint32",
        "datatype": "uint8",
        "count": "uint32",
    },
    "sensor_msgs/PointCloud2": {
        "header": "std_msgs/Header",
        "height": "uint32",
        "width": "uint32",
        "fields": "sensor_msgs/PointField[]",
        "is_bigendian": "bool",
        "point_step": "uint32",
        "row_step": "uint32",
        "data": "uint8[]",
        "is_dense": "bool",
    },
    "sensor_msgs/RegionOfInterest": {
        "x_offset": "uint32",
        "y_offset": "uint32",
        "height": "uint32",
        "width": "uint32",
        "do_rectify": "bool",
    },
    "sensor_msgs/JointState": {
        "header": "std_msgs/Header",
        "name": "string[]",
        "position": "float64[]",
        "velocity": "float64[]",
        "effort": "float64[]",
    },
    "sensor_msgs/BatteryState": {
        "header": "std_msgs/Header",
        **dict.fromkeys(("voltage", "temperature", "current", "charge", "capacity"), "float32"),
        **dict.fromkeys(("design_capacity", "percentage"), "float32"),
        **dict.fromkeys(("power_supply_status", "power_supply_health", "power_supply_technology"), "uint8"),
        "present": "bool",
        "cell_voltage": "float32[]",
        "cell_temperature": "float32[]",
        "location": "string",
        "serial_number": "string",
    },
    "trajectory_msgs/JointTrajectory": {
        "header": "std_msgs/Header",
        "joint_names": "string[]",
        "points": "trajectory_msgs/JointTrajectoryPoint[]",
    },
    "trajectory_msgs/JointTrajectoryPoint": {
        "positions": "float64[]",
        "velocities": "float64[]",
        "accelerations": "float64[]",
        "effort": "float64[]",
        "time_from_start": DURATION,
    },
    "sensor_msgs/NavSatStatus": {"status": "int8", "service": "uint16"},
    "sensor_msgs/NavSatFix": {
        "header": "std_msgs/Header",
        "status": "sensor_msgs/NavSatStatus",
        "latitude": "float64",
        "longitude": "float64",
        "altitude": "float64",
        "position_covariance": "float64[9]",
        "position_covariance_type": "uint8",
    },
}
"""Types whose fields have the same names in both versions."""
_RANGE = {
    "header": "std_msgs/Header",
    "radiation_type": "uint8",
    "field_of_view": "float32",
    "min_range": "float32",
    "max_range": "float32",
    "range": "float32",
}
_STAMPED = {"stamp": TIME, "frame_id": "string"}
_LENS = {"d": "float64[]", "k": "float64[9]", "r": "float64[9]", "p": "float64[12]"}


def _camera_info(lens: MessageFields) -> MessageFields:
    """Return the fields of a CameraInfo, with the version's own names of the lens's fields."""
    return {
        "header": "std_msgs/Header",
        "height": "uint32",
        "width": "uint32",
        "distortion_model": "string",
        **lens,
        "binning_x": "uint32",
        "binning_y": "uint32",
        "roi": "sensor_msgs/RegionOfInterest",
    }


_ONLY: dict[RosVersion, dict[str, MessageFields]] = {
    RosVersion.ROS1: {
        "std_msgs/Header": {"seq": "uint32", **_STAMPED},
        "sensor_msgs/Range": _RANGE,
        "sensor_msgs/CameraInfo": _camera_info({name.upper(): kind for name, kind in _LENS.items()}),
        TIME: {"secs": "uint32", "nsecs": "uint32"},
        DURATION: {"secs": "int32", "nsecs": "int32"},
    },
    RosVersion.ROS2: {
        **INTERFACES,
        "std_msgs/Header": _STAMPED,
        "sensor_msgs/Range": {**_RANGE, "variance": "float32"},
        "sensor_msgs/CameraInfo": _camera_info(_LENS),
        TIME: {"sec": "int32", "nanosec": "uint32"},
    },
}
