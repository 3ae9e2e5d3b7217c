"""The scene stage: supports, segments and labels on truth that is known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core.errors import Cancelled, PointsError
from zsight_core.files import pcd
from zsight_core.model import Box, Cylinder, ObjectModel
from zsight_core.points import from_xyz, xyz
from zsight_core.scene import understand
from zsight_core.segments import MOST_PATCHES
from zsight_core.simulation.kinect import Kinect
from zsight_core.view import see

if TYPE_CHECKING:
    from pathlib import Path

    from zsight_core.points import Points
    from zsight_core.scene import Scene

CARTON = ObjectModel("carton", Box((0.06, 0.09, 0.2)))
CUP = ObjectModel("cup", Cylinder(0.08, 0.1))
FLAT = ObjectModel("flat", Box((0.2, 0.14, 0.05)))
Z = book.TABLE_HEIGHT


def seen(points: Points) -> Scene:
    return understand(points, T_world_camera=book.T_WORLD_CAMERA)


def label_at(scene: Scene, points: Points, x: float, y: float, z: float) -> int:
    """Label of the pixel whose point is nearest to a place in the world."""
    T = np.linalg.inv(book.T_WORLD_CAMERA)
    place = T[:3, :3] @ [x, y, z] + T[:3, 3]
    gap = np.linalg.norm(xyz(points).astype(float) - place, axis=2)
    return int(scene.labels.reshape(-1)[np.nanargmin(gap)])


def test_table_and_floor_are_supports_at_their_heights() -> None:
    scene = seen(book.cloud((CARTON, book.at(0.6, -0.3, Z + 0.1)), noise=Kinect()))
    heights = [support.height for support in scene.supports]
    assert heights == pytest.approx([Z, 0.0], abs=0.001)
    assert scene.supports[0].normal @ book.T_WORLD_CAMERA[2, :3] > np.cos(np.radians(0.05))


def test_plane_error_is_as_its_covariance_says() -> None:
    errors = []
    for seed in range(12):
        support = seen(book.cloud(noise=Kinect(), seed=seed)).supports[0]
        assert support.height is not None
        errors.append((support.height - Z) / np.sqrt(support.covariance[0, 0]))
        assert abs(support.height - Z) < 0.00015
    assert np.mean(np.square(errors)) < 25  # the sensor's noise is rounded, not white


def test_separate_objects_get_a_label_each() -> None:
    points = book.cloud((CARTON, book.at(0.6, -0.1, Z + 0.1)), (CUP, book.at(0.6, -0.45, Z + 0.05)), noise=Kinect())
    scene = seen(points)
    assert [segment.label for segment in scene.segments] == [2, 3]
    carton = label_at(scene, points, 0.6, -0.1, Z + 0.2)
    cup = label_at(scene, points, 0.6, -0.45, Z + 0.1)
    assert {carton, cup} == {2, 3}
    assert scene.segments[carton - 2].high == pytest.approx(0.2, abs=0.008)
    assert scene.segments[cup - 2].high == pytest.approx(0.1, abs=0.008)
    assert label_at(scene, points, 0.45, -0.3, Z) == 1


def test_a_cup_on_a_flat_box_is_another_object() -> None:
    points = book.cloud((FLAT, book.at(0.6, -0.3, Z + 0.025)), (CUP, book.at(0.6, -0.3, Z + 0.1)), noise=Kinect())
    scene = seen(points)
    top = label_at(scene, points, 0.6, -0.3, Z + 0.15)
    box = label_at(scene, points, 0.53, -0.35, Z + 0.05)
    assert top >= 2
    assert box >= 2
    assert top != box


def test_touching_boxes_of_different_height_are_parted() -> None:
    low = ObjectModel("low", Box((0.06, 0.09, 0.1)))
    points = book.cloud((CARTON, book.at(0.66, -0.3, Z + 0.1)), (low, book.at(0.6, -0.3, Z + 0.05)), noise=Kinect())
    scene = seen(points)
    assert label_at(scene, points, 0.66, -0.3, Z + 0.2) != label_at(scene, points, 0.6, -0.3, Z + 0.1)


def test_labels_cover_the_cloud_and_number_without_gaps() -> None:
    points = book.cloud((CARTON, book.at(0.6, -0.1, Z + 0.1)), noise=Kinect())
    scene = seen(points)
    assert scene.labels.shape == points.shape
    assert scene.labels.dtype == np.int32
    assert ((scene.labels == -1) == ~np.isfinite(xyz(points)[..., 2])).all()
    used = np.unique(scene.labels[scene.labels >= 2])
    assert used.tolist() == [segment.label for segment in scene.segments]
    for segment in scene.segments:
        assert segment.points == (scene.labels == segment.label).sum()


def test_gravity_unknown_finds_the_same_table() -> None:
    points = book.cloud((CARTON, book.at(0.6, -0.3, Z + 0.1)), noise=Kinect())
    with_pose, without = seen(points), understand(points)
    best = max(without.supports, key=lambda support: float(support.normal @ with_pose.supports[0].normal))
    assert best.normal @ with_pose.supports[0].normal > np.cos(np.radians(0.1))


def test_known_height_leaves_the_other_surfaces_out() -> None:
    points = book.cloud(noise=Kinect())
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA, known_height=0.77)
    assert [support.height for support in scene.supports] == pytest.approx([Z], abs=0.001)
    assert understand(points, T_world_camera=book.T_WORLD_CAMERA, known_height=1.2).supports == []


def test_unorganised_cloud_gets_labels_in_its_own_order() -> None:
    points = book.cloud((CARTON, book.at(0.6, -0.1, Z + 0.1)))
    flat = xyz(points).reshape(-1, 3)
    finite = np.isfinite(flat).all(axis=1)
    order = np.random.default_rng(2).permutation(np.flatnonzero(finite))
    organised, shuffled = seen(points), seen(from_xyz(flat[order]))
    assert shuffled.labels.shape == (1, len(order))
    same = (shuffled.labels.reshape(-1) >= 2) == (organised.labels.reshape(-1)[order] >= 2)
    assert same.mean() > 0.98


@pytest.mark.parametrize("flip", [np.diag([1, -1, -1]), np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])])
def test_axes_of_other_conventions_give_the_same_labels(flip: np.ndarray) -> None:
    points = book.cloud((CARTON, book.at(0.6, -0.1, Z + 0.1)))
    turned = from_xyz(xyz(points) @ flip.T.astype(np.float32))
    # Without noise many pixels lie just on a threshold, and which side they fall on is up to the processor's rounding.
    assert (understand(turned).labels == understand(points).labels).mean() > 0.995


def test_millimetres_are_told() -> None:
    points = book.cloud()
    with pytest.raises(PointsError, match="millimetres"):
        understand(from_xyz(xyz(points) * 1000))


def test_read_only_memory_is_as_good() -> None:
    points = book.cloud((CARTON, book.at(0.6, -0.1, Z + 0.1)))
    expected = seen(points).labels
    points.flags.writeable = False
    assert (seen(points).labels == expected).all()


@pytest.mark.parametrize("stray", [(50.0, 0.0, 0.7), (3.0, 0.0, 0.7), (0.0, 0.0, -2.0)])
def test_a_stray_point_does_not_shrink_the_image_of_an_unorganised_cloud(stray: tuple[float, float, float]) -> None:
    points = book.cloud((CARTON, book.at(0.6, -0.3, Z + 0.1)))
    rows = xyz(points).reshape(-1, 3)
    rows = rows[np.isfinite(rows).all(axis=1)]
    clean = see(from_xyz(rows))
    spoilt = see(from_xyz(np.concatenate([rows, [stray]])))
    assert (spoilt.depth > 0).sum() > 0.6 * (clean.depth > 0).sum()


def test_no_more_patches_than_can_be_compared() -> None:
    """A table of which a part is strewn with flakes, every second field of a chequerboard."""
    table = book.cloud()
    rows, columns = np.indices(table.shape) // 8
    nearer = np.random.default_rng(0).uniform(0.93, 0.98, (80, 80))[rows, columns].astype(np.float32)
    for axis in "xyz":
        table[axis] *= np.where((rows + columns) % 2 * (columns > 25), nearer, np.float32(1))
    patches = seen(table).patches
    assert len(patches.count) == MOST_PATCHES
    assert (np.bincount(patches.label[patches.label >= 0]) == patches.count).all()


def test_checkpoint_stops_between_stages() -> None:
    def stop(stage: str, fraction: float) -> None:
        if stage == "segments":
            raise Cancelled(f"at {fraction}")

    with pytest.raises(Cancelled):
        understand(book.cloud(), checkpoint=stop)


@pytest.mark.parametrize("name", ["learn0", "learn22", "learn30", "learn35"])
def test_real_scenes_have_the_labelled_number_of_objects(shared_data: Path, name: str) -> None:
    points = pcd.read(shared_data / "mosd_learn" / f"{name}.pcd").points
    truth = points["label"] // 10
    scene = understand(points)
    assert len(scene.segments) == len(np.unique(truth[truth >= 2]))
    for k in np.unique(truth[truth >= 2]):
        best = np.bincount(scene.labels[(truth == k) & (scene.labels >= 0)]).argmax()
        shared = ((scene.labels == best) & (truth == k)).sum()
        assert 2 * shared / ((scene.labels == best).sum() + (truth == k).sum()) > 0.75
