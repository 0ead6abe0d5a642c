import errno
import os
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from nnql_bullet.errors import UserError
from nnql_bullet.files import write_atomically, write_text
from nnql_bullet.reports.html import _image
from nnql_bullet.runs import _read_csv
from nnql_bullet.training.checkpoint import load_weights
from nnql_bullet.vehicle.description import read


@pytest.fixture
def umask():
    """Sets the process's umask for one test."""
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


def fill_the_disk(path):
    path.write_bytes(b"half of it")
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def interrupt(path):
    path.write_bytes(b"half of it")
    raise KeyboardInterrupt


@pytest.mark.parametrize(("writer", "error"), [(fill_the_disk, OSError), (interrupt, KeyboardInterrupt)])
def test_failed_write_leaves_the_old_file_and_nothing_beside_it(tmp_path, writer, error):
    path = tmp_path / "a.bin"
    with pytest.raises(error):
        write_atomically(path, writer)
    assert list(tmp_path.iterdir()) == []
    path.write_bytes(b"old")
    with pytest.raises(error):
        write_atomically(path, writer)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_failed_rename_leaves_the_old_file_and_nothing_beside_it(tmp_path, monkeypatch):
    def refuse(self, target):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        write_atomically(path, lambda temporary: temporary.write_bytes(b"new"))
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_file_is_replaced_whole(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"a longer old file")
    write_atomically(path, lambda temporary: temporary.write_bytes(b"new"))
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_reader_with_the_old_file_open_keeps_seeing_the_old_one(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with path.open("rb") as reader:
        write_atomically(path, lambda temporary: temporary.write_bytes(b"new"))
        assert reader.read() == b"old"


def test_old_file_is_whole_while_the_new_one_is_written(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    seen = []

    def write(temporary):
        temporary.write_bytes(b"new")
        seen.append((temporary.parent.parent, temporary.name, path.read_bytes()))

    write_atomically(path, write)
    assert seen == [(tmp_path, "a.bin", b"old")]


def test_writers_that_go_by_the_ending_write_where_they_should(tmp_path):
    path = tmp_path / "arrays.npz"
    write_atomically(path, lambda temporary: np.savez(temporary, a=np.arange(3)))
    with np.load(path) as arrays:
        assert arrays["a"].tolist() == [0, 1, 2]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_mode_is_that_of_any_new_file(tmp_path, umask, mask, mode):
    umask(mask)
    write_text(tmp_path / "a.txt", "text")
    write_atomically(tmp_path / "a.safetensors", lambda temporary: save_file({"a": np.arange(3)}, temporary))
    assert {path.stat().st_mode & 0o777 for path in tmp_path.iterdir()} == {mode}
    assert umask(mask) == mask


def test_an_error_names_the_file_that_was_wanted(tmp_path):
    wanted = tmp_path / "none" / "a"
    with pytest.raises(FileNotFoundError) as caught:
        write_text(wanted, "")
    assert str(caught.value) == f"[Errno 2] No such file or directory: '{wanted}'"


def test_missing_folder_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_text(tmp_path / "nowhere" / "a.txt", "text")


def test_text_is_utf_8_with_line_feeds(tmp_path):
    write_text(tmp_path / "a.txt", "°\nm²\n")
    assert (tmp_path / "a.txt").read_bytes() == b"\xc2\xb0\nm\xc2\xb2\n"


@pytest.mark.parametrize("reader", [_read_csv, lambda path: _image(path, ""), read, load_weights])
def test_a_named_pipe_is_refused_and_not_waited_for(tmp_path, reader):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UserError, match="pipe: "):
        reader(tmp_path / "pipe")


def test_metadata_nested_too_deeply_are_damage(tmp_path):
    deep = {"nnql-bullet": "[" * 100_000 + "]" * 100_000}
    save_file({"a": np.arange(3)}, tmp_path / "deep.safetensors", deep)
    with pytest.raises(UserError, match=r"deep\.safetensors: damaged.*nested too deeply"):
        load_weights(tmp_path / "deep.safetensors")
