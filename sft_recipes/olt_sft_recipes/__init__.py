"""Recipes, the toy policy, and two-stage fine-tuning."""
