"""Where a configuration's store is, and what this machine keeps of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.object_store import ObjectStore
from jobs.configuration import load_config
from jobs.workspace import CACHE_VARIABLE, local_state, open_store
from schemas.errors import ConfigError


def written(folder: Path, store: str) -> Path:
    path = folder / "run.yaml"
    path.write_text(f"name: a\nstore: {store}\nsources: [{{family: replicacad, root: .}}]\n")
    return path


def test_an_object_store_is_named_by_its_address(tmp_path: Path) -> None:
    address = "s3://bucket/a/b?endpoint=http://localhost:9000&region=eu-west-1"
    config = load_config(written(tmp_path, address), environment={})
    assert config.store == address
    store = open_store(config)
    assert isinstance(store, ObjectStore)
    assert (store.bucket, store.prefix, store.endpoint) == ("bucket", "a/b", "http://localhost:9000")
    moved = load_config(written(tmp_path, "here"), environment={"CONDVLN_STORE": "s3://other/c"})
    assert moved.store == "s3://other/c"


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("gs://bucket/a", "is not an object store's address"),
        ("s3://", "is not an object store's address"),
        ("s3://key:secret@bucket/a", "must not contain secrets"),
        ("s3://bucket/a?endpoint=http://key:secret@localhost:9000", "must not contain secrets"),
        ("s3://bucket/a?secret_key=x", "is not an object store's address"),
    ],
)
def test_a_wrong_address_is_a_fault_of_the_key(tmp_path: Path, address: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as caught:
        load_config(written(tmp_path, address), environment={})
    assert caught.value.place == "store"


def test_what_is_remembered_stands_beside_a_folder_and_in_the_cache_for_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert local_state(tmp_path) == tmp_path
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    one, two = local_state("s3://bucket/a"), local_state("s3://bucket/b")
    assert one != two
    assert one.parent == two.parent == tmp_path / "cache" / "stores"
    monkeypatch.delenv(CACHE_VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert local_state("s3://bucket/a").is_relative_to(tmp_path / "xdg" / "condvln")
