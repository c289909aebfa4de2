"""The bias gate: a guesser that sees only the text and distances must not find the gold leaf more often than chance."""

from condvln.bias.foreign_gate import ForeignReport, judge_files
from condvln.bias.gate import BiasGate, judge, judge_export
from condvln.bias.guessers import usual_truths
from condvln.bias.report import BiasReport, Finding, Uniformity

__all__ = [
    "BiasGate",
    "BiasReport",
    "Finding",
    "ForeignReport",
    "Uniformity",
    "judge",
    "judge_export",
    "judge_files",
    "usual_truths",
]
