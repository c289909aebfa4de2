"""Verbs as Ray Jobs: shipped, followed, their exit codes passed on; against the protocol, and against Ray itself."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from condvln.compiled import cache_folder
from factory.job_server import token_for
from jobs.command import app
from jobs.configuration import load_config
from jobs.report import Report
from jobs.submit import FIND_AND_RUN, LAUNCHER, VERBS, entrypoint, run_submit
from schemas.config import Config
from schemas.errors import ConfigError, TransientIOError, UsageError
from tests.jobs.job_server import JobServer


@pytest.fixture(autouse=True)
def ray_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a submission sets for Ray's client is gone after each test: a head of a later test would take it over."""
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH", "RAY_API_SERVER_ADDRESS"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[JobServer]:
    found = JobServer(tmp_path / "cluster")
    found.folder.mkdir()
    listening = found.start()
    yield found
    listening.shutdown()


@pytest.fixture
def path(made_run: tuple[Config, Report], tmp_path: Path) -> Path:
    """The configuration of the made run, as a person has it."""
    config, _ = made_run
    path = tmp_path / "run.yaml"
    path.write_text(config.model_dump_json())
    return path


def submit(server: JobServer, *arguments: object, **how: object) -> tuple[Report, str]:
    said: list[str] = []
    times = {"poll": 0.05, "pause": 0.001}
    report = run_submit(*arguments, address=server.address, say=said.append, **times, **how)  # type: ignore[arg-type]
    return report, "".join(said)


def test_a_verb_runs_there_its_log_comes_here_and_its_exit_code_is_ours(server: JobServer, path: Path) -> None:
    report, said = submit(server, path, "plan", ["--json"])
    assert (report.exit_code, report.document["status"]) == (0, "SUCCEEDED"), said
    line = next(line for line in said.splitlines() if line.startswith("{"))
    assert sum(json.loads(line)["counts"].values()) == 2
    assert "the store is a folder" in said
    # A second time the same configuration is not shipped again.
    puts = [asked for asked in server.asked if asked[0] == "PUT"]
    server.instead = "true"
    submit(server, path, "status")
    assert [asked for asked in server.asked if asked[0] == "PUT"] == puts


