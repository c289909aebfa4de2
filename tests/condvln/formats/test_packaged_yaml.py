"""YAML by libyaml is YAML by PyYAML's own parser and writer."""

from __future__ import annotations

from importlib.resources import files

import yaml

from condvln.export.consumers import consumer_files
from condvln.export.report import ExportReport
from condvln.formats.packaged_yaml import packaged_yaml
from condvln.instructions.language import LANGUAGES


class Written(yaml.SafeDumper):
    def ignore_aliases(self, data: object) -> bool:
        return True


def test_packaged_documents_are_those_of_the_slow_parser() -> None:
    for code in LANGUAGES:
        text = files("condvln.instructions").joinpath("grammar", f"{code}.yaml").read_text(encoding="utf-8")
        assert packaged_yaml(text) == yaml.safe_load(text)


def test_configurations_of_agents_are_written_as_by_the_slow_writer() -> None:
    """Exports have the same bytes where PyYAML lacks libyaml."""
    report = ExportReport(
        "0" * 32, {"language": "es"}, {"val_unseen": 3}, {"val_unseen": ["mp3d/é: #x"]}, most_steps=500
    )
    texts = consumer_files(report)
    assert len(texts) > 10
    for path, text in texts.items():
        assert text.endswith(yaml.dump(yaml.safe_load(text), Dumper=Written, sort_keys=False)), path
