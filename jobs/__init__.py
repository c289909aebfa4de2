"""The verbs that a person or a scheduler runs. Only this package connects the other packages with each other."""