def test_what_is_shipped_is_the_configuration_as_it_counts_here(
    server: JobServer, path: Path, made_run: tuple[Config, Report], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CONDVLN_SEED", "5")
    server.instead = "true"
    report, _ = submit(server, path, "status", overrides=["ray.deadline_seconds=7"])
    job = report.document["job"]
    monkeypatch.delenv("CONDVLN_SEED")
    found = load_config(server.folder / job / "condvln.yaml", check_roots=False)
    expected = made_run[0].model_copy(update={"seed": 5})
    assert found.model_copy(update={"ray": expected.ray}) == expected
    assert found.ray.deadline_seconds == 7
    body = server.bodies[job]
    assert body["entrypoint"] == "exec sh condvln.sh status condvln.yaml --set ray.address=auto"
    assert body.get("entrypoint_num_cpus", 0) == 0, "the head of a cluster has none"
    assert set(body["runtime_env"]) == {"working_dir"}, "no environment, so no secret, goes along"


def test_a_failing_job_ends_with_its_own_code(server: JobServer, path: Path) -> None:
    report, said = submit(server, path, "query", ["SELECT * FROM nothing"])
    assert (report.exit_code, report.document["status"]) == (1, "FAILED")
    assert "Tables: scenes" in said
    server.hidden, server.instead = True, "exit 1"
    report, _ = submit(server, path, "query", ["SELECT * FROM nothing"])
    assert report.exit_code == 1
    assert "failed with exit code 1" in report.lines[-1]


@pytest.mark.parametrize("code", [3, 4])
def test_codes_beyond_one_are_passed_on(server: JobServer, path: Path, code: int) -> None:
    server.instead = f"echo stopped; exit {code}"
    report, said = submit(server, path, "generate")
    assert (report.exit_code, said.splitlines()[-1]) == (code, "stopped")


def test_an_id_is_followed_and_not_submitted_twice(server: JobServer, path: Path) -> None:
    server.instead = "echo snapshot"
    started, _ = submit(server, path, "status", job="nightly", follow=False)
    assert (started.exit_code, started.document["status"]) == (0, "SUBMITTED")
    followed, said = submit(server, path, "status", job="nightly")
    assert (followed.document["job"], followed.document["status"]) == ("nightly", "SUCCEEDED")
    assert "snapshot" in said
    assert [asked for asked in server.asked if asked[0] == "POST"] == [("POST", "/api/jobs/")]


def test_a_head_that_is_away_for_a_moment_is_waited_for(server: JobServer, path: Path) -> None:
    server.instead = "true"
    server.failing = 2
    assert submit(server, path, "status")[0].exit_code == 0
    server.failing = 100
    with pytest.raises(TransientIOError, match=r"the job server does not answer: .*503"):
        submit(server, path, "status")
    with pytest.raises(
        TransientIOError, match=r"127.0.0.1:1: the job server does not answer: .*refused.*ray\[default\]"
    ):
        run_submit(path, "status", address="http://127.0.0.1:1", pause=0.001)


def test_only_a_head_whose_agent_still_starts_is_asked_again_to_start_a_job(server: JobServer, path: Path) -> None:
    """Any other request that may have been obeyed is not repeated."""
    server.instead = "true"
    server.refusing = 3
    with pytest.raises(TransientIOError, match="503"):
        submit(server, path, "status")
    assert server.refusing == 2
    server.fault = (500, "No available agent to submit job, please try again later.")
    assert submit(server, path, "status", job="two")[0].document["job"] == "two"


def test_a_head_that_never_answers_is_given_up(server: JobServer, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server.instead, server.silent = "true", "/logs"
    monkeypatch.setattr("factory.job_server.ANSWER_SECONDS", 0.2)
    with pytest.raises(TransientIOError, match=r"does not answer: nothing within 0\.2 s"):
        submit(server, path, "status")


def test_without_rays_job_client_the_extra_is_named(
    server: JobServer, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray.job_submission", None)
    with pytest.raises(UsageError, match=r"condvln\[submit\]"):
        submit(server, path, "status")


def test_interrupted_the_job_goes_on(server: JobServer, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    server.instead = "sleep 0.2; echo done > here"
    monkeypatch.setattr("time.sleep", interrupt)
    report, _ = submit(server, path, "generate")
    assert report.exit_code == 130
    assert report.document["job"] in report.lines[0]
    process = server.jobs[report.document["job"]]
    assert process.wait() == 0
    assert (server.folder / report.document["job"] / "here").exists()


def test_headers_come_from_the_environment(server: JobServer, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server.instead = "true"
    monkeypatch.setenv("RAY_JOB_HEADERS", '{"Authorization": "Basic x"}')
    submit(server, path, "status")
    assert server.headers.get("Authorization") == "Basic x"
    monkeypatch.setenv("RAY_JOB_HEADERS", "x")
    with pytest.raises(UsageError, match="not a JSON object"):
        submit(server, path, "status")


def test_the_token_of_a_cluster_here_is_sent_whenever_it_was_made(
    server: JobServer, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ray's client keeps in memory that there was no token; another process may have made one since."""
    server.instead = "true"
    monkeypatch.setenv("HOME", str(tmp_path))
    submit(server, path, "status")
    assert server.headers.get("X-Ray-Authorization") is None
    (tmp_path / ".ray").mkdir()
    (tmp_path / ".ray" / "auth_token").write_text("a" * 32 + "\n")
    submit(server, path, "status")
    assert server.headers.get("X-Ray-Authorization") == "Bearer " + "a" * 32
    monkeypatch.setenv("RAY_AUTH_TOKEN", "b" * 32)
    submit(server, path, "status")
    assert server.headers.get("X-Ray-Authorization") == "Bearer " + "b" * 32


def test_the_token_of_this_machine_goes_to_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".ray").mkdir()
    (tmp_path / ".ray" / "auth_token").write_text("a" * 32)
    assert token_for("localhost") == "a" * 32
    assert token_for("ray.example.org") == ""
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    assert token_for("ray.example.org") == "a" * 32


@pytest.mark.parametrize(
    ("verb", "arguments", "said"),
    [
        ("fly", [], "can't be submitted"),
        ("submit", [], "can't be submitted"),
        ("demo", [], "can't be submitted"),
        ("generate", ["--sideways"], "No such option"),
        ("generate", ["another"], "unexpected extra argument"),
        ("plan", ["--", "--help"], "is not submitted"),
    ],
)
def test_a_wrong_command_line_is_told_before_anything_is_sent(
    server: JobServer, path: Path, verb: str, arguments: list[str], said: str
) -> None:
    told = CliRunner().invoke(app, ["submit", "--address", server.address, str(path), verb, *arguments])
    assert isinstance(told.exception, UsageError), told.output
    assert said in str(told.exception)
    assert server.asked == []


def test_a_wrong_configuration_or_address_is_told_before_anything_is_sent(server: JobServer, path: Path) -> None:
    with pytest.raises(ConfigError, match="'colour' is unknown"):
        submit(server, path, "plan", overrides=["colour=red"])
    assert server.asked == []
    for address in ("ray://host:10001", "host:8265", "auto"):
        with pytest.raises(UsageError, match="not the address of a job server"):
            run_submit(path, "plan", address=address)


def test_every_verb_that_takes_a_configuration_can_be_submitted() -> None:
    commands = get_command(app).commands  # type: ignore[attr-defined]
    takes = {
        name
        for name, command in commands.items()
        if command.params and (command.params[0].metavar or "").startswith("CONFIG")
    }
    assert {*VERBS} <= takes
    # These need what is on this machine: a screen, a file, a path to write to.
    assert takes - {*VERBS} <= {"submit", "explore", "language", "render", "trajectories"}


def test_words_survive_the_shell() -> None:
    words = shlex.split(entrypoint("query", ["SELECT 'it''s' AS \"a b\"; -- $HOME"]))
    assert words[5] == "SELECT 'it''s' AS \"a b\"; -- $HOME"


def _without_our_paths() -> dict[str, str]:
    """The environment of a service: nothing of this process leads to the command or to compiled kernels."""
    kept = ("HOME", "TMPDIR", "LANG", "PYTHONPATH")
    return {"PATH": "/usr/bin:/bin", **{name: os.environ[name] for name in kept if name in os.environ}}


@pytest.mark.parametrize(
    ("path", "code", "said"), [("bin", 7, "status x"), ("empty", 127, "environment that runs Ray")]
)
def test_the_launcher_falls_back_on_path_and_says_what_is_missing(
    tmp_path: Path, path: str, code: int, said: str
) -> None:
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin" / "condvln"
    command.write_text('#!/bin/sh\necho "$@"; exit 7\n')
    command.chmod(0o755)
    (tmp_path / LAUNCHER).write_text(FIND_AND_RUN)
    # Between this process, which may have loaded Ray, and the script: a shell that has not.
    words = f"sh {LAUNCHER} status x; exit $?"
    environment = {"PATH": f"{tmp_path / path}:/usr/bin:/bin"}
    done = subprocess.run(words, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert said in done.stdout + done.stderr


def _kernels() -> dict[Path, int]:
    """Files of compiled kernels, with their inodes: a kernel that is compiled again is written to a new file."""
    folder = cache_folder()
    return {path: path.stat().st_ino for path in folder.rglob("*.nbc")}


@pytest.fixture
def head(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Address of Ray's own job server, started as ``.venv/bin/ray start`` with nothing of ours on PATH and a token of
    its own, whatever other tests start.
    """
    token = tmp_path / "token"
    token.write_text("c" * 32)
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(token))
    environment = {**_without_our_paths(), "RAY_AUTH_TOKEN_PATH": str(token), "RAY_AUTH_MODE": "token"}
    with ExitStack() as held:
        free = [held.enter_context(socket.socket()) for _ in range(3)]
        for one in free:
            one.bind(("127.0.0.1", 0))
        port, dashboard, agent = (one.getsockname()[1] for one in free)
    temporary = Path(tempfile.mkdtemp(prefix="ray-", dir="/tmp"))  # Ray's sockets need a short path
    command = [str(Path(sys.executable).parent / "ray"), "start", "--head", "--block", "--num-cpus=2"]
    command += [f"--port={port}", f"--dashboard-port={dashboard}", f"--dashboard-agent-listen-port={agent}"]
    command += ["--dashboard-host=127.0.0.1", f"--temp-dir={temporary}", "--disable-usage-stats"]
    command += [
        "--min-worker-port=0",
        "--max-worker-port=0",
    ]  # any free port: others may hold those of the default range
    log = temporary / "head.log"
    with (
        log.open("wb") as out,
        subprocess.Popen(command, env=environment, stdout=out, stderr=subprocess.STDOUT) as process,
    ):
        address = f"http://127.0.0.1:{dashboard}"
        try:
            for _ in range(30):
                try:
                    urllib.request.urlopen(f"{address}/api/version", timeout=5).close()
                    break
                except OSError:
                    assert process.poll() is None, log.read_text()[-3000:]
                    time.sleep(1)
            yield address
        finally:
            process.terminate()
            process.wait(120)
            shutil.rmtree(temporary, ignore_errors=True)


@pytest.mark.soak
@pytest.mark.ray
def test_rays_own_job_server_runs_a_rebuild(head: str, dataset: Path, configured: object, tmp_path: Path) -> None:
    """The same snapshot as by the command here, which compiles no kernel that the job has compiled."""
    config = configured(dataset)  # type: ignore[operator]
    path = tmp_path / "run.yaml"
    path.write_text(config.model_dump_json())
    said: list[str] = []
    done = run_submit(path, "generate", ["--if-changed", "--json"], address=head, say=said.append, poll=0.5)
    assert done.exit_code == 0, "".join(said)[-3000:]
    document = json.loads("".join(said).strip().splitlines()[-1])
    assert (document["published"], document["counts"]["made"]) == (True, 2)
    compiled = _kernels()
    assert compiled
    here = [str(Path(sys.executable).parent / "condvln"), "generate", str(path), f"--set=store={tmp_path / 'here'}"]
    inline = subprocess.run(
        [*here, "--json"], env=_without_our_paths(), capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert inline.returncode == 0, inline.stderr[-3000:]
    assert json.loads(inline.stdout)["snapshot_id"] == document["snapshot_id"]
    assert _kernels() == compiled
    scene = dataset / "configs" / "scenes" / "made_001.scene_instance.json"
    scene.write_bytes(scene.read_bytes()[:100])
    assert run_submit(path, "generate", address=head, say=said.append, poll=0.5).exit_code == 3
    assert _kernels() == compiled
