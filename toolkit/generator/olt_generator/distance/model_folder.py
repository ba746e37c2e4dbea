"""Networks in local folders as transformers and diffusers write them, loaded without a connection or foreign code."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError


def check_model_folder(folder: Path, files: Sequence[str]) -> None:
    """Raise an `InputError` where a folder of a network, or a file that is needed to load it, is missing."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; download the network and give the path of its folder")
    for name in files:
        if not (folder / name).is_file():
            raise InputError(f"{folder}: {name} is missing; copy the whole folder of the network, with safetensors")


def load_network(kind: Any, folder: Path, device: str, **options: Any) -> Any:
    """A network of the class `kind`, ready to be run on a device; `options` go to its `from_pretrained`.

    Raises:
        InputError: the files are damaged or those of another network.
    """
    try:
        network, report = kind.from_pretrained(
            folder, local_files_only=True, use_safetensors=True, output_loading_info=True, **options
        )
    except (OSError, ValueError, RuntimeError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise InputError(f"{folder}: cannot be loaded as {kind.__name__} ({reason})") from error
    # Without this check tensors that the files lack would keep random values.
    if report["missing_keys"]:
        missing = sorted(report["missing_keys"])
        raise InputError(f"{folder}: {len(missing)} tensors of {kind.__name__} are missing, such as {missing[0]}")
    return network.eval().to(device)
