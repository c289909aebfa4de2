"""The store on S3 and services with its protocol (MinIO, R2, GCS, Ceph): the same interface as local disk.

A put of an object is atomic by itself. The conditional write, ``swap``, is the protocol's own: ``If-None-Match: *``
for a new object, ``If-Match: <etag>`` for one that is replaced. A server that takes these headers and ignores them
would let two publishers overwrite each other silently, so the first conditional write of a process proves that they
work.

Needs ``boto3`` (``pip install condvln[s3]``), imported when the first request is made. Credentials and region come from
where boto3 finds them (environment, profile, role of the machine), never from the configuration.
"""

from __future__ import annotations

import contextlib
import functools
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from factory.store import Entry, token_of
from schemas.errors import PathEscapeError, PublishConflictError, StoreError, TransientIOError, UsageError

__all__ = ["ObjectStore"]

ATTEMPTS: Final = 5
"""Tries of one request, with growing pauses, before ``TransientIOError``; boto3 counts them."""

CONFLICT_TRIES: Final = 20
"""Tries of a conditional write while another one on the same key is under way (409)."""

_ABSENT: Final = {"404", "NoSuchKey", "NotFound"}
_FAILED: Final = {"412", "PreconditionFailed"}
_BUSY: Final = {"409", "ConditionalRequestConflict", "OperationAborted"}
_REFUSED: Final = {"403", "AccessDenied", "InvalidAccessKeyId", "SignatureDoesNotMatch", "NoSuchBucket", "501"}


@functools.lru_cache(maxsize=8)
def _client(endpoint: str | None, region: str | None) -> Any:
    """Return the client for S3 requests, one per process, which all threads share: making a client takes a third of a
    second.
    """
    try:
        import boto3
        from botocore.config import Config
    except ImportError as error:
        raise UsageError("object stores need boto3", remedy="pip install 'condvln[s3]'") from error
    settings = Config(
        retries={"max_attempts": ATTEMPTS, "mode": "standard"},
        connect_timeout=10,
        read_timeout=120,
        max_pool_connections=32,
        # Servers other than AWS often refuse the newer default checksums.
        request_checksum_calculation="when_required",
        response_checksum_validation="when_required",
    )
    return boto3.session.Session().client("s3", endpoint_url=endpoint, region_name=region, config=settings)


