"""What a final version of a benchmark freezes: the versions of the code and the configuration that decide its rows.

``python -m jobs.frozen_benchmark configs/benchmark-v1.yaml benchmark-v1`` makes a draft final. The second argument is
the release, or the tag in the repository, by which users find the code that builds it.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import yaml

from condvln.formats.streams import atomic_stream
from jobs.pipeline import code_versions
from schemas.benchmark import BenchmarkFile
from schemas.canonical import digest
from schemas.config import Config
from schemas.errors import UsageError

__all__ = ["freeze", "frozen_parts", "other_parts", "other_versions", "portable"]

_OF_THIS_MACHINE: Final = {"store", "export", "ray", "keep", "limits"}
_PATHS: Final = {"root", "regions", "houses", "connectivity"}
_UNFROZEN: Final = {"name", "sources"}
_DRAFT: Final = "-draft"


def portable(config: Config) -> dict[str, Any]:
    """Return the part of the configuration that affects rows, without paths of this machine."""
    document = config.model_dump(mode="json", exclude=_OF_THIS_MACHINE)
    document["sources"] = [
        {key: value for key, value in source.items() if key not in _PATHS} for source in document["sources"]
    ]
    return document


def frozen_parts(config: Config) -> dict[str, str]:
    """Return the SHA-256 of each section of the configuration that affects rows, and of the sources of each family
    (``sources.<family>``).
    """
    document = portable(config)
    families: dict[str, list[Any]] = {}
    for source in document["sources"]:
        families.setdefault(f"sources.{source['family']}", []).append(source)
    sections = {key: value for key, value in document.items() if key not in _UNFROZEN}
    return {name: digest(value) for name, value in sorted({**sections, **families}.items())}


def other_versions(theirs: Mapping[str, int], here: Mapping[str, int], where: str) -> str:
    """Return the versions `here` that differ from `theirs`, as text; `where` says whose the latter are."""
    names = [*here, *(name for name in theirs if name not in here)]
    return ", ".join(
        f"{name} {here.get(name, 'none')} ({where}: {theirs.get(name, 'none')})"
        for name in names
        if here.get(name) != theirs.get(name)
    )


def other_parts(file: BenchmarkFile, config: Config) -> list[str]:
    """Return the parts of the configuration that are not as a final version froze them. A family without a source does
    not count: not everyone has every dataset.
    """
    here = frozen_parts(config)
    missing = {name for name in file.configuration.keys() - here.keys() if not name.startswith("sources.")}
    return sorted(missing | {name for name, value in here.items() if file.configuration.get(name) != value})


def freeze(path: Path, file: BenchmarkFile, config: Config, release: str) -> BenchmarkFile:
    """Make a draft final: rewrite its file with the present configuration and the name of the release.

    Raises
    ------
    UsageError : the version is final already, or was drafted for other versions of the code
    """
    if not file.draft:
        raise UsageError(f"{file.benchmark} {file.version} is final already", where=str(path))
    other = other_versions(file.stages, code_versions(config), "in the draft's file")
    if other:
        raise UsageError(
            f"the draft is of other versions of the code: {other}", where=str(path), remedy="Update the draft first."
        )
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"(?m)^version: .*$", f"version: {file.version.removesuffix(_DRAFT)}", text)
    text = re.sub(r"(?m)^draft: true$", f"draft: false\nrelease: {release}", text)
    parts = "".join(f"  {name}: {value}\n" for name, value in frozen_parts(config).items())
    text = f"{text.rstrip()}\n# SHA-256 of each part of the run's configuration that decides rows.\n"
    text += f"configuration:\n{parts}"
    final = BenchmarkFile.model_validate(yaml.safe_load(text))
    with atomic_stream(path) as stream:
        stream.write(text.encode())
    return final


def main() -> None:
    """Make a draft final; see `freeze`."""
    from jobs.benchmark import Benchmark

    parser = argparse.ArgumentParser(description="Make the draft of a benchmark final.")
    parser.add_argument("benchmark", type=Path, help="benchmark file, such as configs/benchmark-v1.yaml")
    parser.add_argument("release", help="release or tag of the repository that has this version's code")
    asked = parser.parse_args()
    draft = Benchmark.read(asked.benchmark, check_roots=False)
    final = freeze(asked.benchmark, draft.file, draft.config, asked.release)
    print(f"{final.benchmark} {final.version} is final; its code is {final.release}")


if __name__ == "__main__":
    main()
