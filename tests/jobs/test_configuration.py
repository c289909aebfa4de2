"""The configuration file: overrides in their order, faults named by key, folders resolved from the file's own."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from jobs.configuration import load_config
from jobs.export_origin import remember_data
from schemas.config import Config, InstructionsConfig, RayConfig, SamplingConfig, SourceConfig
from schemas.errors import ConfigError

MINIMAL = {"name": "toy", "store": "store", "sources": [{"family": "replicacad", "root": "data"}]}


def cell(other: dict[str, object] | None = None, **bounds: object) -> dict[str, object]:
    """A configuration's part that asks for a simple cell of these bounds, and for another."""
    cells = [{"category": "simple", "count": 1, **b} for b in (bounds, other) if b is not None]
    return {"instructions": {"cells": cells}}


@pytest.fixture
def written(tmp_path: Path):
    (tmp_path / "data").mkdir()

    def write(**changes: object) -> Path:
        path = tmp_path / "run.yaml"
        path.write_text(yaml.safe_dump({**MINIMAL, **changes}))
        return path

    return write


def test_folders_count_from_the_file(written, tmp_path: Path) -> None:
    config = load_config(written(export="out"), environment={})
    assert (config.store, config.export) == (tmp_path / "store", tmp_path / "out")
    assert config.sources[0].root == tmp_path / "data"


def test_set_wins_over_environment_wins_over_file(written) -> None:
    path = written(seed=1, ray={"workers": 1})
    environment = {"CONDVLN_SEED": "2", "CONDVLN_RAY__WORKERS": "3", "CONDVLN_REAL_DATA": "/elsewhere"}
    assert load_config(path, environment={}).seed == 1
    assert load_config(path, environment=environment).seed == 2
    config = load_config(path, ["seed=4"], environment)
    assert (config.seed, config.ray.workers) == (4, 3)


def test_the_style_of_the_paper_is_other_defaults_and_what_is_given_stays(written) -> None:
    natural = load_config(written(), [], {})
    assert (natural.instructions.leads, natural.thresholds.sector_within, natural.sampling.purpose) == (0.7, 3.0, 1.0)
    paper = load_config(written(instructions={"style": "paper"}, sampling={"compass_phrases": 3}), [], {})
    assert (paper.instructions.leads, paper.thresholds.sector_within, paper.sampling.purpose) == (0.0, 100.0, 0.0)
    assert (paper.sampling.moves, paper.sampling.compass_phrases) == ((0.4, 0.4, 0.2), 3)
    made = Config(
        name="made",
        store="store",  # type: ignore[arg-type]
        sources=(SourceConfig(family="ithor", root="data"),),  # type: ignore[arg-type]
        instructions=InstructionsConfig(style="paper"),
        sampling=SamplingConfig(compass_phrases=3),
    )
    assert (made.instructions.leads, made.sampling) == (0.0, paper.sampling), "sections made in Python are heard too"
    asked = load_config(written(), ["instructions.style=paper"], {})
    assert asked.sampling == paper.sampling.model_copy(update={"compass_phrases": 8})


