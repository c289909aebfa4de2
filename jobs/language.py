"""``condvln language``: statistics of the wording of instructions, CondVLN's or those of any VLN file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from condvln.language import LanguageReport, language_report, read_texts
from jobs.configuration import load_config
from jobs.report import Report, Section
from jobs.settings import export_folder
from schemas.errors import UsageError

__all__ = ["report_language"]

CONFIG_SUFFIXES: Final = (".yaml", ".yml")


def report_language(target: Path, overrides: Sequence[str] = ()) -> Report:
    """Report statistics of the wording of instructions. `target` is an export, a configuration that names an export, or
    a file of instructions.

    Raises
    ------
    UsageError : the configuration names no export
    InputError : there are no instructions, or they can't be read
    """
    folder = target
    if target.suffix in CONFIG_SUFFIXES:
        config = load_config(target, overrides, check_roots=False)
        folder = export_folder(config, target)
    elif overrides:
        raise UsageError("--set is only for a configuration", where=str(target), remedy="Name the YAML file.")
    found = language_report(read_texts(folder))
    return Report({"path": str(folder), **found.document()}, _lines(found), _sections(found))


def _lines(found: LanguageReport) -> list[str]:
    lines = [
        f"{found.lengths['all'].texts:,} texts; compass words in {found.compass:.0%}, left and right in "
        f"{found.egocentric:.0%}; phrases to avoid in {found.banned_texts:.1%}"
    ]
    if found.lint is not None:
        lines.append(
            f"binding lint: {found.lint['findings']} findings in {found.lint['texts']:,} texts; "
            f"{found.lint['misread']} do not read back to their program"
        )
    if found.asked is not None:
        asked = found.asked
        lines.append(
            f"{asked['several rooms']:.0%} are about several rooms, of which {asked['with a lead']:.0%} send there "
            f"first; of the orders to look, {asked['looks from afar']:.1%} are about a room where one was not sent"
        )
        lines.append(
            f"of the relations, {asked['fixed beside fixed']:.1%} join two fixed things; of the stops and conditions, "
            f"{asked['worth nothing']:.1%} are worth nothing"
        )
    return lines


def _sections(found: LanguageReport) -> list[Section]:
    lengths = [
        (name, one.texts, one.mean, one.median, one.most, one.sentence, f"{one.long_sentences:.1%}")
        for name, one in found.lengths.items()
    ]
    return [
        Section("Lengths", ("texts", "number", "words", "median", "most", "a sentence", "over 25 words"), [*lengths]),
        Section(f"Variety at {found.piece:,} words", ("measure", "share"), [*found.variety.items()]),
        Section(
            f"Most common sentences, nouns masked ({found.templates:.1%} of all differ)",
            ("sentence", "share"),
            [(said, f"{share:.2%}") for said, share in found.common],
        ),
        Section("Phrases to avoid", ("phrase", "times"), [*found.banned.items()]),
    ]
