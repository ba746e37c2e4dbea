"""`olt data`: index data sets, label and split them, check them for leaks, build their clips and export them."""

from pathlib import Path
from typing import Annotated

import typer

from olt_datasets.commands.comparing import AllowUncomparedOption
from olt_datasets.commands.export import export
from olt_datasets.commands.verify import verify
from olt_datasets.tables.choices import PAPER_FRAMES, PAPER_STRIDE, BuiltKind, SampleChoice, SplitRule
from olt_toolkit.commands.clip import build_all
from olt_toolkit.commands.clip_options import BuildingOptions, JsonOption, NoVerifyOption, unpack_options
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.rigs.names import ContractName, MotionLabels
from olt_toolkit.runtime.workers import Engine

app = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Index, label, split, check, build and export driving data sets."
)

TableArgument = Annotated[Path, typer.Argument(help="A table of indexed clips (.parquet).")]
OutOption = Annotated[Path, typer.Option(help="The table to write; it may be the same one.")]
SourceOption = Annotated[str | None, typer.Option(help="The data set's reader; the first that knows the folder.")]
CacheOption = Annotated[Path, typer.Option(help="Folder where readers keep what takes long to find again.")]
DEFAULT_CACHE = Path("~/.cache/openlongtail")
_SHOWN = 20


@app.command()
def sources() -> None:
    """List the data sets that can be read, with licence and access."""
    from olt_toolkit.recordings.drives import readers
    from olt_toolkit.runtime.console import print_table

    rows = [(name, reader.licence.name, reader.licence.access) for name, reader in readers().items()]
    print_table("Data sets", ("source", "licence", "access"), rows)


@app.command()
def index(
    root: Annotated[Path, typer.Argument(help="Folder of the data set.")],
    out: Annotated[Path, typer.Option(help="The table to write (.parquet); rows that still hold are kept.")],
    source: SourceOption = None,
    frames: Annotated[int, typer.Option(min=2, help="Front images in a window.")] = PAPER_FRAMES,
    stride: Annotated[int, typer.Option(min=1, help="Images from one window to the next.")] = PAPER_STRIDE,
    seconds: Annotated[float | None, typer.Option(help="Windows of this duration, in place of frames.")] = None,
    whole: Annotated[bool, typer.Option("--whole", help="Each drive is one window, however long.")] = False,
    samples: Annotated[
        SampleChoice, typer.Option("--t0", help="Every 0.1 s, the moment nearest to 5.1 s, or the data set's events.")
    ] = SampleChoice.EVERY,
    rig: Annotated[
        ContractName, typer.Option(help="The policy of whose cameras GT clips have true views.")
    ] = ContractName.ALPAMAYO_R1,
    cache: CacheOption = DEFAULT_CACHE,
    keep_going: Annotated[bool, typer.Option("--keep-going", help="Leave out damaged drives and list them.")] = False,
    no_fingerprints: Annotated[
        bool, typer.Option("--no-fingerprints", help="Decode no image; near-duplicates are not found then.")
    ] = False,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    as_json: JsonOption = False,
) -> None:
    """List all clips that a data set can be cut into.

    Of the images a few small ones of each clip are decoded, to find clips that look alike. The table says of each clip
    at which times it will give a policy sample, or why at none. Exit status 1 if drives failed with --keep-going.
    """
    from dataclasses import asdict

    from olt_datasets.tables.cutting import Cutting
    from olt_datasets.tables.indexing import index_dataset
    from olt_generator.errors import InputError
    from olt_generator.omissions import word_omission
    from olt_toolkit.recordings.drives import DatasetPlace
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.rigs.contracts import find_contract
    from olt_toolkit.runtime.console import print_json, print_line, show_progress
    from olt_toolkit.runtime.workers import default_workers

    given = {"--frames": frames != PAPER_FRAMES, "--stride": stride != PAPER_STRIDE}
    if seconds is not None:
        refuse_unused(given, "windows are cut by --seconds")
    if whole:
        refuse_unused(given | {"--seconds": seconds is not None}, "drives are not cut with --whole")
    cutting = Cutting(frames, stride, seconds, whole, samples, find_contract(rig.value))
    place = DatasetPlace(root, cache.expanduser(), source)
    with show_progress("drives") as (on_progress, _):
        summary = index_dataset(
            *(place, out, cutting, workers or default_workers(), on_progress, keep_going, engine),
            with_fingerprints=not no_fingerprints,
        )
    if as_json:
        print_json({"table": str(out), **asdict(summary)})
    else:
        print_line(f"{out}: {summary.clips} clips of {summary.drives} drives of {summary.source}")
        print_line(
            f"{summary.clips_with_samples} of them give {summary.samples} policy samples; the others say why not"
        )
        print_line(f"{summary.kept} rows were kept from the table as it was")
        print_line(f"{summary.fingerprints} clips have a fingerprint, by which near-duplicates are found")
        example = "".join(f", as {key}" for key in summary.without_clips[:1])
        print_line(f"{len(summary.without_clips)} drives fill no window{example}")
        for key, first in summary.copies.items():
            print_line(f"left out: {key}: the same recording as {first}")
        for omission in summary.left_out:
            print_line(f"left out: {word_omission(omission)}")
        for key, message in summary.unreadable.items():
            print_line(f"left out: fingerprints of {key}: {message}")
        for key, message in summary.failed.items():
            print_line(f"failed: {key}: {message}")
    if summary.failed:
        raise InputError(f"{len(summary.failed)} of {summary.drives} drives could not be used; the others are in {out}")


