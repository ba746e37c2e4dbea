"""Planning with the truth of a scene: where to drive, and how fast."""
