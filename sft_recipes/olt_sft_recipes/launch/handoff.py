"""A trained policy on its way to the closed loop of AlpaSim (docs/formats/alpasim.md)."""

from pathlib import Path

from olt_generator.errors import InputError
from olt_sft_recipes.launch.torchrun import to_shell

DRIVER = "alpamayo1_5_recipes_sft"
"""AlpaSim's own driver of a Stage 2 folder of the 1.5 recipe (its main branch since August 2026)."""
_KEYS = ("include_camera_ids", "include_frame_nums")


def handoff_lines(policy: str, checkpoint: Path) -> list[str]:
    """Commands, in a clone of AlpaSim, that drive with a Stage 2 folder; empty for R1, of whose folders it has none."""
    if policy != "alpamayo-1.5":
        return []
    words = [
        *("uv", "run", "alpasim_wizard", "deploy=local", "topology=1gpu", "driver=alpamayo1_5"),
        f"driver.model.model_type={DRIVER}",
        # The folder of drivers is what the driver's container sees as /mnt/drivers.
        f"defines.drivers={checkpoint.parent}",
        f"driver.model.checkpoint_path=/mnt/drivers/{checkpoint.name}",
        f"wizard.log_dir={checkpoint.parent.parent / 'alpasim'}",
    ]
    return ["uv sync --extra all --extra recipes", to_shell(words)]


def check_handoff(checkpoint: Path) -> list[str]:
    """Look at a folder before AlpaSim is given it, and give the commands.

    Raises:
        InputError: it is not complete, is no folder of Stage 2, is one of R1, or its `config.json` lacks what the
            driver asks it.
    """
    from olt_sft_recipes.launch.checkpoints import read_checkpoint

    folder = read_checkpoint(checkpoint)
    if not any(name.startswith("expert.") for name in folder.tensors):
        raise InputError(f"{checkpoint}: holds no action expert; give the last checkpoint of Stage 2")
    lacking = [key for key in _KEYS if key not in folder.config]
    if lacking:
        raise InputError(
            f"{checkpoint / 'config.json'}: has no {', '.join(lacking)}, which AlpaSim's driver of Alpamayo 1.5 asks "
            "it; AlpaSim has no driver of an R1 folder from SFT: train Alpamayo 1.5 for it"
        )
    return handoff_lines("alpamayo-1.5", checkpoint.resolve())
