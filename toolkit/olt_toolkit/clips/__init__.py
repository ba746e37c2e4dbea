"""Clips in the PhysicalAI-AV layout: what one is, how it is built, stored, drawn and scored."""
