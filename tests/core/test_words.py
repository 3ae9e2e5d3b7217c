from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from tests.core.clouds import LAYOUTS, coordinates, in_layout, random_cloud

from zsight_core.errors import PointsError
from zsight_core.words import Words, words_of


def read_back(words: Words) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    rows = words.words.reshape(-1, words.layout[0])
    return np.asarray(rows[:, list(words.layout[1:])], np.float32).reshape(-1, 3)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_coordinates_and_colours_are_the_clouds_own_in_any_layout(layout: str) -> None:
    cloud = random_cloud()
    words = words_of(in_layout(cloud, layout))
    assert_array_equal(read_back(words), coordinates(cloud))
    colours = words.words.view(np.uint32).reshape(-1, words.layout[0])[:, words.colour]
    assert_array_equal(colours, cloud["rgb"].reshape(-1).view(np.uint32))
    assert words.shape == cloud.shape


@pytest.mark.parametrize("layout", ["packed", "pcl", "reversed", "rgba"])
def test_layouts_made_of_words_are_not_copied(layout: str) -> None:
    cloud = in_layout(random_cloud(), layout)
    assert np.shares_memory(words_of(cloud).words, cloud)


def test_read_only_cloud_gives_the_same_kernel_type_and_no_copy() -> None:
    cloud = random_cloud()
    frozen = np.frombuffer(cloud.tobytes(), cloud.dtype).reshape(cloud.shape)
    words = words_of(frozen)
    assert words.words.flags.writeable  # numba would compile a second kernel for a read-only array
    assert words.words.ctypes.data == frozen.ctypes.data


def test_memory_of_a_read_only_cloud_outlives_the_cloud() -> None:
    cloud = random_cloud()
    words = words_of(np.frombuffer(cloud.tobytes(), cloud.dtype).reshape(cloud.shape))
    assert_array_equal(read_back(words), coordinates(cloud))


def test_unaligned_memory_is_copied() -> None:
    cloud = random_cloud()
    shifted = np.frombuffer(b"?" + cloud.tobytes(), cloud.dtype, offset=1).reshape(cloud.shape)
    words = words_of(shifted)
    assert words.words.ctypes.data % 4 == 0
    assert_array_equal(read_back(words), coordinates(cloud))


def test_every_second_row_and_column() -> None:
    cloud = random_cloud()
    assert_array_equal(read_back(words_of(cloud[::2, ::2])), coordinates(cloud[::2, ::2]))


def test_plain_coordinates() -> None:
    rows = np.arange(12.0).reshape(4, 3)
    assert_array_equal(read_back(words_of(rows)), rows)
    assert words_of(rows.reshape(2, 2, 3)).shape == (2, 2)
    assert words_of(np.empty((0, 3))).count == 0


def test_arrays_that_are_no_clouds_are_refused() -> None:
    with pytest.raises(PointsError, match="expected x, y and z"):
        words_of(np.zeros((2, 2), [("x", "<f4"), ("y", "<f4")]))
    with pytest.raises(PointsError, match="one number a point"):
        words_of(np.zeros((2, 2), [("x", "<f4", 2), ("y", "<f4"), ("z", "<f4")]))
    with pytest.raises(PointsError, match="shape"):
        words_of(np.zeros((2, 2, 2), [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    with pytest.raises(PointsError, match="shape"):
        words_of(np.zeros((5, 2)))
    with pytest.raises(PointsError, match="four bytes"):
        words_of(np.zeros((2, 2), [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("rgb", "<f8")]))
    with pytest.raises(PointsError, match="rgb holds"):
        words_of(np.zeros((2, 2), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<f4", 2)]))
