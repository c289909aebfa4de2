"""The command: every verb helps, the reference is up to date, faults become one message and their exit code."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from typer.main import get_command
from typer.testing import CliRunner

from condvln.samples import make_samples
from factory.ray_executor import RayExecutor
from factory.snapshot import Snapshot
from factory.store import LocalStore
from jobs.command import REPLACED, VERBS, app, main
from jobs.configuration import load_config
from jobs.report import Report
from jobs.submit import INTERRUPTED
from schemas.config import Config
from schemas.errors import CondVLNError, UsageError
from tests.site_parts import part

runner = CliRunner()
PAGE = part("command")


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from jobs.command import main; main()", *words],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.skipif(os.name != "posix", reason="closes files in the shell")
@pytest.mark.parametrize("closed", [pytest.param("2>&-", marks=pytest.mark.soak), "<&- >&- 2>&-"])
def test_closed_standard_files_cost_nothing(tmp_path: Path, closed: str) -> None:
    """Those of a job that was started without a terminal may be closed; no other file must take their numbers."""
    make_samples(tmp_path / "data", family="replicacad", scenes=2, seed=0)
    config = {
        "name": "closed",
        "store": str(tmp_path / "store"),
        "export": str(tmp_path / "export"),
        "sources": [{"family": "replicacad", "root": str(tmp_path / "data")}],
        "instructions": {"per_category": {"simple": 4}},
        "ray": {"workers": 2},
    }
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(config))
    code = "from jobs.command import main; main()"
    command = shlex.join([sys.executable, "-c", code, "generate", str(tmp_path / "c.yaml")])
    assert subprocess.run(["sh", "-c", f"exec {command} {closed}"], check=False).returncode == 0
    assert Snapshot.open(LocalStore(tmp_path / "store"), "closed").manifest.tables["episodes"].rows


@pytest.mark.parametrize("path", PAGE.command_paths(), ids=" ".join)
def test_every_command_and_option_has_help(path: tuple[str, ...]) -> None:
    result = runner.invoke(app, [*path, "--help"])
    assert result.exit_code == 0
    assert "Usage" in result.output


@pytest.mark.parametrize("name", [verb.__name__ for verbs in VERBS.values() for verb in verbs])
def test_the_help_of_each_verb_ends_with_an_example_that_parses(name: str) -> None:
    """In a terminal of 80 columns no line is longer, and the example is a command line of this verb."""
    said = runner.invoke(app, [name, "--help"], terminal_width=80).output
    assert max(map(len, said.splitlines())) <= 80
    words = shlex.split(said.split("Example: condvln ")[1])
    command = get_command(app).commands[name]  # type: ignore[attr-defined]
    assert words[0] == name
    assert len(words) > 1
    command.make_context(name, words[1:])


def test_the_help_of_the_command_fits_and_names_each_verb_once() -> None:
    said = runner.invoke(app, ["--help"], terminal_width=80).output
    assert max(map(len, said.splitlines())) <= 80
    assert "…" not in said
    assert "..." not in said.split("Options:")[1]
    listed = re.findall(r"^  ([a-z]+)  ", said, re.MULTILINE)
    assert sorted(listed) == sorted({path[0] for path in PAGE.command_paths() if path})


def exit_codes(error: type[CondVLNError]) -> set[int]:
    """Return the exit codes of an error and of all that are derived from it."""
    return {error.exit_code}.union(*(exit_codes(kind) for kind in error.__subclasses__()))


def test_the_help_names_the_exit_codes_of_all_errors() -> None:
    said = " ".join(runner.invoke(app, ["--help"], terminal_width=80).output.split())
    told = said.split("Exit codes: ")[1].split(".")[0]
    assert {*map(int, re.findall(r"\b\d+\b", told))} == exit_codes(CondVLNError) | {0, INTERRUPTED}


def test_the_command_says_its_version() -> None:
    assert runner.invoke(app, ["--version"]).output == f"condvln {version('condvln')}\n"


def test_reference_is_up_to_date() -> None:
    for page, text in PAGE.reference().items():
        assert page.read_text(encoding="utf-8") == text, "run: python docs/site/command.py"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("generate", "nowhere.yaml"), "no such configuration file"),
        (("navmesh", "info", "nowhere.navmesh"), "nowhere.navmesh"),
        (("navmesh", "build", "x.glb", "y.navmesh", "--set", "colour=1"), "no navmesh setting"),
        (("demo", "--scenes", "0"), "--scenes"),
        (("demo", "--workers", "-1"), "--workers"),
    ],
)
def test_faults_are_one_message_and_an_exit_code(words: tuple[str, ...], said: str) -> None:
    result = run(*words)
    assert result.returncode in (1, 3)
    # A first start on a machine may announce that it compiles; the fault itself is the one last line.
    assert said in result.stderr.strip().splitlines()[-1]
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    "words",
    [("demo", "--out", "FILE", "--family", "ithor", "--scenes", "1"), ("export", "FILE", "train", "--oracle")],
    ids=" ".join,
)
def test_a_path_that_leads_nowhere_is_one_message_too(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setattr(sys, "argv", ["condvln", *(str(file) if word == "FILE" else word for word in words)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code in (1, 3)
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith(f"condvln: {file}")
    assert "Check the path" in said


def test_unknown_verb_is_usage() -> None:
    assert run("fly").returncode == 1


def written(config: Config, folder: Path) -> Path:
    path = folder / "run.yaml"
    path.write_text(config.model_dump_json())
    return path


def test_published_snapshot_is_seen_by_every_verb(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    config, report = made_run
    path = str(written(config, tmp_path))
    assert load_config(Path(path), environment={}) == config

    def verb(*words: str) -> dict[str, object]:
        result = runner.invoke(app, [*words, "--json"])
        assert result.exit_code == 0, result.output
        document: dict[str, object] = json.loads(result.stdout)
        return document

    scenes = report.document["counts"]["ok"]
    assert verb("plan", path)["counts"] == {"FRESH": scenes}
    assert verb("query", path, "SELECT count(*) FROM scenes WHERE status = 'ok'")["rows"] == [[scenes]]
    (count,) = verb("query", path, "SELECT count(*) FROM episodes")["rows"]
    shown = verb("show", path, "--sample", "3")["episodes"]
    assert len(shown) == min(3, count[0])
    again = verb("show", path, str(shown[0]["episode_id"]))["episodes"]
    assert again == shown[:1]
    status = verb("status", path)
    assert status["ref"]["snapshot_id"] == report.document["snapshot_id"]
    # One spelling of where scenes lie, for a configuration that names another folder, and for the export alone.
    (source,) = config.sources
    data = ("--data", f"{source.family}={source.root}")
    away = config.model_copy(update={"sources": (source.model_copy(update={"root": tmp_path / "away"}),)})
    moved = str(written(away.model_copy(update={"export": tmp_path / "export"}), tmp_path))
    assert verb("plan", moved, *data)["counts"] == {"FRESH": scenes}
    verb("export", moved, *data)
    proof = verb("verify", str(tmp_path / "export"), *data)
    assert proof["proven"] == verb("verify", moved, *data)["proven"] > 0
    # On the machine that made an export, its scenes are found without a word.
    assert verb("verify", str(tmp_path / "export")) == proof


@pytest.mark.parametrize("verb", sorted(REPLACED))
def test_a_verb_of_an_older_release_names_the_new_one(verb: str) -> None:
    result = runner.invoke(app, [verb, "x"])
    assert isinstance(result.exception, UsageError)
    assert f"Use condvln {REPLACED[verb]}." in str(result.exception)


def test_what_ray_says_is_not_in_the_report(
    made_run: tuple[Config, Report], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def enter(executor: RayExecutor) -> RayExecutor:
        print("(raylet) Raylet is terminated.")  # as Ray does on standard output when a node is lost
        return executor

    monkeypatch.setattr(RayExecutor, "__enter__", enter)
    result = runner.invoke(
        app, ["generate", str(written(made_run[0], tmp_path)), "--json", "--set", "ray.address=local"]
    )
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["snapshot_id"] == made_run[1].document["snapshot_id"]
    assert "(raylet) Raylet is terminated." in result.stderr
