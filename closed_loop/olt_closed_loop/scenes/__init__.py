"""Scenes: invented or recorded, in memory and as OpenUSD stages."""
