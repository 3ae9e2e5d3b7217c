"""Reads down-sampled clouds as any client of a cell would: ``python our_sink.py ENDPOINT NAMESPACE CAMERA``."""

from __future__ import annotations

import sys

from latencies import Latencies

from zsight.client import connect
from zsight.convert import points_of
from zsight_protocol.point_cloud import PointCloud2


def main(endpoint: str, namespace: str, camera: str) -> None:
    latencies = Latencies()
    with connect(endpoint, namespace=namespace) as cell:
        for cloud in cell.bus.reader(cell.bus.cell.voxel_points(camera), PointCloud2):
            points_of(cloud)
            latencies.add(cloud.header.stamp.ns)


if __name__ == "__main__":
    main(*sys.argv[1:4])
