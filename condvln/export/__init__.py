"""Export: write a snapshot's episodes to the file formats that other projects' loaders read."""
