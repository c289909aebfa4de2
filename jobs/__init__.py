"""The verbs a person or a scheduler runs; the one place that wires the rest together."""
