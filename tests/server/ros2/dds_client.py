"""A program beside the server: a participant of its own in the domain, without any code of usarmjx.

Types are Cyclone's own classes, serialised by Cyclone; for the test in `test_processes`. It prints one JSON
object about what it has found.
"""

import json
import sys
import time
from dataclasses import dataclass, field

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl import types as idl
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface address='127.0.0.1' multicast='true'/>"
    "</Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>99</MaxAutoParticipantIndex></Discovery></Domain></CycloneDDS>"
)
PATIENCE = 60.0  # s


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: idl.int32 = 0
    nanosec: idl.uint32 = 0


@dataclass
class Clock(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
    clock: Time = field(default_factory=Time)


@dataclass
class Text(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str = ""


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: idl.float64 = 0.0
    y: idl.float64 = 0.0
    z: idl.float64 = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: idl.float64 = 0.0
    y: idl.float64 = 0.0
    z: idl.float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: idl.float64 = 0.0
    y: idl.float64 = 0.0
    z: idl.float64 = 0.0
    w: idl.float64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: idl.array[idl.float64, 36]


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: idl.array[idl.float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Resource(IdlStruct, typename="simulation_interfaces::msg::dds_::Resource_"):
    uri: str = ""
    resource_string: str = ""


@dataclass
class Result(IdlStruct, typename="simulation_interfaces::msg::dds_::Result_"):
    result: idl.uint8 = 0
    error_message: str = ""


@dataclass
class SpawnRequest(IdlStruct, typename="simulation_interfaces::srv::dds_::SpawnEntity_Request_"):
    guid: idl.uint64
    seq: idl.int64
    name: str
    allow_renaming: bool
    entity_resource: Resource
    entity_namespace: str = ""
    initial_pose: PoseStamped = field(default_factory=PoseStamped)


@dataclass
class SpawnResponse(IdlStruct, typename="simulation_interfaces::srv::dds_::SpawnEntity_Response_"):
    guid: idl.uint64
    seq: idl.int64
    result: Result
    entity_name: str


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: idl.array[idl.uint8, 16]


@dataclass
class NodeEntities(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: idl.bounded_str[256]
    node_name: idl.bounded_str[256]
    reader_gid_seq: idl.sequence[Gid]
    writer_gid_seq: idl.sequence[Gid]


@dataclass
class ParticipantEntities(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: idl.sequence[NodeEntities]


RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
LATCHED = Qos(Policy.Durability.TransientLocal, base=RELIABLE)


def within_patience(look):
    """Return the first true result of `look`."""
    until = time.monotonic() + PATIENCE
    while not (found := look()):
        assert time.monotonic() < until, "nothing comes"
        time.sleep(0.01)
    return found


def main(domain):
    _ = Domain(domain, LOOPBACK)
    participant = DomainParticipant(domain)

    def reader(topic, kind, qos=RELIABLE):
        return DataReader(participant, Topic(participant, topic, kind), qos=qos)

    def writer(topic, kind):
        made = DataWriter(participant, Topic(participant, topic, kind), qos=RELIABLE)
        within_patience(lambda: made.get_publication_matched_status().current_count)
        return made

    replies = reader("rr/spawn_entityReply", SpawnResponse)
    requests = writer("rq/spawn_entityRequest", SpawnRequest)
    within_patience(lambda: replies.get_subscription_matched_status().current_count)
    requests.write(SpawnRequest(77, 5, "R1", False, Resource("P2AT")))
    reply = within_patience(lambda: replies.take(1))[0]
    clocks, texts = reader("rt/clock", Clock), reader("rt/R1/robot_description", Text, LATCHED)
    clock = within_patience(lambda: clocks.take(1))[0]
    urdf = within_patience(lambda: texts.take(1))[0]
    odom = reader("rt/R1/odom", Odometry)
    first = within_patience(lambda: odom.take(1))[0]
    driver = writer("rt/R1/cmd_vel", TwistStamped)
    driver.write(TwistStamped(twist=Twist(linear=Vector3(x=0.3))))

    def moved():
        for one in odom.take(64):
            if one.twist.twist.linear.x > 0.1:
                return one
        return None

    last = within_patience(moved)
    graph = reader("ros_discovery_info", ParticipantEntities, LATCHED)
    nodes = within_patience(lambda: [one for one in graph.take(8) if one.node_entities_info_seq])
    publications = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    found = {
        one.topic_name: (one.type_name, bytes(one.qos[Policy.Userdata].data).decode())
        for one in publications.take(512)
        if Policy.Userdata in one.qos
    }
    print(
        json.dumps(
            {
                "reply": [reply.guid, reply.seq, reply.result.result, reply.entity_name],
                "clock": clock.clock.sec + clock.clock.nanosec * 1e-9,
                "urdf": urdf.data[:60],
                "odom": [first.header.frame_id, first.child_frame_id, last.twist.twist.linear.x],
                "nodes": [node.node_name for one in nodes for node in one.node_entities_info_seq],
                "writers": sum(len(n.writer_gid_seq) for one in nodes for n in one.node_entities_info_seq),
                "published": found,
            }
        )
    )


if __name__ == "__main__":
    main(int(sys.argv[1]))
