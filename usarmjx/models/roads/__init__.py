"""Route networks and missions of the DARPA Urban Challenge (manual 3.2.1.2), for cars.

`network` has the data, their checks, and the conversion of latitudes to metres; `rndf` reads and writes
files, `shapes` makes the paint and kerbs of an arena. Begin with `rndf.read_rndf`. Reading and writing are
inverses: data keep the units of the files (feet, miles per hour), until `shapes`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.models.roads.network import METRES_PER_FOOT as METRES_PER_FOOT
    from usarmjx.models.roads.network import Lane as Lane
    from usarmjx.models.roads.network import Mission as Mission
    from usarmjx.models.roads.network import PointId as PointId
    from usarmjx.models.roads.network import RoadSegment as RoadSegment
    from usarmjx.models.roads.network import RouteNetwork as RouteNetwork
    from usarmjx.models.roads.network import SpeedLimit as SpeedLimit
    from usarmjx.models.roads.network import Spot as Spot
    from usarmjx.models.roads.network import Zone as Zone
    from usarmjx.models.roads.network import to_lat_lon as to_lat_lon
    from usarmjx.models.roads.network import to_local_xy as to_local_xy
    from usarmjx.models.roads.rndf import read_mdf as read_mdf
    from usarmjx.models.roads.rndf import read_rndf as read_rndf
    from usarmjx.models.roads.shapes import road_shapes as road_shapes
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.models.roads.network": (
                "METRES_PER_FOOT",
                "Lane",
                "Mission",
                "PointId",
                "RoadSegment",
                "RouteNetwork",
                "SpeedLimit",
                "Spot",
                "Zone",
                "to_lat_lon",
                "to_local_xy",
            ),
            "usarmjx.models.roads.rndf": ("read_mdf", "read_rndf"),
            "usarmjx.models.roads.shapes": ("road_shapes",),
        },
    )
