"""`olt data export`: training data in the layouts of public recipes."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from olt_toolkit.commands.clip_options import JsonOption, NoVerifyOption
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.recordings.labels import Split
from olt_toolkit.rigs.names import ContractName
from olt_toolkit.runtime.workers import Engine


class Format(StrEnum):
    """Layouts of training data."""

    PAI = "pai"
    LEROBOT = "lerobot"


def export(
    inputs: Annotated[
        list[Path], typer.Argument(metavar="MIXTURE|STORE...", help="A composed mixture (a file), or clip stores.")
    ],
    out: Annotated[Path, typer.Option(help="Folder that is made; it appears when it is complete.")],
    layout: Annotated[Format, typer.Option("--format", help="Layout of the export.")] = Format.PAI,
    split: Annotated[Split, typer.Option(help="Which split of clip stores; a mixture has its own.")] = "train",
    rig: Annotated[
        ContractName, typer.Option(help="The policy whose cameras every clip must have.")
    ] = ContractName.ALPAMAYO_R1,
    image_size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Resize the images of a LeRobot data set.")
    ] = None,
    keep_going: Annotated[
        bool, typer.Option("--keep-going", help="Leave out clips that are damaged or fail verification, and list them.")
    ] = False,
    no_verify: NoVerifyOption = False,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    as_json: JsonOption = False,
) -> None:
    """Write a mixture, or whole clip stores, for the public devkit and Alpamayo recipes, or as a LeRobot data set.

    Clips of other splits, and clips that give no sample of the rig's policy, are left out. Masks of invented pixels go
    with their views, and images keep their size. Chunks whose clips are all taken are linked, not copied. Given again,
    an interrupted export goes on. Exit status 1 if clips failed with --keep-going.
    """
    from olt_datasets import contents_of_mixture, contents_of_stores, export_lerobot, export_pai
    from olt_datasets.export.image_sizes import parse_size
    from olt_datasets.mixtures.mixture_file import MIXTURE_SUFFIXES, read_mixture
    from olt_generator.errors import InputError
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.rigs.contracts import find_contract
    from olt_toolkit.runtime.console import make_progress, print_json
    from olt_toolkit.runtime.workers import default_workers

    if layout is Format.PAI:
        refuse_unused({"--image-size": image_size is not None}, "chunks of this layout keep their files as they are")
    size = {} if image_size is None else {"image_size": parse_size(image_size)}
    if inputs[0].suffix not in MIXTURE_SUFFIXES:
        contents = contents_of_stores(inputs, split, find_contract(rig.value))
    elif len(inputs) > 1:
        raise InputError(f"{inputs[1]}: a mixture is exported alone; compose one mixture of everything")
    else:
        contents = contents_of_mixture(read_mixture(inputs[0]), find_contract(rig.value))
    with make_progress() as progress:
        task = progress.add_task(f"export to {layout.value}", total=100)
        summary = (export_pai if layout is Format.PAI else export_lerobot)(
            contents,
            out,
            keep_going,
            workers or default_workers(),
            engine,
            lambda share: progress.update(task, completed=round(100 * share)),
            verify=not no_verify,
            **size,
        )
    if as_json:
        print_json(summary)
    else:
        _show(summary)
    if summary["failures"]:
        raise InputError(f"{len(summary['failures'])} clips could not be exported; the others are in {out}")


def _show(summary: dict[str, Any]) -> None:
    from olt_generator.omissions import Omission, word_omission
    from olt_toolkit.commands.clip_output import word_action_errors
    from olt_toolkit.runtime.console import print_line, print_table

    title = f"{summary['out']}: {summary['clips']} clips of split {summary['split']} for {summary['rig']}"
    if summary["format"] == Format.PAI.value:
        columns = ("component", "kind", "source", "clips", "chunk_ids")
        print_table(title, columns, [[group[column] for column in columns] for group in summary["groups"]])
        for how, part in summary["chunks"].items():
            if part["count"]:
                print_line(f"{part['count']} chunks {how}, {part['bytes'] / 1e6:.1f} MB")
        print_line(
            f"{summary['clips_with_default_keyframe']} clips give a sample at the recipes' default keyframe, 5.1 s"
        )
        print_line(f"action errors: {word_action_errors(summary['action_errors'])}")
        if summary["samples_without_action_error"]:
            print_line(f"action errors of {summary['samples_without_action_error']} samples were not measured")
        print_line("for the public recipes (a range of chunks leaves out its last number):")
        for name, part in summary["components"].items():
            prefix, chunk_ids = "data.train_dataset", part["chunk_ids"]
            overrides = f'{prefix}.local_dir={summary["out"]} {prefix}.chunk_ids="{chunk_ids}"'
            print_line(f"  {name}: {overrides} {prefix}.use_default_keyframe=false")
    else:
        episodes = ", ".join(f"{name} {count}" for name, count in summary["episodes"].items())
        print_line(f"{title} as episodes: {episodes}")
        print_line(f"{summary['frames']} frames, {summary['samples']} of them sample times (is_sample)")
        print_line(f"images: {_word_sizes(summary['image_sizes'])}")
        for camera, sizes in summary["resized_from"].items():
            print_line(f"resized: {camera} of {', '.join(f'{clips} clips, {size}' for size, clips in sizes.items())}")
    verified = summary["verification"]
    if verified is None:
        print_line("not verified (--no-verify)")
    else:
        print_line(f"verified: {verified['passed']} checks passed, {verified['not_compared']} not compared")
    for omission in summary["left_out"]:
        print_line(f"left out: {word_omission(Omission(**omission))}")
    for licence, count in summary["licences"].items():
        print_line(f"licences: {count} clips, {licence}")
    for note in summary["notes"]:
        print_line(f"note: {note}")
    for clip, reason in summary["failures"].items():
        print_line(f"failed: {clip}: {reason}")


def _word_sizes(sizes: dict[str, str]) -> str:
    if len(set(sizes.values())) == 1:
        return f"{next(iter(sizes.values()))} pixels"
    return ", ".join(f"{camera} {size}" for camera, size in sizes.items())
