"""Scenes: invented or recorded, in memory and as scene files in OpenUSD."""
