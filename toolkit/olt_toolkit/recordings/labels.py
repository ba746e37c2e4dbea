"""What people say of a recording: the long-tail category that it shows, and the training split that it belongs to."""

from typing import Literal

Split = Literal["train", "val", "test"]
DEFAULT_SPLIT: Split = "train"
"""Of a clip that is built of a recording that is in none."""

UNLABELLED = "unlabelled"
"""Category of what nobody sorted: never taken for nominal."""
