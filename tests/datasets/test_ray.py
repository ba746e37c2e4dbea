"""From a data set to an export on a Ray cluster: the same bytes as on this machine."""

import pytest
from typer.testing import CliRunner

from olt_datasets.commands.data import app

pytest.importorskip("ray", reason="needs the extra `distributed`")

SPECIFICATION = "categories: [nominal, cyclists]\nseed: 3\ncount: 1\nduration: 9.0\nframe_rate: 4.0\n"


def run(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, (result.output, result.exception)


def export_on(engine, world, folder):
    """Index, split, build and export a small world; returns the bytes of the table and of the export by file name."""
    table, store, out = folder / "clips.parquet", folder / "store", folder / "pai"
    work = ("--workers", 2, "--engine", engine)
    cache = ("--cache", folder / "cache")
    run("index", world, "--out", table, "--seconds", 9, *cache, *work)
    run("split", table, "--rule", "unseen", "--test", 0, "--out", table)
    run("build", table, "--root", world, "--kind", "GT", "--out", store, "--width", 64, "--height", 36, *cache, *work)
    run("export", store, "--out", out, *work)
    # The summary of an export names its folder.
    files = [table, *(path for path in sorted(out.rglob("*")) if path.is_file() and path.name != "export.json")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.slow
def test_from_a_data_set_to_an_export_on_a_cluster(tmp_path):
    world = tmp_path / "world"
    world.mkdir()
    (world / "synthetic.yaml").write_text(SPECIFICATION)
    local = export_on("local", world, tmp_path / "here")
    assert export_on("ray", world, tmp_path / "cluster") == local
    assert any(name.endswith(".zip") for name in local)
