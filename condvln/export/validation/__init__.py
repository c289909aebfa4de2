"""A linter for VLN-CE, ANSR-v1, RxR and R2R files from any source. It finds what would crash a strict loader or skew a
score.
"""

from condvln.export.validation.findings import CODES, Finding, Severity
from condvln.export.validation.folder import EpisodeNavmeshes, Options, validate

__all__ = ["CODES", "EpisodeNavmeshes", "Finding", "Options", "Severity", "validate"]
