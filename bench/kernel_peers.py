"""The kernels' work done by Open3D and small_gicp, one thread, on arrays that are theirs already."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import small_gicp

from zsight_core import open3d_module
from zsight_core.filters import remove_nan
from zsight_core.points import xyz
from zsight_core.transform import from_rpy, transform_xyz
from zsight_core.voxel_grid import voxel_grid

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


STEPS = 3
"""Few enough that neither has converged, which small_gicp would spend further tries on."""

REACH = 0.02


def registrations(points: Points) -> tuple[Callable[[], object], Callable[[], object]]:
    """Point-to-plane steps of ICP by small_gicp and by Open3D, voxels of 1 cm against themselves moved by a little.

    Normals and trees are made beforehand. Ours there is none: it is left to small_gicp (docs/decisions/0051).
    """
    o3d = open3d_module.load()
    still = xyz(voxel_grid(points, 0.01)).reshape(-1, 3).astype(np.float64)
    moved = transform_xyz(from_rpy([0.004, -0.003, 0.002], [0.004, 0.003, -0.005]), still)
    target, source = small_gicp.PointCloud(still), small_gicp.PointCloud(moved)
    tree = small_gicp.KdTree(target, num_threads=1)
    small_gicp.estimate_normals(target, tree, num_neighbors=20, num_threads=1)
    one, other = o3d.geometry.PointCloud(), o3d.geometry.PointCloud()
    one.points, other.points = o3d.utility.Vector3dVector(still), o3d.utility.Vector3dVector(moved)
    one.normals = o3d.utility.Vector3dVector(np.ascontiguousarray(target.normals()[:, :3]))
    icp = o3d.pipelines.registration
    never = icp.ICPConvergenceCriteria(relative_fitness=0, relative_rmse=0, max_iteration=STEPS)

    def by_small_gicp() -> object:
        return small_gicp.align(
            target,
            source,
            tree,
            registration_type="PLANE_ICP",
            max_correspondence_distance=REACH,
            num_threads=1,
            max_iterations=STEPS,
            rotation_epsilon=0,
            translation_epsilon=0,
        )

    def by_open3d() -> object:
        plane = icp.TransformationEstimationPointToPlane()
        return icp.registration_icp(other, one, REACH, np.eye(4), plane, never)

    return by_small_gicp, by_open3d