class ObjectStore:
    """Objects below ``prefix`` of a bucket.

    endpoint : of a server other than AWS (``http://localhost:9000``)
    """

    def __init__(
        self, bucket: str, prefix: str = "", *, endpoint: str | None = None, region: str | None = None
    ) -> None:
        self.bucket = bucket
        self.prefix = prefix.strip("/")
        self.endpoint = endpoint
        self.region = region
        self._proven = False

    @classmethod
    def from_url(cls, url: str) -> ObjectStore:
        """Parse ``s3://bucket/prefix[?endpoint=http://host:port][&region=name]``. Raises ``UsageError`` on anything
        else.
        """
        parts = urlsplit(url)
        query = parse_qs(parts.query)
        if "@" in parts.netloc or "@" in urlsplit(query.get("endpoint", [""])[-1]).netloc:
            raise UsageError(
                "the address of an object store must not contain secrets",
                remedy="Leave them to the environment: AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or a profile.",
            )
        if parts.scheme != "s3" or not parts.netloc or set(query) - {"endpoint", "region"}:
            raise UsageError(
                f"{url!r} is not an object store's address", remedy="Write s3://bucket/prefix?endpoint=…&region=…"
            )
        known = {name: values[-1] for name, values in query.items()}
        return cls(parts.netloc, parts.path, endpoint=known.get("endpoint"), region=known.get("region"))

    @property
    def url(self) -> str:
        return f"s3://{self.bucket}/{self.prefix}".rstrip("/")

    @property
    def _client(self) -> Any:
        return _client(self.endpoint, self.region)

    def _key(self, path: str) -> str:
        if path.startswith("/") or "\0" in path or any(part in ("", ".", "..") for part in path.split("/")):
            raise PathEscapeError("not a path inside the store", where=path)
        return f"{self.prefix}/{path}" if self.prefix else path

    def read(self, path: str) -> bytes:
        return self._get(path)[0]

    def _get(self, path: str) -> tuple[bytes, str]:
        """Return (bytes, etag) of an object."""
        with self._errors(path):
            answer = self._client.get_object(Bucket=self.bucket, Key=self._key(path))
            with answer["Body"] as body:
                data: bytes = body.read()
            return data, answer["ETag"]

    def write(self, path: str, data: bytes, *, settle: bool = True) -> None:
        key = self._key(path)
        with self._errors(path):
            self._client.put_object(Bucket=self.bucket, Key=key, Body=data)

    def swap(self, path: str, data: bytes, token: str | None) -> None:
        self._prove()
        conflict = PublishConflictError("another publisher moved this ref", where=path, remedy="Run again.")
        condition = {"IfNoneMatch": "*"}
        if token is not None:
            try:
                now, etag = self._get(path)
            except FileNotFoundError:
                raise conflict from None
            if token_of(now) != token:
                raise conflict
            condition = {"IfMatch": etag}
        if not self._put_if(path, data, condition):
            raise conflict

    def _put_if(self, path: str, data: bytes, condition: dict[str, str]) -> bool:
        key = self._key(path)
        for _ in range(CONFLICT_TRIES):
            try:
                with self._errors(path):
                    self._client.put_object(Bucket=self.bucket, Key=key, Body=data, **condition)
                return True
            except _Busy:
                continue
            except (_PreconditionFailed, FileNotFoundError):
                # A request that was answered too late and sent again meets its own first one.
                return self._holds(path, data)
        raise TransientIOError("conditional writes keep colliding", where=f"{self.url}/{path}")

    def _holds(self, path: str, data: bytes) -> bool:
        try:
            return self.read(path) == data
        except FileNotFoundError:
            return False

    def _prove(self) -> None:
        """Check that the server refuses conditional writes whose condition does not hold. The check is made once per
        process.
        """
        if self._proven:
            return
        path = f"probe/{secrets.token_hex(8)}"
        try:
            first = self._put_if(path, b"1", {"IfNoneMatch": "*"})
            second = self._put_if(path, b"2", {"IfNoneMatch": "*"})
            third = self._put_if(path, b"3", {"IfMatch": '"0123456789abcdef0123456789abcdef"'})
            if not first or second or third:
                raise StoreError(
                    "the server ignores conditional writes: two publishers could overwrite each other",
                    where=self.url,
                    remedy="Use a server that knows If-None-Match and If-Match on PUT (AWS, MinIO, R2, Ceph ≥ 19).",
                )
        finally:
            self.delete(path)
        self._proven = True

    def copy(self, source: str, target: str) -> None:
        origin = {"Bucket": self.bucket, "Key": self._key(source)}
        key = self._key(target)
        with self._errors(source):
            self._client.copy_object(Bucket=self.bucket, Key=key, CopySource=origin)

    def list(self, prefix: str) -> Iterator[Entry]:
        below = f"{self._key(prefix)}/" if prefix else f"{self.prefix}/" if self.prefix else ""
        skip = len(self.prefix) + 1 if self.prefix else 0
        with self._errors(prefix):
            for page in self._client.get_paginator("list_objects_v2").paginate(Bucket=self.bucket, Prefix=below):
                for item in page.get("Contents", ()):
                    yield Entry(item["Key"][skip:], item["Size"], item["LastModified"].timestamp())

    def delete(self, path: str) -> None:
        key = self._key(path)
        with self._errors(path):
            self._client.delete_object(Bucket=self.bucket, Key=key)

    def local_path(self, path: str) -> Path | None:
        return None

    @contextlib.contextmanager
    def _errors(self, path: str) -> Iterator[None]:
        _client(self.endpoint, self.region)  # a missing boto3 is reported before botocore is imported
        from botocore.exceptions import BotoCoreError, ClientError, NoCredentialsError

        where = f"{self.url}/{path}"
        try:
            yield
        except NoCredentialsError as error:
            remedy = "Set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE, or give the machine a role."
            raise StoreError("there are no credentials for the object store", where=where, remedy=remedy) from error
        except ClientError as error:
            code = str(error.response.get("Error", {}).get("Code", ""))
            status = str(error.response.get("ResponseMetadata", {}).get("HTTPStatusCode", ""))
            if code in _REFUSED or status == "501":
                remedy = "Check bucket, credentials and permissions."
                raise StoreError(f"the object store refused: {error}", where=where, remedy=remedy) from error
            if code in _ABSENT:
                raise FileNotFoundError(where) from error
            if code in _FAILED or status == "412":
                raise _PreconditionFailed from error
            if code in _BUSY or status == "409":
                raise _Busy from error
            if status.startswith("5") or code in ("SlowDown", "RequestTimeout", "429"):
                raise TransientIOError(f"the object store did not answer: {error}", where=where) from error
            raise StoreError(f"the object store failed: {error}", where=where) from error
        except BotoCoreError as error:
            raise TransientIOError(f"the object store can't be reached: {error}", where=where) from error


class _PreconditionFailed(Exception):
    pass


class _Busy(Exception):
    pass
