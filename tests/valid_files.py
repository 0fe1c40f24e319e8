"""A small valid file of each kind that is loaded, to be changed by those who look for what breaks."""

import io
import struct

import numpy as np
from PIL import Image

ARENA = b"""name: DM-Room
floor: -1.0e-1
extent: [[-3, 3], [-2, 2]]
gps: [49.9, 8.6]
starts: [{tag: Door, at: [-1.5, 0, 0.188], yaw: 90deg}]
shapes:
- &a {kind: box, surface: wall, size: [2, 0.05, 0.6], at: [0, -1.5, 0.6]}
- {<<: *a, at: [0, 1.5, 0.6], rgba: [1, 0, 0, 1]}
- {kind: hfield, size: [1, 1, 0.1], heights: [[0, 1], [1, 0]]}
- {kind: mesh, mesh: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}
loose: [{name: brick, at: [0, 0, 0], shapes: [{kind: box, size: [0.1, 0.1, 0.1]}],
  inertia: {mass: 2.5, at: [0, 0, -0.05], moments: [0.1, 0.2, 0.25, 0, 0, 0.01]}}]
doors: [{name: gate, at: [1, 0, 0], limits: [-1.5, 1.5]}]
victims: [{name: Eve, at: [0, 0, 0.11], posture: lying, segments: [{name: Head, final: [0, 0, 1]}]}]
tags: [{at: [1, 1, 0], id: 17}]
"""
MODEL = b"""<mujoco><asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>
<hfield name="h" nrow="3" ncol="2" size="1 1 1 1"/>
<texture name="t" type="2d" builtin="flat" width="9" height="9"/>
</asset><default><default class="c"><geom rgba="1 0 0 1"/></default></default><worldbody>
<geom type="plane" size="5 5 .1"/><geom type="box" pos="0 2 .5" size="3 .05 .5"/>
<geom type="hfield" hfield="h"/>
<replicate count="3" offset="1 0 0"><geom type="mesh" mesh="m" class="c"/></replicate>
<body name="crate" pos="1.5 -1 .2"><freejoint/><geom type="cylinder" size=".2 .2" density="120"/></body>
<body name="gate" pos="-2 -1 .5"><joint type="hinge" axis="0 0 1" range="-90 90" damping="1.5"/>
<geom type="box" pos="0 -.5 0" size=".02 .5 .4" mass="6"/></body></worldbody></mujoco>"""
GAZEBO = b"""<sdf version='1.7'><world name='w'><include><uri>model://ground_plane</uri></include>
<frame name='f'><pose degrees='true'>1 2 0 0 0 90</pose></frame>
<light type='point' name='p'><pose>0 0 2 0 0 0</pose><diffuse>1 .5 0 1</diffuse></light>
<model name='a'><static>true</static><pose relative_to='f'>0 0 .5 0 0 0</pose><link name='l'>
<collision name='c'><geometry><box><size>1 2 1</size></box></geometry></collision>
<visual name='v'><material><diffuse>1 0 0 1</diffuse></material></visual></link></model>
<model name='b'><link name='l'><inertial><mass>2</mass></inertial><collision name='c'><geometry><polyline>
<point>0 0</point><point>1 0</point><point>.2 .2</point><point>0 1</point><height>1</height></polyline>
</geometry></collision></link><link name='k'><collision name='c'><geometry><cylinder><radius>.1</radius>
<length>1</length></cylinder></geometry></collision></link><joint name='j' type='revolute'><parent>l</parent>
<child>k</child><axis><xyz>0 0 1</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis></joint></model>
<state world_name='w'><model name='b'><pose>3 3 0 0 0 0</pose></model></state></world></sdf>"""
STAGE = b"""define wall model ( color "gray30" size [1 0.1 2] ) # a comment
window ( size [600 400] )
unit_angle "degrees"
wall ( name "a" pose [1 2 0 90] boundary 1 )
wall ( block ( points 4 point[0] [0 0] point[1] [2 0] point[2] [0.2 0.2] point[3] [0 1] z [0 1] ) )
position ( name "r0" pose [-2 -1 0 45] ranger ( size [1 1 1] ) )
"""
GRID = b"type octile\nheight 3\nwidth 4\nmap\n@@T@\n@.SW\n@@G@\n"
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]], "<f4")
FACETS = TETRAHEDRON[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]
TEXT_STL = b"solid a\n"
for facet in FACETS:
    TEXT_STL += b"facet normal 0 0 0\nouter loop\n"
    TEXT_STL += b"".join(b"vertex %g %g %g\n" % tuple(corner) for corner in facet.tolist())
    TEXT_STL += b"endloop\nendfacet\n"
TEXT_STL += b"endsolid a\n"
BINARY_STL = bytes(80) + struct.pack("<I", 4)
BINARY_STL += b"".join(bytes(12) + facet.tobytes() + bytes(2) for facet in FACETS)
INI = b"""[USARBot.P2AT]
bDebug=False
Weight=14.0
batteryLife=1200
Sensors=(ItemClass=class'USARBot.SonarSensor',ItemName="F1",Position=(X=0.2,Y=-0.1,Z=0.1),Direction=(Y=0.0,Z=1.5))
-Sensors=(ItemClass=class'USARBot.SonarSensor')
AddSensors=(ItemClass=class'USARBot.MyScanner',ItemName="S")
MisPkgs=(PkgName="CameraPanTilt",Location=(X=0.1,Y=0,Z=-0.3),PkgClass=Class'USARMisPkg.CameraPanTilt')
[USARBot.MyScanner]
BaseClass=class'USARBot.RangeScanner'
MaxRange=9.0 ; metres
[USARBot.Cart]
Dimensions=(X=0.5,Y=0.4,Z=0.3)
Weight=20.0
ChassisMass=9.0
JointParts=(PartName="W1",JointClass=class'KCarWheelJoint',bSteeringLocked=True,ParentPos=(X=0.1,Y=0.2,Z=0.1),ParentAxis2=(Y=1.0),Radius=0.1,Width=0.05)
JointParts=(PartName="W2",JointClass=class'KCarWheelJoint',bSteeringLocked=True,ParentPos=(X=0.1,Y=-0.2,Z=0.1),ParentAxis2=(Y=1.0),Radius=0.1,Width=0.05)
"""
ROADS = b"""RNDF_name two
num_segments 1
num_zones 1
format_version 1.0 /* as of
today */
segment 1
num_lanes 1
segment_name Main
lane 1.1
num_waypoints 2
lane_width 12
left_boundary double_yellow
checkpoint 1.1.2 1
stop 1.1.2
exit 1.1.2 2.0.1
1.1.1 34.1 -117.1
1.1.2 34.2 -117.2
end_lane
end_segment
zone 2
num_spots 1
perimeter 2.0
num_perimeterpoints 1
exit 2.0.1 1.1.1
2.0.1 34.1 -117.2
end_perimeter
spot 2.1
spot_width 10
checkpoint 2.1.2 2
2.1.1 34.1 -117.3
2.1.2 34.1 -117.4
end_spot
end_zone
end_file
"""
MISSION = b"""MDF_name m
RNDF two
checkpoints
num_checkpoints 2
1
2
end_checkpoints
speed_limits
num_speed_limits 1
1 10 25.5
end_speed_limits
end_file
"""
MAP = b"image: fuzzed.png\nresolution: 0.5\norigin: [-3.0, -2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n"


def picture(kind):
    """A small image as a file."""
    out = io.BytesIO()
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(6, 8) * 5).save(out, kind)
    return out.getvalue()
