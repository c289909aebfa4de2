"""The job server of a Ray cluster, by Ray's own client."""

from __future__ import annotations

import json
import os
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from contextlib import suppress
from functools import partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from schemas.errors import TransientIOError, UsageError

if TYPE_CHECKING:
    from ray.job_submission import JobDetails, JobSubmissionClient

__all__ = ["PAUSE_SECONDS", "JobServer", "token_for"]

PAUSE_SECONDS: Final = 1.0
"""First pause before a request is repeated; each further pause is twice as long. A head that restarts is away for some
seconds."""

REACH_SECONDS: Final = 5.0
"""Timeout of one try of the first connection to the dashboard."""

ANSWER_SECONDS: Final = 60.0
"""Timeout of one request by Ray's client, which itself would wait for ever; the longest sends a configuration."""

TRIES: Final = 4

NOT_YET: Final = "No available agent"
"""What a head answers, with code 500, while its agent starts. Nothing was submitted, so the request is repeated."""


LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")


class JobServer:
    """The job server of one cluster, by Ray's own client; requests are repeated while the head restarts.

    Headers for a proxy come from RAY_JOB_HEADERS (JSON), the cluster's token from RAY_AUTH_TOKEN, RAY_AUTH_TOKEN_PATH
    or Ray's own ``~/.ray/auth_token``; this last one goes to other machines only with RAY_AUTH_MODE=token.

    Raises ``UsageError`` when the address or a request is wrong, ``TransientIOError`` when nobody answers.
    """

    def __init__(self, address: str, pause: float) -> None:
        parts = urlsplit(address)
        if parts.scheme not in ("http", "https") or not parts.netloc:
            raise UsageError(
                f"{address!r} is not the address of a job server",
                remedy="Name the dashboard of the cluster: http://HOST:8265 (not ray://, that is for drivers).",
            )
        self.address = address.rstrip("/")
        self._pause = pause
        headers = _headers(parts.hostname or "")
        # The client waits for minutes where nobody listens.
        self._ask(partial(_reach, self.address), tries=2)
        os.environ["RAY_API_SERVER_ADDRESS"] = self.address  # it wins over the client's argument
        try:
            from ray.job_submission import JobSubmissionClient  # it takes a second
        except ImportError as error:
            raise UsageError(
                f"Ray's job client is not installed ({error})", remedy="Run pip install 'condvln[submit]'."
            ) from error

        self._client: JobSubmissionClient = self._ask(lambda: JobSubmissionClient(self.address, headers=headers))

    def submit(self, command: str, name: str, files: Mapping[str, str], metadata: Mapping[str, str]) -> str:
        """Start a command on the head node, without reserving a CPU for it; return the submission id.

        files : the texts of the job's working directory, by name
        """
        with tempfile.TemporaryDirectory() as folder:
            for file, text in files.items():
                Path(folder, file).write_text(text, encoding="utf-8")
            start = partial(
                self._client.submit_job,
                entrypoint=command,
                submission_id=name,
                runtime_env={"working_dir": folder},
                metadata=dict(metadata),
            )
            return str(self._ask(start, again=NOT_YET))

    def state(self, job: str) -> JobDetails | None:
        """Return the state of a job; None if no job has this id."""
        found: JobDetails | None = self._ask(lambda: self._client.get_job_info(job), missing=True)
        return found

    def log(self, job: str) -> str:
        """Return everything that the job's command has printed so far."""
        return self._ask(lambda: self._client.get_job_logs(job), missing=True) or ""

    def follow(self, job: str, say: Callable[[str], None], poll: float) -> JobDetails:
        """Say what a job prints until it ends; return its last state. `poll` is in seconds."""
        told = 0
        while True:
            # The state first: what is printed before the end is then in the log that is read after it.
            state = self.state(job)
            if state is None:
                raise UsageError(f"the cluster knows no job {job!r} any more", where=self.address)
            log = self.log(job)
            if len(log) > told:
                say(log[told:])
                told = len(log)
            if state.status.is_terminal():
                return state
            time.sleep(poll)

    def _ask(self, call: Callable[[], Any], *, missing: bool = False, again: str = "", tries: int = TRIES) -> Any:
        """Return what a call returns; None for an unknown job, if `missing`.

        again : what the message of a fault must hold for the call to be repeated
        """
        said = ""
        for attempt in range(tries):
            if attempt:
                time.sleep(self._pause * 2**attempt)
            try:
                return _within(ANSWER_SECONDS, call)
            except Exception as error:  # RuntimeError, an error of requests, or of Ray where the token is wrong
                said = str(error).strip() or type(error).__name__
            if missing and "status code 404" in said:
                return None
            if "status code 4" in said or "uthentication" in said:
                raise UsageError(f"refused: {said.splitlines()[-1]}", where=self.address, remedy="Check the token.")
            if again not in said:
                break
        raise TransientIOError(
            f"the job server does not answer: {said.splitlines()[-1]}",
            where=self.address,
            remedy="Check the address; the head of the cluster needs ray[default] and --dashboard-host=0.0.0.0.",
        )


def _within(seconds: float, call: Callable[[], Any]) -> Any:
    """Return what a call returns, or raise what it raises; ``TimeoutError`` where it takes longer.

    The call then goes on in its thread, which the end of this process does not wait for.
    """
    answer: Future[Any] = Future()

    def work() -> None:
        try:
            answer.set_result(call())
        except BaseException as error:
            answer.set_exception(error)

    Thread(target=work, daemon=True).start()
    try:
        return answer.result(seconds)
    except FutureTimeout:
        raise TimeoutError(f"nothing within {seconds:g} s") from None


def _reach(address: str) -> None:
    with suppress(urllib.error.HTTPError):  # somebody answers
        urllib.request.urlopen(f"{address}/api/version", timeout=REACH_SECONDS).close()


def _headers(host: str) -> dict[str, str]:
    """Return the headers of RAY_JOB_HEADERS, and one with the cluster's token, which Ray's client only sends if this
    process found the token when it asked for the first time.
    """
    try:
        given = {str(name): str(value) for name, value in json.loads(os.environ.get("RAY_JOB_HEADERS") or "{}").items()}
    except (ValueError, AttributeError) as error:
        raise UsageError("RAY_JOB_HEADERS is not a JSON object", remedy='Example: {"Authorization": "…"}') from error
    token = token_for(host)
    return {"X-Ray-Authorization": f"Bearer {token}", **given} if token else given


def token_for(host: str) -> str:
    """Return the token of a cluster, empty if there is none."""
    token, path = os.environ.get("RAY_AUTH_TOKEN"), os.environ.get("RAY_AUTH_TOKEN_PATH")
    if token:
        return token.strip()
    if not path and host not in LOOPBACK and os.environ.get("RAY_AUTH_MODE") != "token":
        return ""
    file = Path(path or "~/.ray/auth_token").expanduser()
    return file.read_text(encoding="utf-8").strip() if file.is_file() else ""
