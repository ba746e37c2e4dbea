"""The long-tail suite: events made by code from a seed, on roads of their own, and suites of scenes as files."""
