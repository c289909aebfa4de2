"""Training data for navigation agents: walks of episodes, their images, and the layouts that agents' loaders read."""
