"""Episode rows of a snapshot → the files that other people's loaders read."""
