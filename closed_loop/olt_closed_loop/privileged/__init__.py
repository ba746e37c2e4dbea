"""A driver that sees the truth of a scene, and how it plans where and how fast to drive."""
