"""The contract of a store, held by every implementation."""

from __future__ import annotations

import errno
import os
import pickle
import secrets
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from factory.object_store import ObjectStore
from factory.store import LocalStore, Store, open_store, token_of
from schemas.errors import PathEscapeError, PublishConflictError, StoreError, TransientIOError, UsageError

Make = Callable[[], Store]

NOBODY = 65534
"""A user that owns nothing."""


@pytest.fixture(params=["local", "s3"])
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Make:
    """Makes stores onto one and the same place."""
    if request.param == "local":
        return partial(LocalStore, tmp_path / "store")
    address = request.getfixturevalue("s3_server")
    return partial(ObjectStore, "bucket", f"b/{secrets.token_hex(6)}", endpoint=address)


def test_files_are_written_read_replaced_listed_copied_and_deleted(make: Make) -> None:
    store = make()
    assert [*store.list("a")] == []
    with pytest.raises(FileNotFoundError):
        store.read("a/b.txt")
    store.write("a/b.txt", b"one")
    store.write("a/b.txt", b"two")
    store.write("a/c/d.txt", b"three", settle=False)
    store.write("e.txt", b"")
    other = make()
    assert other.read("a/b.txt")
    assert (other.read("a/b.txt"), other.read("e.txt")) == (b"two", b"")
    assert {(entry.path, entry.size) for entry in store.list("")} == {("a/b.txt", 3), ("a/c/d.txt", 5), ("e.txt", 0)}
    assert {entry.path for entry in store.list("a")} == {"a/b.txt", "a/c/d.txt"}
    assert [*store.list("nowhere")] == []
    store.copy("a/b.txt", "f/g.txt")
    store.copy("a/b.txt", "f/g.txt")
    store.delete("a/b.txt")
    store.delete("a/b.txt")
    assert store.read("f/g.txt") == b"two"
    assert {entry.path for entry in store.list("")} == {"a/c/d.txt", "e.txt", "f/g.txt"}


def test_folders_are_not_prefixes_of_names(make: Make) -> None:
    store = make()
    store.write("units/ab", b"1")
    store.write("units2/ab", b"2")
    assert {entry.path for entry in store.list("units")} == {"units/ab"}


def test_swap_needs_the_token_of_what_is_there(make: Make) -> None:
    store = make()
    with pytest.raises(PublishConflictError):
        store.swap("refs/m", b"x", token_of(b"never"))
    store.swap("refs/m", b"one", None)
    with pytest.raises(PublishConflictError):
        store.swap("refs/m", b"two", None)
    store.swap("refs/m", b"two", token_of(b"one"))
    with pytest.raises(PublishConflictError):
        store.swap("refs/m", b"three", token_of(b"one"))
    assert store.read("refs/m") == b"two"


def race(make: Make, attempt: Callable[[Store, int], bool]) -> list[bool]:
    """What six publishers get who start at one moment."""
    start = threading.Barrier(6)
    results: dict[int, bool] = {}

    def publish(who: int) -> None:
        mine = make()
        start.wait()
        results[who] = attempt(mine, who)

    threads = [threading.Thread(target=publish, args=(who,)) for who in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [results[who] for who in range(6)]


def test_of_many_publishers_exactly_one_wins(make: Make) -> None:
    store = make()
    store.swap("refs/m", b"0", None)
    for _ in range(3):
        token = token_of(store.read("refs/m"))
        names = [os.urandom(4).hex().encode() for _ in range(6)]

        def attempt(mine: Store, who: int, token: str = token, names: list[bytes] = names) -> bool:
            try:
                mine.swap("refs/m", names[who], token)
            except PublishConflictError:
                return False
            return True

        results = race(make, attempt)
        assert results.count(True) == 1
        assert store.read("refs/m") == names[results.index(True)]


@pytest.mark.parametrize("path", ["../x", "/etc/passwd", "a/../../x", "a//b", "", "a/./b", "a\0b"])
def test_no_path_leaves_the_store(make: Make, path: str) -> None:
    store = make()
    with pytest.raises(PathEscapeError):
        store.write(path, b"")
    with pytest.raises(PathEscapeError):
        store.read(path)


def test_a_store_travels_to_workers(make: Make) -> None:
    store = make()
    store.write("a", b"1")
    assert pickle.loads(pickle.dumps(store)).read("a") == b"1"


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="only Linux gives the name of an open file")
def test_a_file_outlasts_a_power_cut_with_every_folder_above_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[Path] = []
    monkeypatch.setattr(os, "fsync", lambda handle: flushed.append(Path(os.readlink(f"/proc/self/fd/{handle}"))))
    store = LocalStore(tmp_path / "new" / "store")
    store.write("units/ab/unit.json", b"{}")
    folders = {tmp_path, *(tmp_path / "new").rglob("*"), tmp_path / "new"} - {tmp_path / "new/store/units/ab/unit.json"}
    assert {path for path in flushed if path.is_dir()} == folders
    file = next(at for at, path in enumerate(flushed) if ".tmp-" in path.name)
    assert flushed[file + 1 :] == [tmp_path / "new/store/units/ab"], "the name comes after the bytes"
    flushed.clear()
    store.write("units/ab/unit.json", b"{}")
    assert len(flushed) == 2


