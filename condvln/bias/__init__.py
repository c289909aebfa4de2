"""The bias gate: whoever can't see must not find the right leaf more often than chance does."""

from condvln.bias.gate import judge, judge_export
from condvln.bias.report import BiasReport, Finding, Uniformity

__all__ = ["BiasReport", "Finding", "Uniformity", "judge", "judge_export"]
