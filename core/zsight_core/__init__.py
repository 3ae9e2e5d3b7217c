"""Geometry of point clouds on numpy arrays: no network, no schema, no process."""

from zsight_core import kernel_cache

kernel_cache.use()  # numba reads where to keep its kernels when it is imported, so this comes first