def test_set_reaches_into_lists(written, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    assert load_config(written(), ["sources.0.root=other"], {}).sources[0].root == tmp_path / "other"


def test_a_folder_that_is_gone_is_where_data_said_when_the_export_was_made(
    written, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(export="out/export", sources=[{"family": "replicacad", "root": "nowhere"}])
    (tmp_path / "out").mkdir()
    remember_data(tmp_path / "out/export", {"replicacad": tmp_path / "data"})
    assert load_config(path, environment={}).sources[0].root == tmp_path / "data"
    assert f"nowhere does not exist; scenes are read in {tmp_path / 'data'}" in capsys.readouterr().err
    (tmp_path / "data").rmdir()
    with pytest.raises(ConfigError, match="no such folder"):
        load_config(path, environment={})


ALLOWED = {"top": Config, "sources": SourceConfig, "ray": RayConfig}
WRONG = yaml.safe_load(Path(__file__).with_name("wrong_configurations.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("wrong", WRONG, ids=[case["message"].split(":")[0] for case in WRONG])
def test_a_wrong_key_is_named_with_what_it_must_be(written, wrong) -> None:
    path = written(**wrong["keys"])
    with pytest.raises(ConfigError) as caught:
        load_config(path, [], {})
    message = wrong["message"]
    for name, section in ALLOWED.items():
        message = message.replace(f"<{name}>", ", ".join(section.model_fields))
    assert str(caught.value) == f"{path}: {message}"
    assert all(word not in wrong["message"] for word in ("Input", "Tuple", "validation", "Value error"))


@pytest.mark.parametrize(
    ("changes", "overrides", "named", "remedy"),
    [
        ({}, ["ray.wokers=2"], "ray.wokers: the key 'wokers' is unknown", "Did you mean workers?"),
        ({}, ["seed"], "not of the form", "--set ray.workers=2"),
        ({}, ["sources.7.root=x"], "there is no entry '7' in a list of 1", "Entries count from 0"),
        ({}, ["store.x=1"], "'store' holds a value, not keys", "Name a key inside a section"),
        ({}, ["seed=" + "[" * 5000], "--set seed: the value is not YAML", "in quotes"),
        ({}, ["seed=" + "9" * 5000], "--set seed: the value is not YAML: Exceeds the limit", "in quotes"),
        ({}, ["name=2026-13-01"], "--set name: the value is not YAML: month must be in 1..12", "in quotes"),
        ({"sources": [{"family": "replicacad", "root": "nowhere"}]}, [], "no such folder", "--data replicacad=DIR"),
        ({"store": "data"}, [], "store", "a folder of its own"),
        ({"store": "data/../data/store"}, [], "sources.0.root", "a folder of its own"),
        ({"export": "data/export"}, [], "export", "a folder of its own"),
        ({"export": "store/export"}, [], "is in store", "a folder of its own"),
    ],
)
def test_faults_name_the_key_and_what_is_allowed(written, changes, overrides, named, remedy) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(written(**changes), overrides, {})
    assert named in str(caught.value)
    assert remedy in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file holds no keys. Start from configs/replicacad.yaml."),
        ("- a", "the file holds no keys. Start from configs/replicacad.yaml."),
        ("a: 1\na: 2", "line 2: the key 'a' occurs twice. Keep one of them."),
        ("? [a]\n: b", "line 1: a list or a mapping is used as a key. Write name: value."),
        ("1: 2", "the key 1 is not text. Write name: value."),
        (
            "a:\n\t- x",
            "line 2 column 1: the file is not YAML: found character '\\t' that cannot start any token. Indent with "
            "blanks, not with tabs.",
        ),
        (
            "a: [",
            "line 1 column 5: the file is not YAML: expected the node content, but found '<stream end>'. Correct the "
            "line, or the one before it.",
        ),
        ("[" * 5000, "the file is nested too deeply. Start from configs/replicacad.yaml."),
        ("a: \0", "character 3: the file is not YAML: the character #x00 is not allowed. Remove it."),
        ("name: 2026-13-01", "a value of the file can't be read: month must be in 1..12. Put text in quotes."),
        ("name: !!bool maybe", "a value of the file can't be read: 'maybe'. Put text in quotes."),
        ("\udcff", "byte 0: the file is not UTF-8 text. Save it as UTF-8."),
    ],
)
def test_what_is_not_a_configuration_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(ConfigError) as caught:
        load_config(path, [], {})
    assert str(caught.value) == f"{path}: {message}"


def test_a_section_without_keys_takes_what_is_set(written) -> None:
    assert load_config(written(ray=None), ["ray.workers=2"], {}).ray.workers == 2


def test_bounds_of_cells_are_taken_as_written(written) -> None:
    config = load_config(written(**cell(route=[5, 12.5], words=[30, 30], other={"route": [5, 12]})), [], {})
    first, second = config.instructions.cells
    assert (first.route, first.words) == ((5.0, 12.5), (30, 30))
    assert (second.route, second.words) == ((5.0, 12.0), None)


def test_shipped_configurations_are_valid(repository: Path) -> None:
    paths = sorted((repository / "configs").glob("*.yaml"))
    assert paths
    for path in paths:
        assert isinstance(load_config(path, environment={}, check_roots=False), Config)


def test_a_value_that_is_endless_when_written_out_is_told_by_its_beginning(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(
        "a0: &a0 [x]\n" + "".join(f"a{k + 1}: &a{k + 1} [{f'*a{k}, ' * 9}]\n" for k in range(30)) + "seed: *a30"
    )
    with pytest.raises(ConfigError, match="seed") as caught:
        load_config(path, environment={})
    assert len(str(caught.value)) < 10_000
