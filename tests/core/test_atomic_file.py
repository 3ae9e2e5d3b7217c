"""Files appear whole or not at all."""

from __future__ import annotations

import os
import stat
import threading
from typing import TYPE_CHECKING

import pytest

from zsight_core.errors import FileError
from zsight_core.files.atomic_file import atomic_file

if TYPE_CHECKING:
    from pathlib import Path


def put(path: Path, data: bytes, *, overwrite: bool = False) -> None:
    with atomic_file(path, overwrite=overwrite) as file:
        file.write(data)


def test_the_file_is_there_only_when_the_block_has_ended(tmp_path: Path) -> None:
    place = tmp_path / "a.pcd"
    with atomic_file(place) as file:
        file.write(b"half")
        assert not place.exists()
    assert place.read_bytes() == b"half"
    assert list(tmp_path.iterdir()) == [place]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, ValueError])
def test_a_failure_leaves_nothing_behind(tmp_path: Path, error: type[BaseException], overwrite: bool) -> None:
    place = tmp_path / "a.pcd"
    if overwrite:
        place.write_bytes(b"old")

    def fail() -> None:
        with atomic_file(place, overwrite=overwrite) as file:
            file.write(b"half")
            raise error("stop")

    with pytest.raises(error, match="stop"):
        fail()
    assert [path.read_bytes() for path in tmp_path.iterdir()] == ([b"old"] if overwrite else [])


def test_an_existing_file_is_kept_unless_told(tmp_path: Path) -> None:
    place = tmp_path / "a.pcd"
    place.write_bytes(b"old")
    with pytest.raises(FileError, match="a file of this name already"):
        put(place, b"new")
    assert place.read_bytes() == b"old"
    put(place, b"new", overwrite=True)
    assert place.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [place]


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path, links: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "a.pcd"
    if not links:
        monkeypatch.setattr(os, "link", refuse)

    def be_late() -> None:
        with atomic_file(place) as file:
            file.write(b"late")
            place.write_bytes(b"early")

    with pytest.raises(FileError, match="a file of this name already"):
        be_late()
    assert place.read_bytes() == b"early"
    assert list(tmp_path.iterdir()) == [place]


def test_it_works_where_files_cannot_be_linked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", refuse)
    put(tmp_path / "a.pcd", b"data")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"data"]


def test_of_many_writers_exactly_one_succeeds(tmp_path: Path) -> None:
    place, won, lost = tmp_path / "a.pcd", [], []
    gate = threading.Barrier(8)

    def compete(number: int) -> None:
        gate.wait()
        try:
            put(place, b"%d" % number * 1000)
        except FileError:
            lost.append(number)
        else:
            won.append(number)

    threads = [threading.Thread(target=compete, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(won), len(lost)) == (1, 7)
    assert place.read_bytes() == b"%d" % won[0] * 1000
    assert list(tmp_path.iterdir()) == [place]


def test_a_place_that_cannot_be_written_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no folder"):
        put(tmp_path / "nowhere" / "a.pcd", b"")
    with pytest.raises(FileError, match="not a regular file"):
        put(tmp_path, b"", overwrite=True)
    with pytest.raises(FileError, match="null"):
        put(tmp_path / "a\0b", b"")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="No space left"), atomic_file(tmp_path / "a.pcd"):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX's")
def test_permissions_follow_the_users_mask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        put(tmp_path / "a.pcd", b"data")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.pcd").stat().st_mode) == 0o640


def refuse(source: object, target: object) -> None:
    raise OSError(95, f"Operation not supported: {source} {target}")
