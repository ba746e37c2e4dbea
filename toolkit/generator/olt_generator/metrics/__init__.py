"""How close images are to the true ones, and views to each other."""
