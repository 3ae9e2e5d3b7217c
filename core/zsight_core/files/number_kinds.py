"""The kinds of numbers that records hold, as the kernels that read and spell them count them."""

from __future__ import annotations

import numpy as np

__all__ = ["BYTE", "DOUBLE", "FLOAT", "KINDS", "POWERS", "SIGNED", "SIZES", "TENS", "TEXT", "UINT32", "UNSIGNED"]

KINDS = {"f4": 0, "f8": 1, "i1": 2, "i2": 3, "i4": 4, "i8": 5, "u1": 6, "u2": 7, "u4": 8, "u8": 9, "text": 10}
FLOAT, DOUBLE, SIGNED, UNSIGNED, UINT32, TEXT = 0, 1, 2, 6, 8, 10
SIZES = np.array([4, 8, 1, 2, 4, 8, 1, 2, 4, 8], np.int64)
POWERS = np.array([float(f"1e{k}") for k in range(309)])
TENS = np.array([10**k for k in range(10)], np.uint64)
BYTE = np.uint64(255)
