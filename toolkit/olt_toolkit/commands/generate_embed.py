"""`olt generate embed`: the prompt of an engine as the embeddings that it takes."""

from pathlib import Path
from typing import Annotated

import typer


def embed(
    prompt: Annotated[str, typer.Argument(help="What is to be seen, in words.")],
    backbone: Annotated[
        Path, typer.Option(help="Folder of Wan2.1-VACE as diffusers writes it, with tokenizer and text_encoder.")
    ],
    out: Annotated[Path, typer.Option(help="safetensors file to write, for `olt generate train --text`.")],
    device: Annotated[str, typer.Option(help="Where the text encoder runs: cpu, cuda.")] = "cpu",
) -> None:
    """Write the UMT5 embeddings of a prompt, and of no text, which guidance leads away from."""
    from safetensors.torch import save_file

    from olt_generator.diffusion.text_embeddings import embed_texts
    from olt_generator.errors import InputError
    from olt_generator.files import write_whole
    from olt_toolkit.runtime.console import print_line

    if not prompt.strip():
        raise InputError("the prompt is empty; say in words what is to be seen")
    embeddings = embed_texts(backbone, [prompt, ""], device=device)
    with write_whole(out) as temporary:
        save_file({"prompt": embeddings[0].contiguous(), "empty": embeddings[1].contiguous()}, temporary)
    print_line(f"{out}: embeddings {tuple(embeddings[0].shape)} of the prompt and of no text")
