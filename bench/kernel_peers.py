"""The kernels' work done by Open3D and small_gicp, one thread, on arrays that are theirs already."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import small_gicp

from zsight_core import open3d_module
from zsight_core.filters import remove_nan
from zsight_core.points import xyz

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight_core.points import Points


def peers(points: Points) -> dict[str, list[tuple[str, Callable[[], object]]]]:
    """For the name of a task, who else does it, and how."""
    o3d = open3d_module.load()
    dense = xyz(remove_nan(points)).reshape(-1, 3).astype(np.float64)
    cloud, full = o3d.geometry.PointCloud(), o3d.geometry.PointCloud()
    cloud.points = o3d.utility.Vector3dVector(dense)
    cloud.colors = o3d.utility.Vector3dVector(np.full_like(dense, 0.5))
    full.points = o3d.utility.Vector3dVector(xyz(points).reshape(-1, 3).astype(np.float64))
    full.colors = o3d.utility.Vector3dVector(np.full((points.size, 3), 0.5))
    theirs = small_gicp.PointCloud(dense)
    radius = o3d.geometry.KDTreeSearchParamRadius(0.01)
    found: dict[str, list[tuple[str, Callable[[], Any]]]] = {
        "voxel grid 0.02": [
            ("Open3D", lambda: cloud.voxel_down_sample(0.02)),
            ("small_gicp", lambda: small_gicp.voxelgrid_sampling(theirs, 0.02, 1)),
        ],
        "voxel grid 0.005": [
            ("Open3D", lambda: cloud.voxel_down_sample(0.005)),
            ("small_gicp", lambda: small_gicp.voxelgrid_sampling(theirs, 0.005, 1)),
        ],
        "RANSAC plane": [("Open3D", lambda: cloud.segment_plane(0.01, 3, 1000))],
        "remove NaN": [("Open3D", lambda: o3d.geometry.PointCloud(full).remove_non_finite_points())],
        "bounding box": [("Open3D", cloud.get_axis_aligned_bounding_box)],
        "normals by radius": [("Open3D", lambda: o3d.geometry.PointCloud(cloud).estimate_normals(radius))],
        "radius outliers": [("Open3D", lambda: cloud.remove_radius_outlier(20, 0.01))],
        "statistical outliers": [("Open3D", lambda: cloud.remove_statistical_outlier(50, 1.0))],
    }
    return found
