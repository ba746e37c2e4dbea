"""Looks at data, checkpoints, versions, disk, memory and steps of a training before it is launched."""
