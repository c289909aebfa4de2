"""Side-by-side measurements: each module has a ``main`` that prints figures and ratios of one run."""
