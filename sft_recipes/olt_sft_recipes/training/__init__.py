"""Two-stage training of the toy policy on a mixture."""
