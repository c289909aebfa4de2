"""Fixtures of the factory's tests."""

from __future__ import annotations

import os
import secrets
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDER = str(Path(__file__).parent)
# The toys must be importable by name in other processes too: Ray's workers, and drivers that get killed.
if FOLDER not in sys.path:
    sys.path.insert(0, FOLDER)
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [FOLDER, os.environ.get("PYTHONPATH", "")]))
# For the server on loopback; before any other process is started that should know them.
for name, value in {"ACCESS_KEY_ID": "test", "SECRET_ACCESS_KEY": "test", "DEFAULT_REGION": "us-east-1"}.items():
    os.environ.setdefault(f"AWS_{name}", value)

from factory import LocalStore  # noqa: E402
from factory.object_store import ObjectStore  # noqa: E402


@pytest.fixture
def store(tmp_path: Path) -> LocalStore:
    """An empty local store."""
    return LocalStore(tmp_path / "store", durable=False)


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """Address of a server on loopback that speaks the S3 protocol, with a bucket ``bucket``.

    It takes one request at a time: moto checks a condition and writes in two steps, which a real server does in one.
    """
    pytest.importorskip("moto")
    pytest.importorskip("boto3")
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
def object_store(s3_server: str) -> ObjectStore:
    """An empty store in the bucket."""
    return ObjectStore("bucket", f"a/{secrets.token_hex(6)}", endpoint=s3_server)
