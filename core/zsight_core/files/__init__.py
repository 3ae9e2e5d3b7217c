"""Clouds, meshes and calibrations in files: PCD, PLY, RGB-D pairs; text and binary, read and written."""
