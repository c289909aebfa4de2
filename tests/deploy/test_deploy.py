"""What is deployed: YAML against the schemas of its kind, command lines against the command, metrics against code."""

from __future__ import annotations

import configparser
import json
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import ray
import yaml
from typer.main import get_command

from factory.dispatch import METRICS, RunMetrics
from jobs.command import app
from jobs.configuration import load_config
from jobs.submit import VERBS

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
MANIFESTS = sorted(path.relative_to(DEPLOY).as_posix() for path in DEPLOY.glob("kubernetes/*.yaml"))
MANIFESTS += ["prometheus/podmonitor.yaml"]
SCHEMAS = {
    name: json.loads((Path(__file__).parent / "schemas" / f"{name}.schema.json").read_text())
    for name in ("kubernetes", "kuberay")
}
COMMAND = re.compile(r"(?:^|[\s`'(=/])(?=condvln ([a-z]+ [^`\n]*?--?[^`\n]*|[a-z]+ \S+\.yaml[^`\n]*))")
"""A command line in any of the files: a verb, then a configuration or an option."""


def documents(path: str) -> list[dict[str, Any]]:
    return [found for found in yaml.safe_load_all((DEPLOY / path).read_text(encoding="utf-8")) if found]


def everything() -> list[tuple[str, dict[str, Any]]]:
    return [(path, document) for path in MANIFESTS for document in documents(path)]


def check(document: dict[str, Any]) -> None:
    schema = SCHEMAS["kuberay" if document["apiVersion"].startswith("ray.io/") else "kubernetes"]
    whole = {"$ref": f"#/definitions/{document['kind']}", "definitions": schema["definitions"]}
    jsonschema.Draft7Validator(whole).validate(document)


