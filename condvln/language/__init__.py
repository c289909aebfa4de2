"""Style measures of instruction texts, ours or any VLN file's: lengths, variety, phrases to avoid."""

from condvln.language.report import LanguageReport, language_report
from condvln.language.texts import InstructionText, read_texts

__all__ = ["InstructionText", "LanguageReport", "language_report", "read_texts"]
