"""A small client of Ray's Jobs REST API, written from the API's OpenAPI page. It needs only the standard library.

Ray's own client comes with ``ray[default]``, some forty packages that a person's machine needs for nothing else.
https://docs.ray.io/en/latest/cluster/running-applications/job-submission/rest.html (and ``/api/packages/…``, by which
``ray job submit --working-dir`` uploads its files).
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote, urlsplit

from schemas.errors import TransientIOError, UsageError

__all__ = ["JobState", "RayJobs"]

TIMEOUT_SECONDS: Final = 30.0
"""Timeout of one request, seconds."""

TRIES: Final = 5
"""Tries of a request that only reads, with growing pauses: a head that restarts is away for some seconds."""

NOT_YET: Final = "No available agent"
"""What a head answers, with code 500, while its agent starts. Nothing was submitted, so the request is repeated."""

ENDED: Final = frozenset({"SUCCEEDED", "FAILED", "STOPPED"})

LOOPBACK: Final = frozenset({"127.0.0.1", "localhost", "::1"})

MAX_BYTES: Final = 64 * 2**20
"""Largest answer that is read, bytes: the log of one job."""


@dataclass(frozen=True)
class JobState:
    """State of a job.

    status : PENDING, RUNNING, SUCCEEDED, FAILED or STOPPED
    exit_code : of its command; None while it runs, or where Ray does not know
    """

    status: str
    message: str
    exit_code: int | None

    @property
    def ended(self) -> bool:
        """Whether the job has ended."""
        return self.status in ENDED


class RayJobs:
    """The job server of one cluster.

    address : of the dashboard, ``http://host:8265``

    Headers for a proxy come from RAY_JOB_HEADERS (JSON). The cluster's token comes from RAY_AUTH_TOKEN, the file
    RAY_AUTH_TOKEN_PATH, or Ray's own ``~/.ray/auth_token``; this last one goes to other machines only with
    RAY_AUTH_MODE=token.

    Raises ``UsageError`` when the address or the request is wrong, ``TransientIOError`` when nobody answers.
    """

    def __init__(self, address: str, environment: Mapping[str, str] | None = None, pause: float = 0.5) -> None:
        parts = urlsplit(address)
        if parts.scheme not in ("http", "https") or not parts.netloc:
            raise UsageError(
                f"{address!r} is not the address of a job server",
                remedy="Name the dashboard of the cluster: http://HOST:8265 (not ray://, that is for drivers).",
            )
        self.address = address.rstrip("/")
        self._headers = _headers(os.environ if environment is None else environment, parts.hostname or "")
        self._pause = pause

    def version(self) -> str:
        """Return the version of Ray on the cluster."""
        answer = self._ask("GET", "/api/version")
        if "ray_version" not in answer:
            raise UsageError(
                "this is not a job server of Ray", where=self.address, remedy="Name the dashboard's address."
            )
        return str(answer["ray_version"])

    def upload(self, files: Mapping[str, bytes]) -> str:
        """Upload small files as a working directory; return its URI. Equal files are uploaded once."""
        data = io.BytesIO()
        with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in sorted(files.items()):
                entry = zipfile.ZipInfo(name)
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, content)
        package = f"_ray_pkg_{hashlib.sha256(data.getvalue()).hexdigest()[:32]}.zip"
        path = f"/api/packages/gcs/{package}"
        if self._ask("GET", path, missing=True) is None:
            self._ask("PUT", path, data.getvalue())
        return f"gcs://{package}"

    def submit(
        self, entrypoint: str, submission_id: str, runtime_env: Mapping[str, Any], metadata: Mapping[str, str]
    ) -> str:
        """Start a command on the head node, without reserving a CPU for it; return the submission id."""
        body = {
            "entrypoint": entrypoint,
            "submission_id": submission_id,
            "runtime_env": dict(runtime_env),
            "metadata": dict(metadata),
            "entrypoint_num_cpus": 0,
        }
        return str(self._ask("POST", "/api/jobs/", json.dumps(body).encode())["submission_id"])

    def state(self, job: str) -> JobState | None:
        """Return the state of a job; None if no job has this id."""
        answer = self._ask("GET", f"/api/jobs/{quote(job, safe='')}", missing=True)
        if answer is None:
            return None
        code = answer.get("driver_exit_code")
        return JobState(str(answer["status"]), str(answer.get("message") or ""), None if code is None else int(code))

    def log(self, job: str) -> str:
        """Return everything that the job's command has printed so far."""
        answer = self._ask("GET", f"/api/jobs/{quote(job, safe='')}/logs", missing=True)
        return "" if answer is None else str(answer.get("logs") or "")

    def _ask(self, method: str, path: str, body: bytes | None = None, *, missing: bool = False) -> Any:
        """Send a request; return the JSON of the answer ({} if empty, None for 404 if `missing`)."""
        fault = ""
        for attempt in range(TRIES):
            if attempt:
                if method != "GET" and NOT_YET not in fault:
                    break
                time.sleep(self._pause * 2**attempt)
            request = urllib.request.Request(self.address + path, body, self._headers, method=method)
            if body is not None:
                kind = "application/json" if method == "POST" else "application/octet-stream"
                request.add_header("Content-Type", kind)
            try:
                with urllib.request.urlopen(request, timeout=TIMEOUT_SECONDS) as answer:
                    data = answer.read(MAX_BYTES)
                return json.loads(data) if data.strip() else {}
            except urllib.error.HTTPError as error:
                said = error.read(4096).decode(errors="replace").strip()
                if error.code == 404 and missing:
                    return None
                if error.code < 500:
                    remedy = "Check the token." if error.code in (401, 403) else ""
                    last = said.splitlines()[-1] if said else error.reason
                    raise UsageError(f"refused ({error.code}): {last}", where=self.address, remedy=remedy) from error
                fault = f"{error.code} {said.splitlines()[-1] if said else error.reason}"
            except json.JSONDecodeError as error:
                raise UsageError("this is not a job server of Ray", where=self.address + path) from error
            except (urllib.error.URLError, OSError) as error:
                fault = str(getattr(error, "reason", error))
        raise TransientIOError(
            f"the job server does not answer: {fault}",
            where=self.address + path,
            remedy="Check that the cluster is up and this address can be reached.",
        )


def _headers(environment: Mapping[str, str], host: str) -> dict[str, str]:
    headers: dict[str, str] = {}
    if text := environment.get("RAY_JOB_HEADERS"):
        try:
            headers.update({str(name): str(value) for name, value in json.loads(text).items()})
        except (ValueError, AttributeError) as error:
            raise UsageError(
                "RAY_JOB_HEADERS is not a JSON object", remedy='Example: {"Authorization": "…"}'
            ) from error
    token = environment.get("RAY_AUTH_TOKEN", "")
    path = environment.get("RAY_AUTH_TOKEN_PATH", "")
    mode = environment.get("RAY_AUTH_MODE", "").lower()
    own = Path(environment.get("HOME", "/nonexistent"), ".ray", "auth_token")
    if not token and not path and own.is_file() and (mode == "token" or (not mode and host in LOOPBACK)):
        path = str(own)
    if not token and path:
        try:
            token = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise UsageError("the token can't be read", where=path, remedy="See RAY_AUTH_TOKEN_PATH.") from error
    if token.strip():
        headers["Authorization"] = f"Bearer {token.strip()}"
    return headers