def paths(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place of a document."""
    yield at
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from paths(inner, (*at, key))


def get(value: Any, at: tuple[Any, ...]) -> Any:
    for key in at:
        value = value[key]
    return value


@pytest.mark.parametrize("path", MANIFESTS)
def test_manifests_are_of_their_kind(path: str) -> None:
    assert documents(path)
    for document in documents(path):
        check(document)


def pods() -> Iterator[tuple[str, dict[str, Any]]]:
    for path, document in everything():
        for at in paths(document):
            if at and at[-1] == "containers":
                yield path, get(document, at[:-1])


def test_no_container_runs_as_root_or_gains_rights() -> None:
    found = [*pods()]
    assert len(found) == 7
    for _, pod in found:
        assert pod["securityContext"]["runAsNonRoot"] is True
        for container in pod["containers"]:
            assert container["securityContext"]["allowPrivilegeEscalation"] is False
            assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
            assert container["resources"]["limits"]["memory"]


def test_what_is_mounted_and_referred_to_is_there() -> None:
    kinds: dict[str, set[str]] = {}
    for _, document in everything():
        kinds.setdefault(document["kind"], set()).add(document["metadata"].get("name", ""))
    for _, pod in pods():
        assert pod["serviceAccountName"] in kinds["ServiceAccount"]
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        for volume in volumes.values():
            if "configMap" in volume:
                assert volume["configMap"]["name"] in kinds["ConfigMap"]
            else:
                assert volume["persistentVolumeClaim"]["claimName"] in kinds["PersistentVolumeClaim"]
        for container in pod["containers"]:
            assert {mount["name"] for mount in container["volumeMounts"]} <= {*volumes}
    secrets = set(re.findall(r"kubectl create secret generic (\S+)", (DEPLOY / "kubernetes/config.yaml").read_text()))
    text = "".join((DEPLOY / path).read_text() for path in MANIFESTS)
    assert set(re.findall(r"(?:secretName|name): (condvln-(?:token|store))\b", text)) == secrets


def clusters() -> Iterator[dict[str, Any]]:
    for _, document in everything():
        spec = document.get("spec", {})
        for found in (spec, spec.get("rayClusterSpec"), spec.get("jobTemplate", {}).get("rayClusterSpec")):
            if found and "headGroupSpec" in found:
                yield found


def test_the_launchers_file_is_what_ray_reads() -> None:
    schema = json.loads((Path(ray.__file__).parent / "autoscaler" / "ray-schema.json").read_text())
    (document,) = documents("ray/cluster.yaml")
    jsonschema.validate(document, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**document, "max_wrokers": 1}, schema)
    assert document["head_node_type"] in document["available_node_types"]


def test_versions_are_those_of_the_lock() -> None:
    lock = (ROOT / "requirements.lock").read_text()
    (version,) = re.findall(r"^ray==(\S+)", lock, re.M)
    assert {cluster["rayVersion"] for cluster in clusters()} == {version}
    (own,) = re.findall(r'^version = "(\S+)"', (ROOT / "pyproject.toml").read_text(), re.M)
    images = {container["image"] for _, pod in pods() for container in pod["containers"]}
    images.add(documents("ray/cluster.yaml")[0]["docker"]["image"])
    assert images == {f"condvln:{own}"}


def test_the_configuration_is_one_and_the_same() -> None:
    config = load_config(DEPLOY / "condvln.yaml", environment={}, check_roots=False)
    (found,) = [d for d in documents("kubernetes/config.yaml") if d["kind"] == "ConfigMap"]
    assert yaml.safe_load(found["data"]["condvln.yaml"]) == yaml.safe_load((DEPLOY / "condvln.yaml").read_text())
    assert str(config.store).startswith("s3://")
    assert all(source.root.is_absolute() for source in config.sources)


# ---- command lines


def command_lines() -> Iterator[tuple[str, list[str]]]:
    """(file, words after ``condvln``) of every command line in the folder."""
    files = [path for path in sorted(DEPLOY.rglob("*")) if path.is_file() and path.suffix != ".json"]
    for path in files:
        where = path.relative_to(DEPLOY).as_posix()
        for line in path.read_text(encoding="utf-8").splitlines():
            for found in COMMAND.findall(line):
                words = shlex.split(re.split(r" \(| \|\|| && | 2>&1", found)[0], comments=True)
                if words and words[0] in get_command(app).commands:  # type: ignore[attr-defined]
                    yield where, words
    for _, document in everything():
        for at in paths(document):
            if at and at[-1] == "command":
                words = get(document, at)
                assert words[0] == "condvln"
                yield "kubernetes/cronjob.yaml", words[1:]


def test_every_command_line_is_understood() -> None:
    commands = get_command(app).commands  # type: ignore[attr-defined]
    found = [*command_lines()]
    assert {where for where, _ in found} >= {
        "README.md",
        "cron/condvln",
        "systemd/condvln-rebuild.service",
        "ray/cluster.yaml",
        "kubernetes/cronjob.yaml",
        "kubernetes/rayjob.yaml",
        "kubernetes/raycronjob.yaml",
    }
    for where, words in found:
        context = commands[words[0]].make_context(words[0], words[1:])
        (needed,) = [name for name in ("config", "target", "out") if name in context.params][:1]
        assert context.params[needed], where
        if words[0] == "submit":
            verb = context.params["verb"]
            assert verb in VERBS
            commands[verb].make_context(verb, [str(context.params["config"]), *(context.params["arguments"] or ())])
    joined = [" ".join(words) for where, words in found if where == "kubernetes/rayjob.yaml"]
    assert any("ray.address=auto" in line for line in joined), "a job joins the cluster that it runs on"


@pytest.mark.parametrize(("code", "good"), [(0, True), (3, True), (4, False), (1, False)])
@pytest.mark.parametrize("path", ["kubernetes/rayjob.yaml", "kubernetes/raycronjob.yaml"])
def test_a_job_forgives_quarantine_and_nothing_else(path: str, code: int, good: bool) -> None:
    """KubeRay (``BuildJobSubmitCommand``) puts the entrypoint unquoted into a shell script of the submitter, behind
    ``ray job submit … --``; Ray joins the words it gets with ``shlex`` and hands them to a shell of its own.
    """
    spec = documents(path)[0]["spec"]
    line = spec.get("jobTemplate", spec)["entrypoint"]
    shell = ["bash", "-c", f"ray() {{ shift; printf '%s\\0' \"$@\"; exit 0; }}; ray -- {line}"]
    submitted = subprocess.run(shell, check=True, capture_output=True, text=True).stdout.split("\0")[:-1]
    # A script that the last of these words starts inherits the function.
    command = f"condvln() {{ return {code}; }}; export -f condvln; {shlex.join(submitted)}"
    ended = subprocess.run(["bash", "-c", command], check=False, capture_output=True).returncode
    assert (ended == 0) is good
    assert any("condvln generate" in word for word in submitted)


# ---- metrics


def expressions() -> Iterator[str]:
    board = json.loads((DEPLOY / "grafana" / "condvln.json").read_text())
    for panel in board["panels"]:
        yield from (target["expr"] for target in panel["targets"])
    for group in documents("prometheus/alerts.yml")[0]["groups"]:
        yield from (rule["expr"] for rule in group["rules"])
    readme = (DEPLOY / "README.md").read_text(encoding="utf-8")
    yield from re.findall(r"`(ray_factory_[^`]*)`", readme)


@pytest.fixture
def tags(monkeypatch: pytest.MonkeyPatch) -> dict[str, set[str]]:
    """Labels of each metric, as the code declares them."""
    found: dict[str, set[str]] = {}

    class Recorded:
        def __init__(self, name: str, description: str, tag_keys: tuple[str, ...] = (), **settings: object) -> None:
            found[name] = {*tag_keys}

    for kind in ("Counter", "Gauge", "Histogram"):
        monkeypatch.setattr(f"ray.util.metrics.{kind}", Recorded)
    RunMetrics()
    return found


def test_every_metric_and_label_exists(tags: dict[str, set[str]]) -> None:
    """Ray puts ``ray_`` before a name; a histogram has ``_bucket``, ``_sum`` and ``_count``."""
    assert set(tags) == set(METRICS)
    used = set()
    for expression in expressions():
        names = re.findall(r"ray_(factory_[a-z_]+)(?:\{([^}]*)\})?", expression)
        assert names, expression
        for name, labels in names:
            base = re.sub(r"_(bucket|sum|count)$", "", name) if "stage_seconds" in name else name
            assert base in METRICS, name
            used.add(base)
            assert set(re.findall(r"(\w+)(?:=|$|,)", labels)) <= tags[base]
        for grouping in re.findall(r"by \(([^)]*)\)", expression):
            assert {label.strip() for label in grouping.split(",")} <= tags[base] | {"le"}, expression
    assert used == set(METRICS), "every metric is shown somewhere"


def test_prometheus_finds_the_rules_and_the_nodes() -> None:
    (found,) = documents("prometheus/prometheus.yml")
    assert all((DEPLOY / "prometheus" / name).is_file() for name in found["rule_files"])
    (monitor,) = documents("prometheus/podmonitor.yaml")
    port = monitor["spec"]["podMetricsEndpoints"][0]["port"]
    for cluster in clusters():
        for template in (cluster["headGroupSpec"], *cluster["workerGroupSpecs"]):
            assert (
                monitor["spec"]["selector"]["matchLabels"].items() <= template["template"]["metadata"]["labels"].items()
            )
            ports = {p["name"]: p["containerPort"] for p in template["template"]["spec"]["containers"][0]["ports"]}
            assert str(ports[port]) == template["rayStartParams"]["metrics-export-port"]


# ---- image and server


def test_the_image_is_slim_runs_as_nobody_special_and_copies_what_is_there() -> None:
    lines = (DEPLOY / "Dockerfile").read_text().splitlines()
    assert all(line.startswith("FROM python:3.11-slim") for line in lines if line.startswith("FROM"))
    users = [line.split()[1] for line in lines if line.startswith("USER")]
    assert users == ["1000"]
    ignored = (DEPLOY / "Dockerfile.dockerignore").read_text().split()
    for line in lines:
        if line.startswith("COPY") and "--from" not in line:
            for source in line.split()[1:-1]:
                assert (ROOT / source).exists(), source
                assert any(rule == f"!{source}" or source.startswith(rule[1:] + "/") for rule in ignored), source
    assert not re.search(r"(SECRET|PASSWORD|TOKEN)\s*=", (DEPLOY / "Dockerfile").read_text())


def test_units_of_systemd_are_whole(tmp_path: Path) -> None:
    units = {}
    for path in sorted((DEPLOY / "systemd").iterdir()):
        parser = configparser.ConfigParser(strict=True, interpolation=None)
        parser.optionxform = str  # type: ignore[assignment, method-assign]
        parser.read(path)
        units[path.suffix] = parser
    service, timer = units[".service"], units[".timer"]
    assert service["Service"]["Type"] == "oneshot", "systemd starts no second one while it runs"
    assert service["Service"]["User"] not in ("", "root")
    assert timer["Install"]["WantedBy"] == "timers.target"
    if shutil.which("systemd-analyze"):
        subprocess.run(["systemd-analyze", "calendar", timer["Timer"]["OnCalendar"]], check=True, capture_output=True)
    (line,) = [row for row in (DEPLOY / "cron" / "condvln").read_text().splitlines() if row.startswith("*")]
    assert line.split()[5] == "condvln", "cron.d names a user"
    started = service["Service"]["ExecStart"].split()
    assert started == line.split("pipefail; ")[1].split(" 2>&1")[0].split()
    # Nothing is redirected: the shell is the user's, who may not write to /var/log, and then it would start nothing.
    assert not re.search(r">(?!&1)", line)


@pytest.mark.parametrize("code", [0, 3])
@pytest.mark.parametrize("path", ["deploy/cron/condvln", "docs/nightly.md"])
def test_a_rebuild_that_fails_under_cron_is_logged_as_an_error(tmp_path: Path, path: str, code: int) -> None:
    """`logger` ends with 0 whatever `condvln` ends with."""
    text = (DEPLOY.parent / path).read_text()
    lines = [
        row.split(" condvln ", 1)[1] for row in text.splitlines() if re.match(r"[*\d][/\d]* [*\d].* condvln ", row)
    ]
    assert text.count("SHELL=/bin/bash") == len(lines) > 0
    for name, does in (("condvln", f"echo made; exit {code}"), ("logger", f'echo "$@" >> {tmp_path}/log; cat 1>&2')):
        (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n")
        (tmp_path / name).chmod(0o755)
    for line in lines:
        (tmp_path / "log").unlink(missing_ok=True)
        command = line.replace("/opt/condvln/bin/", "")
        variables = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
        subprocess.run(
            ["bash", "-c", command], env=variables, check=True, capture_output=True, stdin=subprocess.DEVNULL
        )
        logged = (tmp_path / "log").read_text().splitlines()
        assert logged[0] == "-t condvln"
        assert logged[1:] == ([f"-p user.err -t condvln rebuild ended with {code}"] if code else [])
