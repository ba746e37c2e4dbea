"""Damaged files of every kind: what reads them reads them, or refuses them in one line, soon and in bounded memory.

The fast tests try a few mutations of each file, the slow ones as long as `OLT_FUZZ_SECONDS` says.
"""

import shutil
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.mixture_file import write_mixture
from olt_datasets.mixtures.recipe import read_recipe
from olt_datasets.tables.clip_frame import scan_clip_tables
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.video import write_video
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.clips.origin_files import encode_origin
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.truth_tables import truth_tables
from olt_toolkit.recordings.truth import Holds, ObstacleTracks
from olt_toolkit.rigs.rig import CROSS_LEFT, DEFAULT_VEHICLE, FRONT_WIDE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

from ..fuzzing import SECONDS

RECIPE = """
name: mine
description: straight drives, at first
version: 1
held_out_scenes: [held]
components:
  - name: straight
    where: {kind: any, category: [nominal], country: [DE], factors_none: [night]}
    share_by_epoch: {0: 0.7, 3: 0.5}
    repeats: 2
  - name: turns
    where: {category_not: [nominal]}
    share_by_epoch: {0: 0.3, 3: 0.5}
    samples_per_clip: 3
    caps: {turn: 4}
"""
SUITE = """
name: mine
scenes:
  - {scene: longtail/rider_crosses, weight: 2.5, category: cyclists, factors: [curved_road]}
  - {scene: "nominal:3"}
"""
RIG = """
name: mine
assumed: [the lens has no distortion]
vehicle: {length: 4.5, width: 1.8, height: 1.5, rear_axle_to_bbox_center: 1.3, wheelbase: 2.7, track_width: 1.6}
cameras:
  front: &front
    size: [640, 480]
    lens: {model: pinhole, focal: [500.0, 500.0], centre: [319.5, 239.5]}
    position: [1.5, 0.0, 1.4]
    roll_pitch_yaw_degrees: [0.0, 0.0, 0.0]
  left:
    <<: *front
    lens: {model: ftheta, centre: [319.5, 239.5], radius_to_angle: [0.0, 2.0e-3, 0.0, 1.0e-10]}
"""
ARCHIVES = {
    "video": f"camera/{FRONT_WIDE}/{FRONT_WIDE}.chunk_0000.zip",
    "motion": "labels/egomotion/egomotion.chunk_0000.zip",
    "masks": f"pixel_origin/{CROSS_LEFT}.pixel_origin/{CROSS_LEFT}.pixel_origin.chunk_0000.zip",
}
TABLES = ("clips.parquet", "clip_index.parquet", "camera_intrinsics", "sensor_extrinsics", "vehicle_dimensions")


def make_clip(name, category):
    timestamps_us = 100_000 * np.arange(90, dtype=np.int64)
    still, rig = np.zeros(90), pav_rig().fitted(64, 36)
    levels = (40 + np.arange(90)).astype(np.uint8)
    frames = np.broadcast_to(levels[:, None, None, None], (90, 36, 64, 3)).copy()
    streams = {
        camera: CameraStream(frames, timestamps_us, 10.0, rig[camera].camera, rig[camera].T_rig_camera)
        for camera in POLICY_CAMERAS
    }
    views = {camera: ViewProvenance("rendered", "test", "1", None, 1.0, 0.0) for camera in streams}
    masks = np.full((90, 36, 64), PixelOrigin.INVENTED, np.uint8)
    masks[:, :, :20] = PixelOrigin.SAME_FRAME
    streams[CROSS_LEFT] = replace(streams[CROSS_LEFT], origin=masks)
    views[CROSS_LEFT] = ViewProvenance("warped", "test", "1", 0, 0.0, 1.0).with_shares(masks)
    motion = EgoMotion.from_trajectory(Trajectory(timestamps_us, planar_pose(5e-6 * timestamps_us, still, still)))
    origin = ClipOrigin(name, 0, 8_900_000, "DE", "CC0")
    described = {"scene_id": name, "source": "test", "kind": "GT", "factors": ("rain",), "split": "train"}
    return Clip(
        clip_id=make_clip_id(name),
        name=name,
        origin=origin,
        category=category,
        streams=streams,
        ego_motion=motion,
        vehicle=DEFAULT_VEHICLE,
        provenance=views,
        route=np.array([[0.0, 0.0], [50.0, 1.0]]),
        obstacles=ObstacleTracks(
            timestamps_us,
            np.full(90, "car"),
            np.full(90, "automobile"),
            np.tile([9.0, 2.0, 0.8, 0.1, 4.6, 1.9, 1.5], (90, 1)),
        ),
        holds=Holds(timestamps_us, timestamps_us < 2_000_000, np.full(90, 12.0)),
        road=np.array([[0.0, 0.0, 2.5, 6.0], [50.0, 1.0, 2.5, 6.0]]),
        **described,
    )


