"""The public PhysicalAI-AV devkit on a folder of ours."""

import tempfile
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError

REVISION = "0" * 40


def open_devkit(root: Path) -> Any:
    """Open a folder with the devkit, offline. It reads a hub cache only, so a cache is made that points to the folder.

    Raises:
        InputError: the devkit is not installed.
    """
    try:
        import huggingface_hub.constants
        from physical_ai_av import PhysicalAIAVDatasetInterface
    except ImportError as error:
        raise InputError("physical-ai-av is not installed; install the extra `interop`") from error
    cache = Path(tempfile.mkdtemp(prefix="olt-devkit-"))
    snapshots = cache / "datasets--nvidia--PhysicalAI-Autonomous-Vehicles" / "snapshots"
    snapshots.mkdir(parents=True)
    (snapshots / REVISION).symlink_to(root, target_is_directory=True)
    huggingface_hub.constants.HF_HUB_OFFLINE = True
    return PhysicalAIAVDatasetInterface(REVISION, cache_dir=cache, token=False)
