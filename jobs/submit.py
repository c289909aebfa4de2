"""``condvln submit``: run a verb as a Ray Job on a cluster, follow its log, and return its exit code.

The configuration is read, checked and resolved on this machine, with its environment variables and ``--set`` options.
Folders are shipped as absolute paths. Each folder must exist under the same path on the cluster, and so must the store
unless it is an object store. Secrets are not shipped; the cluster has its own.
"""

from __future__ import annotations

import secrets
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import yaml

from condvln.own_tables import own_text
from factory.job_server import PAUSE_SECONDS, JobServer
from jobs.configuration import load_config
from jobs.report import Report

__all__ = ["VERBS", "run_submit"]

VERBS: Final = ("sources", "plan", "generate", "status", "export", "verify", "query", "show")
"""Verbs that can be submitted: those that take a configuration."""

SHIPPED: Final = "condvln.yaml"
"""Name of the configuration in the job's working directory."""

LAUNCHER: Final = "condvln.sh"
"""Name of the script in the job's working directory that finds `condvln` on the cluster."""

# PATH of a job is that of whoever ran `ray start`, often without the environment's own folder. But the parent of a
# job's shell is Ray's Python (`exec` in the entrypoint keeps it so), and on Linux its memory map names its files.
FIND_AND_RUN: Final = own_text("jobs", "find_and_run.sh")

POLL_SECONDS: Final = 2.0

INTERRUPTED: Final = 130
"""Exit code after Ctrl-C, by the convention of shells; the job goes on."""

UNKNOWN: Final = 1
"""Exit code for a job that ended without one: it was stopped, or lost with its node."""


def run_submit(
    config: Path,
    verb: str,
    arguments: Sequence[str] = (),
    *,
    address: str,
    overrides: Sequence[str] = (),
    job: str | None = None,
    follow: bool = True,
    say: Callable[[str], None] = lambda text: print(text, end="", flush=True),
    poll: float = POLL_SECONDS,
    pause: float = PAUSE_SECONDS,
) -> Report:
    """Submit a job, and follow it to its end unless `follow` is off. The report's exit code is the job's.

    verb, arguments : one of `VERBS`, and further words of its command line; the caller has checked them
    job : submission id; a job that is there under it already is followed, not submitted twice
    say : gets the job's output as it comes
    poll : seconds between looks at the job; pause : first pause before a request is repeated, seconds
    """
    resolved = load_config(config, overrides, check_roots=False)
    server = JobServer(address, pause)
    name = job or f"condvln-{resolved.name}-{verb}-{secrets.token_hex(4)}"
    state = server.state(name) if job is not None else None
    if state is None:
        if isinstance(resolved.store, Path):
            say(f"the store is a folder: every node of the cluster must see {resolved.store}\n")
        settings = yaml.safe_dump(resolved.model_dump(mode="json", exclude_defaults=True), sort_keys=False)
        files = {SHIPPED: settings, LAUNCHER: FIND_AND_RUN}
        name = server.submit(entrypoint(verb, arguments), name, files, {"condvln": resolved.name, "verb": verb})
        say(f"job {name} on {server.address}\n")
    document: dict[str, Any] = {"job": name, "address": server.address}
    if not follow:
        return Report({**document, "status": "SUBMITTED"}, [f"follow it with --id {name}"])
    try:
        state = server.follow(name, say, poll)
    except KeyboardInterrupt:
        hint = f"job {name} goes on; follow it again with --id {name}"
        return Report({**document, "status": "RUNNING"}, [hint], exit_code=INTERRUPTED)
    status, message, code = state.status.value, state.message or "", state.driver_exit_code
    lines = [message] if code is None and message else []
    if code is None:
        code = 0 if status == "SUCCEEDED" else UNKNOWN
    lines.insert(0, f"job {name} {status.lower()}, exit code {code}")
    return Report({**document, "status": status, "message": message}, lines, exit_code=code)


def entrypoint(verb: str, arguments: Sequence[str] = ()) -> str:
    """Return the command line of a job; the command uses the Ray cluster on which the job runs."""
    return "exec " + shlex.join(["sh", LAUNCHER, verb, SHIPPED, *arguments, "--set", "ray.address=auto"])