@pytest.mark.parametrize("code", [errno.EPERM, errno.EOPNOTSUPP])
def test_a_disk_without_hard_links_is_one_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "link", refuse)
    store = LocalStore(tmp_path)
    store.write("a/x", b"first")
    store.copy("a/x", "b/y")
    assert (store.read("a/x"), store.read("b/y")) == (b"first", b"first")
    assert {entry.path for entry in store.list("")} == {"a/x", "b/y"}
    assert [*store.unfinished()] == []


def test_a_lock_that_may_not_be_taken_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made by root, say, and now another user publishes."""
    real = os.open

    def guarded(path: object, *rest: int) -> int:
        if Path(str(path)).name == ".lock":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return real(path, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "open", guarded)
    with pytest.raises(StoreError, match=r"refs/m.*Permission denied"):
        LocalStore(tmp_path).swap("refs/m", b"x", None)


def test_unfinished_writes_are_not_listed(tmp_path: Path) -> None:
    store = LocalStore(tmp_path)
    store.write("a/x", b"1")
    (tmp_path / "a" / ".tmp-dead").write_bytes(b"half")
    assert [entry.path for entry in store.list("")] == ["a/x"]
    assert [path.name for path in store.unfinished()] == [".tmp-dead"]


def test_a_store_that_may_not_be_written_says_so() -> None:
    with tempfile.TemporaryDirectory() as folder:  # tmp_path is inside folders that only their owner may enter
        Path(folder).chmod(0o755)
        shut = Path(folder) / "shut"
        shut.mkdir(mode=0o555)
        user = os.geteuid()
        try:
            if user == 0:  # root may write anywhere
                os.seteuid(NOBODY)
            with pytest.raises(StoreError, match="shut"):
                LocalStore(shut).write("a", b"")
        finally:
            os.seteuid(user)


def test_a_store_on_a_file_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="file"):
        LocalStore(tmp_path / "file").write("a/b", b"")


def test_addresses_of_stores(tmp_path: Path) -> None:
    local = open_store(tmp_path)
    assert isinstance(local, LocalStore)
    found = open_store("s3://data/condvln/v1?endpoint=http://localhost:9000&region=eu-west-1")
    assert isinstance(found, ObjectStore)
    assert (found.bucket, found.prefix, found.endpoint, found.region) == (
        "data",
        "condvln/v1",
        "http://localhost:9000",
        "eu-west-1",
    )
    assert found.url == "s3://data/condvln/v1"
    for wrong in ("gs://x", "s3://", "s3://b/p?secret=1"):
        with pytest.raises(UsageError, match="address"):
            open_store(wrong)


def test_an_object_store_that_refuses_or_is_gone_says_so(s3_server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StoreError, match="NoSuchBucket"):
        ObjectStore("nobody", endpoint=s3_server).write("a", b"")
    monkeypatch.setattr("factory.object_store.ATTEMPTS", 1)
    with pytest.raises(TransientIOError, match="can't be reached"):
        ObjectStore("bucket", endpoint="http://127.0.0.1:1").read("a")


def test_a_server_that_ignores_conditions_is_found_out(
    object_store: ObjectStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    put = object_store._client.put_object

    def careless(**request: object) -> object:
        request.pop("IfNoneMatch", None)
        request.pop("IfMatch", None)
        return put(**request)

    monkeypatch.setattr(object_store._client, "put_object", careless)
    with pytest.raises(StoreError, match="ignores conditional writes"):
        object_store.swap("refs/m", b"x", None)
    assert [*object_store.list("")] == []
