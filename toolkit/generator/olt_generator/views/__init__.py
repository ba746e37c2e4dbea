"""Views of other cameras, made from what the front camera saw."""
