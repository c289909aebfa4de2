"""An address where no Ray of ours is: one error that says what is wrong and what to do, within fifteen seconds."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
import toys

from factory.commits import Commits
from factory.dispatch import check_folders, seen_folders
from factory.ray_address import check_address, import_ray, join
from factory.ray_executor import RayExecutor
from factory.run import run
from factory.store import LocalStore
from schemas.errors import ClusterError, UsageError


@pytest.fixture
def silent() -> Iterator[str]:
    """Address of a port that takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"127.0.0.1:{server.getsockname()[1]}"


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_a_refused_address_is_said_at_once(scheme: str) -> None:
    address = f"{scheme}127.0.0.1:{free_port()}"
    with pytest.raises(ClusterError, match=f"ray.address: no Ray answers at {address}.*refused") as error:
        check_address(address)
    assert (error.value.exit_code, "\n" in str(error.value)) == (1, False)


def test_the_place_of_the_address_is_named() -> None:
    with pytest.raises(ClusterError, match=r"^environment variable RAY_ADDRESS: no Ray answers"):
        check_address(f"127.0.0.1:{free_port()}", "environment variable RAY_ADDRESS")


@pytest.mark.parametrize("address", ["nonsense", "host:", "ftp://host:1", "host:99999", "ray://host", ""])
def test_what_is_no_address_is_usage(address: str) -> None:
    with pytest.raises(UsageError, match="is not the address of a Ray cluster"):
        check_address(address)


def test_a_dashboard_is_no_cluster() -> None:
    with pytest.raises(UsageError, match="is the address of a dashboard"):
        check_address("http://127.0.0.1:8265")


@pytest.mark.soak
def test_a_port_that_never_answers_is_given_up(silent: str) -> None:
    began = time.monotonic()
    with pytest.raises(ClusterError, match=r"no Ray answers at .* \(no answer within 10 s\)"):
        check_address(silent)
    assert time.monotonic() - began > 9, "it did wait"


def test_auto_without_a_ray_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))  # where Ray looks for the address of a cluster that was started
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    if any("gcs_server" in (process.info["name"] or "") for process in psutil.process_iter(["name"])):
        # Ray looks at all processes too, and another test may have started one: its words when there is none.
        said = "ConnectionError: Could not find any running Ray instance. Please specify the one to connect to."
        answer = subprocess.CompletedProcess([], 1, "", said)
        monkeypatch.setattr(subprocess, "run", lambda *_, **__: answer)
    with pytest.raises(ClusterError, match="no Ray runs on this machine") as error:
        check_address("auto")
    assert "ray start --head" in error.value.remedy


def test_a_token_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    said = "RPC error: InvalidAuthToken: Authentication token is missing or incorrect"
    answer = subprocess.CompletedProcess([], 1, "", f"ray.exceptions.RpcError: {said}")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: answer)
    with pytest.raises(ClusterError, match=r"token is missing or incorrect.*Set RAY_AUTH_TOKEN"):
        check_address("auto")


def test_a_python_without_ray_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match="Ray can't be imported by this Python"):
        import_ray()


@pytest.mark.parametrize(
    ("raised", "kind", "said"),
    [
        (
            RuntimeError("Version mismatch: The cluster was started with:\n Ray: 2.9"),
            UsageError,
            "another version of Ray",
        ),
        (ImportError("Ray Client requires pip package `ray[client]`"), UsageError, r"ray\[client\]"),
        (ConnectionError("ray client connection timeout"), ClusterError, "connection timeout"),
        (SystemExit(15), ClusterError, "refuses this process"),
    ],
)
def test_what_ray_raises_while_it_joins_is_one_line(
    raised: BaseException, kind: type[Exception], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import ray

    def refuse(**_: object) -> None:
        raise raised

    monkeypatch.setattr("factory.ray_address.check_address", lambda *_: None)
    monkeypatch.setattr(ray, "init", refuse)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    with pytest.raises(kind, match=said) as error:
        join("host:6379", {})
    assert "\n" not in str(error.value)


def test_a_folder_that_a_node_does_not_see_is_named(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "house.json").touch()
    seen = seen_folders([str(tmp_path / "there"), str(tmp_path / "nowhere")])
    assert [folder.names for folder in seen] == [("house.json",)]
    check_folders(seen)
    (tmp_path / "there" / "house.json").unlink()
    with pytest.raises(ClusterError, match=r"worker node .* has another folder at .*there \(house.json is not there\)"):
        check_folders(seen)
    (tmp_path / "there").rmdir()
    with pytest.raises(ClusterError, match=r"worker node .* does not see .*there"):
        check_folders(seen)


@pytest.mark.ray
def test_a_node_without_the_data_ends_the_run_and_quarantines_nothing(store: LocalStore, tmp_path: Path) -> None:
    """A folder of the driver's open files exists for the driver only, as a disk of one node does."""
    with RayExecutor(workers=2) as owner:
        owner.start()
        held = os.open(tmp_path, os.O_RDONLY)
        try:
            executor = RayExecutor(workers=2, address="auto", folders=[f"/proc/self/fd/{held}"])
            with pytest.raises(ClusterError, match=r"does not see /proc/self/fd/.*nothing was published") as error:
                run(toys.pipeline(), toys.units(20), store, executor=executor)
        finally:
            os.close(held)
    assert "shared storage" in str(error.value)
    assert "\n" not in str(error.value)
    assert [*Commits(store).quarantined()] == []
