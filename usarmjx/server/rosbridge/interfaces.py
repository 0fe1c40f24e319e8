"""Types that only ROS 2 has: services, their requests and responses, parameters, and its nodes' discovery.

Names of services' parts have three components, as `std_srvs/srv/Empty_Request`. A message without fields has
one byte, as ROS 2's own have.
"""

from collections.abc import Mapping

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
