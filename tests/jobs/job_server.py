"""A server on loopback that speaks the Jobs REST API as Ray documents it, and really runs what it is given.

Endpoints and fields are those of Ray's OpenAPI page (``/api/version``, ``/api/jobs/…``) and of the upload that
``ray job submit --working-dir`` does (``/api/packages/gcs/…``); answers to faults are those of Ray 2.60's job head.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import threading
import time
import zipfile
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any


@dataclass
class JobServer:
    """What the server knows, and what it was asked.

    failing : so many of the next requests are answered with `fault`; refusing : so many that start a job
    hidden : answers do not tell the exit code, as older versions do
    instead : run this in place of what is submitted
    silent : paths that end so are never answered
    """

    folder: Path
    packages: dict[str, bytes] = field(default_factory=dict)
    jobs: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    bodies: dict[str, dict[str, Any]] = field(default_factory=dict)
    asked: list[tuple[str, str]] = field(default_factory=list)
    headers: dict[str, str] = field(default_factory=dict)
    failing: int = 0
    refusing: int = 0
    fault: tuple[int, str] = (503, "the head restarts")
    hidden: bool = False
    instead: str = ""
    silent: str = "-"
    address: str = ""

    def start(self) -> ThreadingHTTPServer:
        """Listen on a free port of loopback."""
        server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self.address = f"http://127.0.0.1:{server.server_port}"
        threading.Thread(target=server.serve_forever, daemon=True).start()
        return server

    def submit(self, body: dict[str, Any]) -> tuple[int, Any]:
        job = body["submission_id"]
        if job in self.jobs:
            return 400, f"Traceback (most recent call last):\nValueError: Job with submission_id {job} already exists."
        package = body["runtime_env"]["working_dir"].removeprefix("gcs://")
        if package not in self.packages:
            return 400, f"no package {package}"
        place = self.folder / job
        with zipfile.ZipFile(io.BytesIO(self.packages[package])) as archive:
            archive.extractall(place)
        # As on a cluster, where the package is installed: `condvln` is the command of this very environment.
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
        with open(place / "driver.log", "wb") as log:
            self.jobs[job] = subprocess.Popen(
                self.instead or body["entrypoint"],
                shell=True,
                cwd=place,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PATH": path},
            )
        self.bodies[job] = body
        return 200, {"job_id": job, "submission_id": job}

    def details(self, job: str) -> dict[str, Any]:
        code = self.jobs[job].poll()
        status = "RUNNING" if code is None else "SUCCEEDED" if code == 0 else "FAILED"
        message = "" if code in (None, 0) else f"Job entrypoint command failed with exit code {code}"
        return {
            "type": "SUBMISSION",
            "job_id": None,
            "submission_id": job,
            "status": status,
            "message": message,
            "entrypoint": self.bodies[job]["entrypoint"],
            "driver_exit_code": None if self.hidden else code,
        }

    def answer(self, method: str, path: str, body: bytes) -> tuple[int, Any]:
        parts = path.strip("/").split("/")
        if parts == ["api", "version"]:
            return 200, {"version": "4", "ray_version": "2.60.0", "ray_commit": "", "session_name": ""}
        if parts[:3] == ["api", "packages", "gcs"]:
            if method == "PUT":
                self.packages[parts[3]] = body
                return 200, ""
            return (200, "") if parts[3] in self.packages else (404, f"Package gcs://{parts[3]} does not exist")
        if parts == ["api", "jobs"] and method == "POST":
            return self.submit(json.loads(body))
        if parts[:2] == ["api", "jobs"] and len(parts) in (3, 4):
            if parts[2] not in self.jobs:
                return 404, f"Job {parts[2]} does not exist"
            if len(parts) == 3:
                return 200, self.details(parts[2])
            if parts[3] == "logs":
                return 200, {"logs": (self.folder / parts[2] / "driver.log").read_text()}
        return 404, "404: Not Found"


def _handler(server: JobServer) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def _serve(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            server.asked.append((self.command, self.path))
            server.headers = dict(self.headers.items())
            if self.path.endswith(server.silent):
                time.sleep(5)
            starts = self.command == "POST" and server.refusing > 0
            if server.failing or starts:
                server.failing -= not starts
                server.refusing -= starts
                code, answer = server.fault
            else:
                code, answer = server.answer(self.command, self.path, body)
            data = answer.encode() if isinstance(answer, str) else json.dumps(answer).encode()
            self.send_response(code)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        do_GET = do_POST = do_PUT = _serve

        def log_message(self, format: str, *arguments: object) -> None:
            return

    return Handler
