"""How far away every pixel of the front video is."""
