"""Files that mean harm: entities, bombs, names that lead out of an archive, cycles, endless nesting."""

import time
import warnings
import zipfile

import pytest
from hypothesis import HealthCheck, given, settings

from olt_closed_loop.scenes.sources import read_recording
from olt_generator.errors import InputError

from ...fuzzing import EXAMPLES, MOST_CPU_SECONDS, SECONDS, damaged
from . import written_scenes as written

ROOTS = {"xml": "commonRoad", "xodr": "OpenDRIVE", "xosc": "OpenSCENARIO"}


def refuses(path, named):
    start = time.process_time()
    with pytest.raises(InputError, match=named) as caught:
        read_recording(path)
    assert time.process_time() - start < MOST_CPU_SECONDS
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 2000


@pytest.mark.parametrize("ending", ROOTS)
def test_entities_are_not_expanded(tmp_path, ending):
    path = tmp_path / f"one.{ending}"
    laughs = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 10))
    path.write_text(f'<!DOCTYPE x [<!ENTITY a0 "ha">{laughs}]><{ROOTS[ending]}>&a9;</{ROOTS[ending]}>')
    refuses(path, "declares a document type")


@pytest.mark.parametrize("ending", ROOTS)
def test_files_elsewhere_are_not_opened(tmp_path, ending):
    secret = tmp_path / "secret.txt"
    secret.write_text("secret words")
    path = tmp_path / f"one.{ending}"
    path.write_text(f'<!DOCTYPE x [<!ENTITY a SYSTEM "{secret.as_uri()}">]><{ROOTS[ending]}>&a;</{ROOTS[ending]}>')
    with pytest.raises(InputError, match="declares a document type") as caught:
        read_recording(path)
    assert "secret words" not in str(caught.value)


@pytest.mark.parametrize("ending", ROOTS)
@pytest.mark.parametrize(
    ("content", "named"),
    [
        (lambda root: f"<{root}>" + "<a>" * 5000, "nested deeper"),
        (lambda root: f"<{root}>" + "<a/>" * 1_000_001 + f"</{root}>", "more than 1000000 elements"),
        (lambda root: f"<{root}>", "not readable as XML"),
        (lambda root: "", "not readable as XML"),
        (lambda root: "<other/>", "begins with <other>"),
        (lambda root: f'<?xml version="1.0" encoding="none-such"?><{root}/>', "not readable as XML"),
    ],
)
def test_what_is_no_such_xml(tmp_path, ending, content, named):
    path = tmp_path / f"one.{ending}"
    path.write_text(content(ROOTS[ending]))
    refuses(path, named)


def test_a_folder_in_place_of_a_file(tmp_path):
    (tmp_path / "one.xml").mkdir()
    refuses(tmp_path / "one.xml", "no recorded drive")


def test_lanes_that_follow_themselves(tmp_path):
    """A road without end is driven until the scenario is over; a scenario that never ends is ended."""
    ring = written.road(
        "1",
        written.geometry(0, 0, 0, 62.83185307179586, '<arc curvature="0.1"/>'),
        62.83185307179586,
        '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
        '<successor elementType="road" elementId="1" contactPoint="start"/>',
        "",
        written.lane(-1, links='<predecessor id="-1"/><successor id="-1"/>'),
    )
    path = written.write_openscenario(tmp_path, events="", stop="1e6")
    (tmp_path / "roads.xodr").write_text(f"<OpenDRIVE>{ring}</OpenDRIVE>")
    text = path.read_text().replace('dLane="-1"', 'dLane="0"').replace('s="50"', 's="5"')
    path.write_text(text)
    scene = read_recording(path)
    assert scene.ego.times[-1] == pytest.approx(120.0)
    assert scene.ego.path_length == pytest.approx(1200.0, rel=0.01)
    assert read_recording(tmp_path / "roads.xodr").ego.path_length == pytest.approx(300.0, rel=0.02)


def test_junctions_whose_connections_lead_back(tmp_path):
    content = written.opendrive().replace('elementId="2"', 'elementId="1"').replace('elementId="3"', 'elementId="4"')
    path = tmp_path / "one.xodr"
    path.write_text(content)
    assert read_recording(path).ego.path_length > 50.0


def zipped(path, *members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content, compression)
    return path


@pytest.mark.parametrize("name", ["../evil", "/etc/evil", "a/../../evil", "C:/evil", "a\\..\\evil"])
def test_names_that_lead_out_of_an_archive(tmp_path, name):
    members = [*written.nurec_members().items(), (name, b"x")]
    refuses(zipped(tmp_path / "one.usdz", *members), "leads out of the archive")


def test_a_member_that_is_there_twice(tmp_path):
    members = [*written.nurec_members().items(), ("metadata.yaml", b"scene_id: other\n")]
    refuses(zipped(tmp_path / "one.usdz", *members), "is there twice")


def test_a_bomb(tmp_path):
    members = written.nurec_members() | {"rig_trajectories.json": b" " * (200 << 20)}
    refuses(zipped(tmp_path / "one.usdz", *members.items(), compression=zipfile.ZIP_DEFLATED), "200 times its size")


def test_deep_json_in_an_archive(tmp_path):
    members = written.nurec_members() | {"sequence_tracks.json": b"[" * 200_000}
    refuses(zipped(tmp_path / "one.usdz", *members.items()), "sequence_tracks.json")


def test_what_is_no_archive(tmp_path):
    path = tmp_path / "one.usdz"
    path.write_bytes(b"no zip")
    refuses(path, "one.usdz")
    written.write_nurec(path, {"default.usda": b"#usda 1.0"})
    refuses(path, "member rig_trajectories.json is missing")


def test_pickles_are_not_opened(tmp_path):
    path = tmp_path / "one.pkl"
    path.write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    refuses(path, "pickles are not opened")


FUZZED = ("one.xml", "roads.xodr", "cut_in.xosc", "one.tfrecord", "one.usdz")


@pytest.fixture
def folder(tmp_path):
    written.write_all(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", FUZZED)
def test_damaged_files(fuzzer, folder, name):
    fuzzer.run("scenario", folder / name, examples=12)


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(damaged(written.waymo_scenario().SerializeToString()))
def test_damaged_messages_of_right_checksum(tmp_path, record):
    path = written.write_records(tmp_path / "one.tfrecord", record)
    try:
        read_recording(path)
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 2000


@pytest.mark.slow
@pytest.mark.parametrize("name", FUZZED)
def test_damaged_files_for_long(fuzzer, folder, name):
    fuzzer.run("scenario", folder / name, seconds=SECONDS)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["roads.xodr", "catalogues/vehicles.xosc"])
def test_damaged_files_beside_a_scenario(fuzzer, folder, name):
    fuzzer.run("scenario", folder / name, folder / "cut_in.xosc", seconds=SECONDS)
