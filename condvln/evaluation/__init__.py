"""Evaluation: from episodes and agents' predictions to metrics, confidence intervals and tables."""
