"""Cameras in a scene: images by ray casting, and drives recorded with them."""
