"""Mixtures: recipes, what they choose, and the exact samples of every batch."""
