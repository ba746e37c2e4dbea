"""Labels from a file into a table of indexed clips."""

import json

import pytest
from typer.testing import CliRunner

from olt_datasets.commands.data import app
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_datasets.tables.labels import label_table, read_labels
from olt_generator.errors import InputError
from olt_toolkit.clips.table import write_clip_table


@pytest.fixture
def table(tmp_path, make_clip):
    path = tmp_path / "clips.parquet"
    clips = [make_clip(number, scene_id=f"scene_{number // 2}", category="unlabelled") for number in range(4)]
    write_clip_table(path, clips)
    return path


@pytest.fixture
def write_labels(tmp_path):
    def write(text):
        path = tmp_path / "labels.csv"
        path.write_text(text)
        return path

    return write


def column(table, name):
    return read_clip_tables([table])[name].to_list()


def test_scenes_get_their_labels_and_the_rest_stays(table, tmp_path, write_labels):
    labels = write_labels("scene_id,category,factors,country\nscene_1,work_zone,weak_markings; cones,DE\n")
    out = tmp_path / "out.parquet"
    assert label_table(table, read_labels(labels), out) == 2
    assert column(out, "category") == ["unlabelled", "unlabelled", "work_zone", "work_zone"]
    assert column(out, "factors") == [[], [], ["weak_markings", "cones"], ["weak_markings", "cones"]]
    assert column(out, "country") == [None, None, "DE", "DE"]
    assert column(table, "category") == ["unlabelled"] * 4


def test_an_empty_cell_leaves_what_the_table_says(table, write_labels):
    clip = column(table, "clip_id")[0]
    label_table(table, read_labels(write_labels(f"clip_id,category,country\n{clip},animal,US\n")), table)
    label_table(table, read_labels(write_labels(f"clip_id,category,country\n{clip},,FR\n")), table)
    assert column(table, "category")[0] == "animal" and column(table, "country")[0] == "FR"


def test_the_command_counts(table, write_labels):
    labels = write_labels("scene_id,category\nscene_0,cyclists\n")
    result = CliRunner().invoke(app, ["label", str(table), "--labels", str(labels), "--out", str(table), "--json"])
    assert json.loads(result.stdout)["labelled"] == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scene_id,category\nscene_0,Work Zone\n", "category 'Work Zone': write a word in lower case"),
        ("scene_id,factors\nscene_0,cones;;rain\n", "factors '': write a word in lower case"),
        ("scene_id,country\nscene_0,Germany\n", "country 'Germany': write two letters"),
        ("scene_id,category\nscene_0,animal\nscene_0,nominal\n", "'scene_0' is there more than once"),
        ("scene_id,category\n,animal\n", "row 1: scene_id is empty"),
        ("scene_id,clip_id,category\nscene_0,a,animal\n", "give either scene_id or clip_id"),
        ("scene_id\nscene_0\n", "and any of category, factors, country"),
        ("scene_id,weather\nscene_0,rain\n", "columns scene_id, weather"),
        ("", "not a readable CSV file"),
    ],
)
def test_wrong_labels_are_refused_by_name(write_labels, text, message):
    with pytest.raises(InputError, match=message):
        read_labels(write_labels(text))


def test_labels_for_nothing_are_refused_and_leave_no_table(table, tmp_path, write_labels):
    labels = read_labels(write_labels("scene_id,category\nscene_0,animal\nscene_9,animal\n"))
    with pytest.raises(InputError, match="holds no clip of scene_id scene_9"):
        label_table(table, labels, tmp_path / "out.parquet")
    assert not (tmp_path / "out.parquet").exists()


def test_labels_of_built_clips_are_refused(tmp_path, write_labels):
    labels = read_labels(write_labels("scene_id,category\nscene_0,animal\n"))
    with pytest.raises(InputError, match="before clips are built"):
        label_table(tmp_path / "store", labels, tmp_path / "out.parquet")