@pytest.fixture(scope="session")
def whole_files(tmp_path_factory):
    """A valid file of every kind."""
    root = tmp_path_factory.mktemp("whole")
    store = ClipStore(root / "store")
    clips = [make_clip("straight", "nominal"), make_clip("turn", "turn"), make_clip("held", "nominal")]
    for clip in clips:
        store.prepare(clip)
    store.commit([clip.clip_id for clip in clips])
    shutil.copy(root / "store" / "clips.parquet", root / "clips.parquet")
    for name, text in (("recipe.yaml", RECIPE), ("rig.yaml", RIG), ("suite.yaml", SUITE)):
        (root / name).write_text(text.lstrip())
    stage = files("olt_sft_recipes.training") / "stages" / "toy_stage1.yaml"
    (root / "stage.yaml").write_text(stage.read_text())
    mixture = compose_mixture(
        read_recipe(root / "recipe.yaml"), scan_clip_tables([root / "clips.parquet"]), 0, (), True
    )
    for suffix in ("json", "parquet"):
        write_mixture(mixture, root / f"mixture.{suffix}")
    (root / "labels.csv").write_text(
        "scene_id,category,factors,country\nstraight,nominal,rain;dusk,DE\nturn,turn,,FR\n"
    )
    write_video(root / "film.mp4", clips[0].streams[FRONT_WIDE].frames[:12], 10.0, 2)
    stream = clips[0].streams[CROSS_LEFT]
    (root / "masks.parquet").write_bytes(encode_origin(stream.timestamps_us, stream.origin))
    for name, table in truth_tables(clips[0]).items():
        table.to_parquet(root / f"{name}.parquet")
    return root


@pytest.fixture
def place(whole_files, tmp_path):
    shutil.copytree(whole_files, tmp_path / "files")
    return tmp_path / "files"


SINGLE = {
    "clip table": "clips.parquet",
    "clip tables": "clips.parquet",
    "clip video": "film.mp4",
    "mp4 index": "film.mp4",
    "video": "film.mp4",
    "masks": "masks.parquet",
    "route": "route.parquet",
    "obstacles": "obstacle.offline.parquet",
    "holds": "hold.parquet",
    "road": "road.parquet",
    "recipe": "recipe.yaml",
    "rig": "rig.yaml",
    "stage config": "stage.yaml",
    "suite": "suite.yaml",
    "labels": "labels.csv",
}
CASES = list(SINGLE.items())
CASES += [("mixture", "mixture.json"), ("mixture", "mixture.parquet")]
CASES += [("archive", f"store/{path}") for path in ARCHIVES.values()]
IN_STORE = [*ARCHIVES.values(), *TABLES]


@pytest.mark.parametrize(("reader", "name"), CASES)
def test_damaged_files_are_read_or_refused_in_words(fuzzer, place, reader, name):
    fuzzer.run(reader, place / name)


@pytest.mark.parametrize("name", IN_STORE)
def test_a_store_with_a_damaged_file_is_read_or_refused_in_words(fuzzer, place, name):
    fuzzer.run("store", find_in_store(place / "store", name), place / "store", examples=8)


@pytest.mark.slow
@pytest.mark.parametrize(("reader", "name"), CASES)
def test_damaged_files_for_long(fuzzer, place, reader, name):
    fuzzer.run(reader, place / name, seconds=SECONDS)


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_STORE)
def test_a_store_with_a_damaged_file_for_long(fuzzer, place, name):
    fuzzer.run("store", find_in_store(place / "store", name), place / "store", seconds=SECONDS)


def find_in_store(store, name):
    if (store / name).is_file():
        return store / name
    (found,) = store.rglob(f"{name}.chunk_0000.parquet")
    return found


def test_a_fault_of_a_reader_is_found(fuzzer, tmp_path):
    """The tests above could not fail otherwise."""
    path = tmp_path / "words.txt"
    path.write_text("one two")
    assert "KeyError: 'no such reader'" in fuzzer.problem("no such reader", path)
    assert "ZeroDivisionError" in fuzzer.problem("fault: raise", path)
    assert "ended its process" in fuzzer.problem("fault: abort", path)
    assert "MemoryError" in fuzzer.problem("fault: swell", path)
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        fuzzer.run("fault: raise if damaged", path)
    assert path.read_text() == "one two"


@pytest.mark.slow
def test_a_reader_that_takes_long_is_found(fuzzer, tmp_path):
    assert "of a processor" in fuzzer.problem("fault: spin", tmp_path / "any")
