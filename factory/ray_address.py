"""The address of a Ray cluster: what it may look like, whether a Ray answers there, and what to do where none does.

Ray itself waits two minutes for an address where nobody answers and then ends the process, so this module asks first:
the TCP port with a short timeout, then ``ray health-check``.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import urlsplit

from schemas.errors import ClusterError, UsageError

__all__ = ["ENVIRONMENT", "check_address", "import_ray", "join"]

ENVIRONMENT: Final = "RAY_ADDRESS"
"""Environment variable that names a cluster for every program that uses Ray."""

PORT_SECONDS: Final = 4.0
"""Timeout of the connection to the port of a cluster, seconds."""

HEALTH_SECONDS: Final = 10.0
"""Timeout of ``ray health-check``, seconds; it takes two on an idle machine."""

CLIENT: Final = "ray://"


def import_ray() -> Any:
    """Return the package ``ray``. Raises ``UsageError`` where it is not installed."""
    try:
        import ray
    except ImportError as error:
        raise UsageError(
            f"Ray can't be imported by this Python ({sys.executable}): {error}",
            remedy="Install it (python -m pip install ray), or work in this process with --inline.",
        ) from error
    return ray


def check_address(address: str, place: str = "ray.address") -> None:
    """Return if a Ray answers at `address`.

    place : where the address comes from, for the error

    Raises
    ------
    UsageError : it is not the address of a cluster
    ClusterError : nobody answers there within 15 seconds
    """
    if address != "auto":
        host, port = _host_and_port(address, place)
        try:
            socket.create_connection((host, port), timeout=PORT_SECONDS).close()
        except OSError as error:
            raise _nobody(address, place, error.strerror or str(error)) from error
    if not address.startswith(CLIENT):
        _check_health(address, place)


def _host_and_port(address: str, place: str) -> tuple[str, int]:
    if address.startswith(("http://", "https://")):
        raise UsageError(
            f"{address!r} is the address of a dashboard, not of a cluster",
            place=place,
            remedy="Name HOST:6379 or auto; a dashboard is for condvln submit --address.",
        )
    try:
        parts = urlsplit("//" + address.removeprefix(CLIENT))
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or port is None or "://" in address.removeprefix(CLIENT):
        raise UsageError(
            f"{address!r} is not the address of a Ray cluster",
            place=place,
            remedy="Name HOST:6379, ray://HOST:10001, auto (the Ray that runs on this machine) or local.",
        )
    return host, port


def _check_health(address: str, place: str) -> None:
    command = [sys.executable, "-m", "ray.scripts.scripts", "health-check"]
    if address != "auto":
        command += ["--address", address]
    environment = {name: value for name, value in os.environ.items() if address == "auto" or name != ENVIRONMENT}
    try:
        found = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=HEALTH_SECONDS, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise _nobody(address, place, f"no answer within {HEALTH_SECONDS:.0f} s") from error
    if found.returncode:
        said = found.stderr.strip().splitlines() or found.stdout.strip().splitlines()
        raise _nobody(address, place, said[-1].partition(": ")[2] or said[-1] if said else "ray health-check failed")


def _nobody(address: str, place: str, why: str) -> ClusterError:
    if "AuthToken" in why:
        return ClusterError(
            f"the Ray at {address} refuses this process ({_sentence(why)})",
            place=place,
            remedy="Set RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH to the token of the cluster.",
        )
    if address == "auto":
        return ClusterError(
            f"no Ray runs on this machine ({_sentence(why)})",
            place=place,
            remedy="Start one (ray start --head), name the address of a cluster, or leave the address out.",
        )
    return ClusterError(
        f"no Ray answers at {address} ({_sentence(why)})",
        place=place,
        remedy="Check the address and that the cluster is up (ray status), and that its port can be reached from here.",
    )


def _sentence(text: str) -> str:
    return text.split(". ")[0].rstrip(".")


def join(address: str, settings: Mapping[str, Any], place: str = "ray.address") -> None:
    """Connect this process to the cluster at `address`.

    settings : arguments of ``ray.init``
    place : where the address comes from, for the error

    Raises
    ------
    UsageError : the address is wrong, Ray is not installed, or it is of another version than the cluster's
    ClusterError : nobody answers, or the cluster refuses
    """
    ray = import_ray()
    check_address(address, place)
    try:
        ray.init(address=address, **settings)
    except (Exception, SystemExit) as error:
        with contextlib.suppress(Exception):
            ray.shutdown()
        raise _refused(error, address, place) from error


def _refused(error: BaseException, address: str, place: str) -> Exception:
    """Return the error to raise for one that ``ray.init`` raised."""
    said = " ".join(str(error).split())
    if "ersion mismatch" in said or "versions are incompatible" in said or "minor versions differ" in said:
        return UsageError(
            f"the cluster at {address} has another version of Ray or of Python than this process: {said}",
            place=place,
            remedy="Run the command in the environment of the cluster, or as a job (condvln submit).",
        )
    if isinstance(error, ImportError):
        return UsageError(
            f"this Ray can't use {address}: {said}",
            place=place,
            remedy="Install ray[client], or name HOST:6379 on a node of the cluster.",
        )
    return ClusterError(
        f"the Ray at {address} refuses this process: {said or type(error).__name__}",
        place=place,
        remedy="Look at ray status on the cluster; a port of the dashboard or of another program is not Ray's.",
    )
