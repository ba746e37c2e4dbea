"""Named situations in which the ego touches somebody, each with who is at fault and why."""
