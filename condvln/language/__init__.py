"""How instruction texts are said: lengths, variety, what to avoid; of ours and of any VLN file."""

from condvln.language.report import LanguageReport, language_report
from condvln.language.texts import InstructionText, read_texts

__all__ = ["InstructionText", "LanguageReport", "language_report", "read_texts"]