@app.command()
def label(
    table: TableArgument,
    labels: Annotated[Path, typer.Option(help="CSV: scene_id or clip_id, and category, factors (a;b) or country.")],
    out: OutOption,
    as_json: JsonOption = False,
) -> None:
    """Put categories, scene factors and countries into a table, from a file of labels.

    Recipes choose clips by them, and most data sets tell none.
    """
    from olt_datasets.tables.labels import label_table, read_labels
    from olt_toolkit.runtime.console import print_json, print_line

    labelled = label_table(table, read_labels(labels), out)
    if as_json:
        print_json({"table": str(out), "labelled": labelled})
    else:
        print_line(f"{out}: {labelled} clips labelled")


@app.command()
def split(
    table: TableArgument,
    rule: Annotated[SplitRule, typer.Option(help="How clips come into splits.")],
    out: OutOption,
    source: Annotated[
        list[str] | None, typer.Option(help="Only for clips of this source; repeat for more than one.")
    ] = None,
    val: Annotated[float, typer.Option(help="Share of validation.")] = 0.0,
    test: Annotated[float, typer.Option(help="Share of test.")] = 0.2,
    gap: Annotated[float, typer.Option(help="Seconds between windows of different splits (seen).")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the choice of scenes (unseen).")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Put clips into splits by a rule.

    seen: the latest windows of every scene are test. unseen: whole scenes are. external: a whole source is, and is
    never trained on. own: the data set's own splits, which every clip must have. Shares that would leave a split
    without a clip, or without a sample, are refused.
    """
    from dataclasses import asdict

    from olt_datasets.tables.splits import Splitting, split_table
    from olt_toolkit.recordings.recording import refuse_unused
    from olt_toolkit.runtime.console import print_json, print_table

    by_shares = rule in (SplitRule.SEEN, SplitRule.UNSEEN)
    refuse_unused({"--gap": gap != 0.0 and rule is not SplitRule.SEEN}, "only rule seen splits a scene in time")
    refuse_unused({"--seed": seed != 0 and rule is not SplitRule.UNSEEN}, "only rule unseen draws scenes by chance")
    given = {"--val": val != 0.0 and not by_shares, "--test": test != 0.2 and not by_shares}
    refuse_unused(given, f"rule {rule.value} leaves no share to choose")
    counts = split_table(table, Splitting(rule, tuple(source or ()), val, test, gap, seed), out)
    if as_json:
        print_json({"table": str(out), "rule": rule.value, **asdict(counts)})
    else:
        rows = [(name, count, counts.scenes[name], counts.samples[name]) for name, count in counts.clips.items()]
        print_table(f"Splits of {out} by rule {rule.value}", ("split", "clips", "scenes", "samples"), rows)


@app.command()
def check(
    tables: Annotated[list[Path], typer.Argument(metavar="TABLE|STORE...", help="Indexed tables and clip stores.")],
    held_out: Annotated[
        list[str] | None, typer.Option(help="A scene that is not trained on; repeat for more than one.")
    ] = None,
    external: Annotated[
        list[str] | None, typer.Option(help="A source that is not trained on; repeat for more than one.")
    ] = None,
    leaks: Annotated[Path | None, typer.Option(help="Where to write all leaks (.parquet), however many.")] = None,
    allow_uncompared: AllowUncomparedOption = False,
    as_json: JsonOption = False,
) -> None:
    """List everything that leaks from one split into another, and say what was compared to find it.

    GT and Syn clips of the same moments, windows of a scene that overlap, clips of other scenes that look alike,
    held-out scenes and external sources in training. All leaks are counted, and the first of each rule told; --leaks
    writes all. Exit status 1 if anything leaks, if there is nothing to compare, or if clips could not be compared.
    """
    from olt_datasets.tables.clip_frame import check_table_name, scan_clip_tables
    from olt_datasets.tables.leak_report import word_report
    from olt_datasets.tables.leaks import find_table_leaks
    from olt_datasets.tables.scenes import refuse_unknown_scenes
    from olt_generator.errors import InputError
    from olt_toolkit.runtime.console import print_json, print_line

    if leaks is not None:
        check_table_name(leaks)
        if leaks.resolve() in [each.resolve() for each in tables]:
            raise InputError(f"{leaks}: is a table that is checked; give --leaks another name")
    table = scan_clip_tables(tables)
    refuse_unknown_scenes(table, held_out or (), "--held-out")
    report = find_table_leaks(table, held_out or (), external or (), leaks)
    if as_json:
        print_json(report.to_dict() | {"table": None if leaks is None else str(leaks)})
    else:
        for line in word_report(report, _SHOWN, "--leaks FILE (.parquet)" if leaks is None else str(leaks)):
            print_line(line)
    if report.leaks or not (report.is_complete or allow_uncompared):
        raise typer.Exit(1)


@app.command()
@unpack_options
def build(
    table: Annotated[Path, typer.Argument(help="A table of indexed clips (.parquet) that are in splits.")],
    root: Annotated[Path, typer.Option(help="Folder of the data set that was indexed.")],
    kind: Annotated[BuiltKind, typer.Option(help="True views of all cameras, or views synthesized from the front.")],
    out: Annotated[Path, typer.Option(help="Folder of the clip store; it is made if it is missing.")],
    building: BuildingOptions,
    labels: Annotated[
        MotionLabels, typer.Option(help="Measured motion as it is, or as a car that does not slip would drive it.")
    ] = MotionLabels.AS_MEASURED,
    source: SourceOption = None,
    cache: CacheOption = DEFAULT_CACHE,
    seed: Annotated[int, typer.Option(help="Goes into the clips' ids; nothing is drawn by chance.")] = 0,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    keep_going: Annotated[bool, typer.Option("--keep-going", help="Go on after a window that fails.")] = False,
    no_verify: NoVerifyOption = False,
    no_pictures: Annotated[
        bool, typer.Option("--no-pictures", help="Draw no previews, which take longer than small clips.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Build the clips of an indexed table and add them to a store, with split, category and origin of their rows.

    Motion that the data set measured is taken, as it is or with --labels smoothed, else --poses recovers it, which is
    smoothed in any case. Each sample's action error is measured: how far its future is from what the policy's actions
    can express. Given again, an interrupted build
    goes on. Exit status 1 if windows failed with --keep-going.
    """
    from olt_datasets.tables.building import build_row, find_buildable
    from olt_generator.files import make_folder
    from olt_toolkit import BuildOptions, DatasetPlace
    from olt_toolkit.clips.build_job import BuildJob
    from olt_toolkit.clips.table import read_clip_table
    from olt_toolkit.recordings.recording import refuse_unused

    if kind is BuiltKind.GT:
        refuse_unused(building.given_of_synthesis(), "clips of kind GT take true views and measured motion as they are")
    job = BuildJob(
        place=DatasetPlace(root, cache.expanduser(), source),
        key="",
        store=out,
        opening=building.opening(),
        options=BuildOptions(
            width=building.width,
            height=building.height,
            cameras=building.cameras,
            front=building.front,
            labels=labels,
            seed=seed,
        ),
        estimators=building.estimators(),
        keep_going=keep_going,
        verify=not no_verify,
        pictures=not no_pictures,
    )
    rows = find_buildable(read_clip_table(table), kind)
    make_folder(out)
    build_all([build_row(row, kind, job) for row in rows], workers, engine, as_json, "clips")


app.command()(export)
app.command()(verify)


@app.command()
def fake(
    out: Annotated[Path, typer.Argument(help="The table to write (.parquet).")],
    clips: Annotated[int, typer.Option(min=1, help="Number of rows.")] = 100_000,
    as_json: JsonOption = False,
) -> None:
    """Write a fake table of clips, to try recipes, splits and checks on at any size; no clip can be built of it."""
    from olt_datasets.tables.fake_table import write_fake_table
    from olt_toolkit.runtime.console import print_json, print_line

    write_fake_table(out, clips)
    if as_json:
        print_json({"table": str(out), "clips": clips})
    else:
        print_line(f"{out}: {clips} fake clips")
