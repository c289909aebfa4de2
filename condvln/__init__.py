"""The science: pure functions from a scene to verified episodes, and the metrics."""
