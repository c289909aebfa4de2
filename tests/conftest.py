"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import secrets
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest_plugins = ["tests.draws", "tests.skips"]

# For the object store on loopback; before any other process is started that should know them.
for name, value in {"ACCESS_KEY_ID": "test", "SECRET_ACCESS_KEY": "test", "DEFAULT_REGION": "us-east-1"}.items():
    os.environ.setdefault(f"AWS_{name}", value)

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root folder of this checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real datasets (CONDVLN_REAL_DATA, or ``shared/data`` beside the checkout)."""
    folder = Path(os.environ.get("CONDVLN_REAL_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(
            "no real datasets here: set CONDVLN_REAL_DATA to the folder that holds replicacad/, navmesh_golden/ …"
        )
    return folder


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """Address of a server on loopback that speaks the S3 protocol, with a bucket ``bucket``.

    It takes one request at a time: moto checks a condition and writes in two steps, which a real server does in one.
    """
    from moto.server import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import WSGIRequestHandler, make_server

    class Quiet(WSGIRequestHandler):
        def log(self, *arguments: object) -> None:
            return

    application = DomainDispatcherApplication(create_backend_app)
    server = make_server("127.0.0.1", 0, application, threaded=False, request_handler=Quiet)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    address = f"http://127.0.0.1:{server.server_port}"
    import boto3

    boto3.client("s3", endpoint_url=address).create_bucket(Bucket="bucket")
    yield address
    server.shutdown()
    thread.join()


@pytest.fixture
def s3_bucket(s3_server: str) -> str:
    """Address of an empty store in the bucket, as a configuration names it."""
    return f"s3://bucket/{secrets.token_hex(6)}?endpoint={s3_server}"


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Name bytes by their length: those of a packed file can hold the time, and each worker collects at its own."""
    return f"{argname} of {len(val)} bytes" if isinstance(val, bytes) else None
