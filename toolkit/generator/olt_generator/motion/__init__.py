"""From a front video to a metric, smooth trajectory, and how far it is from the truth."""
