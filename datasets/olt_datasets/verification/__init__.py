"""Looks at what was made: clip stores, mixtures and exports."""
