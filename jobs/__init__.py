"""The verbs that a person or a scheduler runs. Only this package wires the others together."""
