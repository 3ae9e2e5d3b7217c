"""Geometry of point clouds on numpy arrays: no network, no schema, no process."""
