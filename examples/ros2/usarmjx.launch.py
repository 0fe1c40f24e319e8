"""Start the relay and RViz: `ros2 launch usarmjx.launch.py robot:=P2AT name:=R1`.

Not run: there was no ROS 2 where it was written.
"""
# pyright: reportMissingImports=false

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

HERE = Path(__file__).parent
ARGUMENTS = {"url": "ws://127.0.0.1:9090", "robot": "P2AT", "name": "R1"}


def generate_launch_description() -> LaunchDescription:
    """Return what is started."""
    given = [word for key in ARGUMENTS for word in ("-p", [f"{key}:=", LaunchConfiguration(key)])]
    relay = ExecuteProcess(cmd=["python3", str(HERE / "usarmjx_relay.py"), "--ros-args", *given])
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", str(HERE / "usarmjx.rviz")],
        parameters=[{"use_sim_time": True}],
    )
    declared = [DeclareLaunchArgument(key, default_value=value) for key, value in ARGUMENTS.items()]
    return LaunchDescription([*declared, relay, rviz])
