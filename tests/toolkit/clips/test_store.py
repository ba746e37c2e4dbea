import io
import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

import olt_toolkit.clips.store as clip_store_module
from olt_generator.cameras import FthetaCamera
from olt_generator.errors import InputError
from olt_generator.poses import make_pose
from olt_toolkit.clips.clip import EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.rigs.rig import CROSS_LEFT, FRONT_WIDE, POLICY_CAMERAS
from olt_toolkit.runtime.version import code_version
from olt_toolkit.runtime.workers import map_parallel

T0_US = 2_000_000


@pytest.fixture(scope="session")
def two_clips(tmp_path_factory, make_clip):
    """The folder of a store of two clips, for copying."""
    store = ClipStore(tmp_path_factory.mktemp("two_clips"))
    for name in ("bend", "other"):
        store.prepare(make_clip(name))
    store.commit([make_clip_id("bend"), make_clip_id("other")])
    return store.root


@pytest.fixture
def store(two_clips, tmp_path):
    """A store of two clips that the test may damage."""
    shutil.copytree(two_clips, tmp_path / "clips")
    return ClipStore(tmp_path / "clips")


def key_of(store, name="bend", t0_us=T0_US):
    return SampleKey(str(store.root), make_clip_id(name), t0_us)


def tree(root):
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def prepare_clip(job):
    root, clip = job
    ClipStore(root).prepare(clip)


def test_clip_table_comes_back(store, make_clip):
    clip = make_clip()
    info = store.info(clip.clip_id)
    assert [each.name for each in store.clips()] == ["bend", "other"]
    assert (info.kind, info.category, info.factors, info.split) == ("GT", "nominal", ("rain",), "train")
    assert info.views == clip.provenance
    assert info.origin == clip.origin
    assert info.duration_us == 8_900_000
    assert info.sample_t0_us == tuple(range(1_700_000, 2_600_000, 100_000))
    assert info.no_sample_reason is None


@pytest.mark.parametrize(
    ("doubts", "scale_sigma", "noise"), [(None, None, None), ((), 0.02, 0.12), (("direction", "speed"), None, None)]
)
def test_what_is_known_of_a_motion_comes_back(tmp_path, make_clip, doubts, scale_sigma, noise):
    clip = replace(make_clip(), doubts=doubts, scale_sigma=scale_sigma, acceleration_noise=noise)
    store = ClipStore(tmp_path)
    store.prepare(clip)
    store.commit([clip.clip_id])
    info = ClipStore(tmp_path).info(clip.clip_id)
    assert (info.doubts, info.scale_sigma, info.acceleration_noise) == (doubts, scale_sigma, noise)


def test_only_times_at_which_a_clip_may_be_sampled_are_told(tmp_path, make_clip):
    store = ClipStore(tmp_path)
    info = store.prepare(make_clip(sample_t0_us=(2_000_000, 2_100_000, 9_000_000)))
    assert (info.sample_t0_us, info.no_sample_reason) == ((2_000_000, 2_100_000), None)
    info = store.prepare(make_clip(sample_t0_us=(9_000_000,)))
    assert (info.sample_t0_us, info.no_sample_reason is None) == ((), False)
    assert "6.4 s of future" in store.prepare(make_clip(seconds=5.0, sample_t0_us=(2_000_000,))).no_sample_reason


def test_checksum_follows_the_files(tmp_path, make_clip):
    store, clip = ClipStore(tmp_path), make_clip()
    first = store.prepare(clip)
    assert store.prepare(clip) == first
    slower = replace(clip.ego_motion, velocity=0.5 * clip.ego_motion.velocity)
    assert store.prepare(replace(clip, ego_motion=slower)).checksum != first.checksum
    assert store.prepare(replace(clip, category="other")).checksum == first.checksum


def test_ego_motion_and_calibration_come_back(store, make_clip):
    clip = make_clip()
    motion = store.read_ego_motion(clip.clip_id)
    np.testing.assert_allclose(motion.trajectory.T_world_rig, clip.ego_motion.trajectory.T_world_rig, atol=1e-12)
    np.testing.assert_array_equal(motion.velocity, clip.ego_motion.velocity)
    np.testing.assert_array_equal(motion.curvature, clip.ego_motion.curvature)
    assert store.read_vehicle(clip.clip_id) == clip.vehicle
    for name, stream in clip.streams.items():
        mounted = store.read_camera(clip.clip_id, name)
        np.testing.assert_allclose(mounted.T_rig_camera, stream.T_rig_camera, atol=1e-12)
        assert isinstance(mounted.camera, FthetaCamera)
        assert mounted.camera.fw_poly == stream.camera.fw_poly


def test_ego_motion_is_anchored_at_the_start(make_clip, bend_poses):
    """Place and yaw are taken out, roll and pitch stay."""
    motion = make_clip().ego_motion
    expected = bend_poses(np.zeros(1))[0]
    assert np.abs(Rotation.from_matrix(expected[:3, :3]).as_euler("ZYX")[1:]).min() > 0.03
    np.testing.assert_allclose(motion.trajectory.T_world_rig[0], expected, atol=1e-12)
    moved = make_pose(Rotation.from_euler("z", 2.0).as_matrix(), [70.0, -30.0, 5.0]) @ motion.trajectory.T_world_rig
    again = EgoMotion.from_trajectory(replace(motion.trajectory, T_world_rig=moved))
    np.testing.assert_allclose(again.trajectory.T_world_rig, motion.trajectory.T_world_rig, atol=1e-12)
    np.testing.assert_allclose(again.velocity, motion.velocity, atol=1e-9)
    np.testing.assert_allclose(again.acceleration, motion.acceleration, atol=1e-9)
    np.testing.assert_allclose(motion.velocity[0], [8.0, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(motion.curvature, 0.02, atol=1e-4)


def test_sample_has_the_true_poses_and_the_right_frames(store, bend_poses):
    sample = store.load_sample(key_of(store))
    assert sample.image_frames.shape == (4, 4, 3, 72, 128)
    assert sample.image_frames.dtype == np.uint8
    assert sample.camera_indices.tolist() == [0, 1, 2, 6]
    np.testing.assert_array_equal(sample.ego_history_xyz[0, -1], 0.0)
    poses = bend_poses(T0_US + 100_000 * np.arange(-15, 65))
    relative = np.linalg.inv(poses[15]) @ poses
    np.testing.assert_allclose(sample.ego_history_xyz[0], relative[:16, :3, 3], atol=1e-4)
    np.testing.assert_allclose(sample.ego_history_rot[0], relative[:16, :3, :3], atol=1e-5)
    np.testing.assert_allclose(sample.ego_future_xyz[0], relative[16:, :3, 3], atol=1e-4)
    np.testing.assert_allclose(sample.ego_future_rot[0], relative[16:, :3, :3], atol=1e-5)
    assert sample.absolute_timestamps.tolist() == [
        [1_681_000, 1_781_000, 1_881_000, 1_981_000],
        [1_700_000, 1_800_000, 1_900_000, 2_000_000],
        [1_667_000, 1_767_000, 1_867_000, 1_967_000],
        [1_675_650, 1_775_649, 1_875_648, 1_975_647],
    ]
    since_earliest = (sample.absolute_timestamps - 1_667_000) * 1e-6
    np.testing.assert_allclose(sample.relative_timestamps, since_earliest, atol=1e-6)
    levels = sample.image_frames.mean(axis=(2, 3, 4))
    numbers = np.array([[16, 17, 18, 19], [17, 18, 19, 20], [33, 35, 37, 39], [50, 53, 56, 59]])
    np.testing.assert_allclose(levels, 8 + 3 * numbers + np.arange(4)[:, None], atol=1.2)


def test_the_newest_frame_at_or_before_a_time_is_taken(store):
    frames, times = store.read_frames(make_clip_id("bend"), FRONT_WIDE, np.array([0, 99_999, 100_000, 3_950_000]))
    assert times.tolist() == [0, 0, 100_000, 3_900_000]
    np.testing.assert_allclose(frames.mean(axis=(1, 2, 3)), 9 + 3 * np.array([0, 0, 1, 39]), atol=1.2)


def test_images_can_be_scaled(store):
    sample = store.load_sample(key_of(store), image_size=(36, 64))
    assert sample.image_frames.shape == (4, 4, 3, 36, 64)


def test_irregular_timestamps_are_kept(tmp_path, make_clip):
    clip = make_clip("jitter", 12.0)
    stretched = {name: stream.timestamps_us * 1034 // 1000 for name, stream in clip.streams.items()}
    streams = {name: replace(stream, timestamps_us=stretched[name]) for name, stream in clip.streams.items()}
    store = ClipStore(tmp_path)
    store.prepare(replace(clip, streams=streams))
    store.commit([clip.clip_id])
    sample = store.load_sample(SampleKey(str(tmp_path), clip.clip_id, 3_000_000))
    assert sample.absolute_timestamps[1].tolist() == [2_688_400, 2_791_800, 2_895_200, 2_998_600]
    assert [len(np.unique(means)) for means in sample.image_frames.mean(axis=(2, 3, 4))] == [4] * 4


def test_clip_too_short_for_a_sample_says_so(tmp_path, make_clip):
    clip = make_clip("short", 4.0)
    store = ClipStore(tmp_path)
    store.prepare(clip)
    store.commit([clip.clip_id])
    info = store.info(clip.clip_id)
    assert info.sample_t0_us == ()
    assert "ego motion covers 0 s to 3.9 s" in info.no_sample_reason
    with pytest.raises(InputError, match=f"clip {clip.clip_id}: ego motion covers"):
        store.load_sample(SampleKey(str(tmp_path), clip.clip_id, T0_US))


def test_clip_without_side_views_is_stored_and_says_why_it_gives_no_sample(tmp_path, make_clip):
    clip = make_clip("front", kind="front_only")
    only = {FRONT_WIDE: clip.streams[FRONT_WIDE]}
    store = ClipStore(tmp_path)
    store.prepare(replace(clip, streams=only, provenance={FRONT_WIDE: clip.provenance[FRONT_WIDE]}))
    store.commit([clip.clip_id])
    assert "no camera_cross_left_120fov" in store.info(clip.clip_id).no_sample_reason
    presence = pd.read_parquet(tmp_path / "metadata/feature_presence.parquet")
    assert presence.loc[clip.clip_id, [FRONT_WIDE, CROSS_LEFT, "egomotion"]].tolist() == [True, False, True]
    with pytest.raises(InputError, match="no camera_cross_left_120fov"):
        store.load_sample(SampleKey(str(tmp_path), clip.clip_id, T0_US))


def test_the_same_clips_give_the_same_bytes_in_any_order_of_staging(tmp_path, make_clip):
    clips = [make_clip(name, 2.0) for name in ("a", "b")]
    for root, order in [(tmp_path / "one", clips), (tmp_path / "two", clips[::-1])]:
        for clip in order:
            ClipStore(root).prepare(clip)
        ClipStore(root).commit([clip.clip_id for clip in clips])
    assert tree(tmp_path / "one") == tree(tmp_path / "two")


@pytest.mark.slow
def test_the_same_clips_give_the_same_bytes_from_any_number_of_processes(tmp_path, make_clip):
    clips = [make_clip(name, 2.0) for name in ("a", "b", "c")]
    for root, workers in [(tmp_path / "one", 1), (tmp_path / "two", 2)]:
        map_parallel(prepare_clip, [(root, clip) for clip in clips], workers)
        ClipStore(root).commit([clip.clip_id for clip in clips])
    assert tree(tmp_path / "one") == tree(tmp_path / "two")


def test_each_commit_makes_a_new_chunk_and_leaves_the_old_ones(store, make_clip):
    before = tree(store.root)
    store.prepare(make_clip("third"))
    assert store.is_prepared(make_clip_id("third"))
    assert store.commit([make_clip_id("third")]) == (make_clip_id("third"),)
    assert not store.is_prepared(make_clip_id("third"))
    after = tree(store.root)
    assert all(after[name] == data for name, data in before.items() if "chunk_0000" in name)
    assert pd.read_parquet(store.root / "clip_index.parquet")["chunk"].tolist() == [0, 0, 1]
    assert [info.name for info in ClipStore(store.root).clips()] == ["bend", "other", "third"]
    store.load_sample(key_of(store, "third"))
    store.load_sample(key_of(store, "bend"))


def test_what_other_code_prepared_is_prepared_again(store, make_clip, monkeypatch):
    clip = make_clip("third")
    with monkeypatch.context() as patch:
        patch.setattr("olt_toolkit.clips.files.code_version", lambda: "0.0.9")
        assert store.prepare(clip).created_with == "0.0.9"
    assert not store.is_prepared(clip.clip_id)
    with pytest.raises(InputError, match="prepare it with this code"):
        store.commit([clip.clip_id])
    assert store.prepare(clip).created_with == code_version()
    assert store.commit([clip.clip_id]) == (clip.clip_id,)


def test_many_clips_are_split_into_chunks(tmp_path, make_clip, monkeypatch):
    monkeypatch.setattr(clip_store_module, "CLIPS_PER_CHUNK", 2)
    clips = [make_clip(name, 2.0) for name in "abc"]
    store = ClipStore(tmp_path)
    for clip in clips:
        store.prepare(clip)
    store.commit([clip.clip_id for clip in clips])
    assert pd.read_parquet(tmp_path / "clip_index.parquet")["chunk"].tolist() == [0, 0, 1]


def test_committing_again_changes_nothing(store, make_clip):
    before = tree(store.root)
    store.prepare(make_clip("bend", category="other"))
    assert store.commit([make_clip_id("bend")]) == ()
    assert tree(store.root) == before


@pytest.mark.parametrize("stop_at", ["write_metadata", "write_clip_table", "shutil"])
def test_interrupted_commit_leaves_the_old_store_and_the_next_one_completes(store, make_clip, monkeypatch, stop_at):
    def interrupt(*_args, **_options):
        raise KeyboardInterrupt

    store.prepare(make_clip("third"))
    with monkeypatch.context() as patch:
        target = clip_store_module.shutil if stop_at == "shutil" else clip_store_module
        patch.setattr(target, "rmtree" if stop_at == "shutil" else stop_at, interrupt)
        with pytest.raises(KeyboardInterrupt):
            store.commit([make_clip_id("third")])
    after = ClipStore(store.root)
    assert {info.name for info in after.clips()} >= {"bend", "other"}
    after.load_sample(key_of(store))
    after.commit([make_clip_id("third")])
    assert [info.name for info in after.clips()] == ["bend", "other", "third"]
    assert not after.is_prepared(make_clip_id("third"))
    after.load_sample(key_of(store, "third"))


def test_interrupted_staging_leaves_nothing(tmp_path, make_clip, monkeypatch):
    def interrupt(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(clip_store_module, "write_clip_files", interrupt)
    store = ClipStore(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        store.prepare(make_clip())
    assert not store.is_prepared(make_clip_id("bend"))
    assert list((tmp_path / ".staging").iterdir()) == []


def test_one_writer_at_a_time(store):
    with store._only_writer(), pytest.raises(InputError, match="another process is adding clips"):
        ClipStore(store.root).commit([make_clip_id("bend")])


def test_unstaged_clip_is_refused(store):
    with pytest.raises(InputError, match="is not in the store; prepare it"):
        store.commit([make_clip_id("nowhere")])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda clip: {"clip_id": "bend"}, "not a UUID"),
        (lambda clip: {"provenance": {}}, "provenance must be given"),
        (
            lambda clip: {
                "streams": {"camera_roof": clip.streams[FRONT_WIDE]},
                "provenance": {"camera_roof": ViewProvenance("observed", "test", "1", None, 1.0, 0.0)},
            },
            "no PhysicalAI-AV camera is called 'camera_roof'",
        ),
        (lambda clip: with_stream(clip, frames=clip.streams[FRONT_WIDE].frames[:-1]), "89 frames and 90 timestamps"),
        (
            lambda clip: with_stream(clip, timestamps_us=clip.streams[FRONT_WIDE].timestamps_us[::-1]),
            "strictly increasing",
        ),
        (lambda clip: with_stream(clip, frames=clip.streams[FRONT_WIDE].frames[:, :32]), "for a lens of"),
        (
            lambda clip: with_stream(clip, camera=replace(clip.streams[FRONT_WIDE].camera, aspect=1.2)),
            "camera_front_wide_120fov: camera with pixels of aspect 1.2",
        ),
    ],
)
def test_contradictory_clips_are_not_prepared(tmp_path, make_clip, change, message):
    clip = make_clip()
    changed = replace(clip, **change(clip))
    with pytest.raises(InputError, match=message):
        ClipStore(tmp_path).prepare(changed)
    assert not ClipStore(tmp_path).is_prepared(clip.clip_id)


def with_stream(clip, **changes):
    return {"streams": {**clip.streams, FRONT_WIDE: replace(clip.streams[FRONT_WIDE], **changes)}}


def rewrite_member(path, name, change):
    """Replace the bytes of one zip member; None drops it."""
    with zipfile.ZipFile(path) as archive:
        members = {each: archive.read(each) for each in archive.namelist()}
    members[name] = change(members[name])
    with zipfile.ZipFile(path, "w") as archive:
        for each, data in members.items():
            if data is not None:
                archive.writestr(each, data)


def changed_table(data, change):
    buffer = io.BytesIO()
    change(pd.read_parquet(io.BytesIO(data))).to_parquet(buffer)
    return buffer.getvalue()


CLIP = make_clip_id("bend")
EGO_ZIP, EGO = "labels/egomotion/egomotion.chunk_0000.zip", f"{CLIP}.egomotion.parquet"
FRONT_ZIP = f"camera/{FRONT_WIDE}/{FRONT_WIDE}.chunk_0000.zip"
FRONT_MP4, FRONT_TIMES = f"{CLIP}.{FRONT_WIDE}.mp4", f"{CLIP}.{FRONT_WIDE}.timestamps.parquet"


@pytest.mark.parametrize(
    ("path", "member", "change", "message"),
    [
        (EGO_ZIP, EGO, lambda data: None, f"member {EGO} is missing"),
        (EGO_ZIP, EGO, lambda data: b"text", "not a readable Parquet file"),
        (EGO_ZIP, EGO, lambda data: changed_table(data, lambda t: t.drop(columns="qw")), "column qw is missing"),
        (EGO_ZIP, EGO, lambda data: changed_table(data, lambda t: t[::-1]), "strictly increasing"),
        (EGO_ZIP, EGO, lambda data: changed_table(data, lambda t: t.assign(timestamp=t.timestamp / 1e6)), "int64"),
        (EGO_ZIP, EGO, lambda data: changed_table(data, lambda t: t.assign(x=np.inf)), "x, y, z hold values"),
        (EGO_ZIP, EGO, lambda data: changed_table(data, lambda t: t.assign(vx=np.nan)), "column vx .* none missing"),
        (EGO_ZIP, EGO, lambda data: changed_table(data, lambda t: t.assign(x="1")), "column x is"),
        (
            EGO_ZIP,
            EGO,
            lambda data: changed_table(data, lambda t: t.assign(qx=0.0, qy=0.0, qz=0.0, qw=0.0)),
            "unit length",
        ),
        (FRONT_ZIP, FRONT_MP4, lambda data: data[: len(data) // 3], "the video cannot be decoded"),
        (FRONT_ZIP, FRONT_MP4, lambda data: b"", "the video cannot be decoded"),
        (FRONT_ZIP, FRONT_TIMES, lambda data: changed_table(data, lambda t: t[:1]), "at least two"),
    ],
)
def test_damaged_members_are_named(store, path, member, change, message):
    rewrite_member(store.root / path, member, change)
    with pytest.raises(InputError, match=message) as error:
        store.load_sample(key_of(store))
    assert member in str(error.value)


def test_too_few_frames_are_named(store):
    rewrite_member(
        store.root / FRONT_ZIP,
        FRONT_TIMES,
        lambda data: changed_table(data, lambda t: pd.DataFrame({"timestamp": np.arange(900) * 10_000})),
    )
    with pytest.raises(InputError, match=r"has no frame 170"):
        store.load_sample(key_of(store))


@pytest.mark.parametrize("path", [EGO_ZIP, FRONT_ZIP, "clip_index.parquet", "clips.parquet"])
def test_files_cut_off_or_gone_are_named(store, path):
    file = store.root / path
    whole = file.read_bytes()
    for damage in (lambda: file.write_bytes(whole[: len(whole) // 2]), file.unlink):
        damage()
        with pytest.raises(InputError, match=path.split("/")[-1]):
            ClipStore(store.root).load_sample(key_of(store))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.reset_index(), "written as a pandas index"),
        (lambda table: table.assign(chunk=table["chunk"].astype(float)), "column chunk is float64"),
        (lambda table: table.drop(columns="chunk"), "column chunk is missing"),
        (lambda table: pd.concat([table, table]), "more than once"),
        (lambda table: table.set_axis(pd.Index(["a", "b"], name="clip_id")), "clip id 'a' is not a UUID"),
        (lambda table: table[1:], "no row for clip"),
    ],
)
def test_wrong_clip_index_is_refused(store, change, message):
    path = store.root / "clip_index.parquet"
    change(pd.read_parquet(path)).to_parquet(path)
    with pytest.raises(InputError, match=message):
        ClipStore(store.root).load_sample(key_of(store))


def test_wrong_calibration_is_refused(store):
    path = store.root / "calibration/camera_intrinsics/camera_intrinsics.chunk_0000.parquet"
    table = pd.read_parquet(path)
    table.drop(columns="bw_poly_1").to_parquet(path)
    with pytest.raises(InputError, match="column bw_poly_1 is missing"):
        store.read_camera(CLIP, FRONT_WIDE)
    table.reset_index().to_parquet(path)
    with pytest.raises(InputError, match="clip_id, camera_name"):
        store.read_camera(CLIP, FRONT_WIDE)
    table.drop(index=(CLIP, FRONT_WIDE)).to_parquet(path)
    with pytest.raises(InputError, match="no row for"):
        store.read_camera(CLIP, FRONT_WIDE)


def test_a_clip_table_of_another_version_is_refused(store):
    path = store.root / "clips.parquet"
    pq.write_table(pq.read_table(path).replace_schema_metadata({"table_version": "0"}), path)
    with pytest.raises(InputError, match="table_version"):
        ClipStore(store.root).clips()


def test_what_is_not_there_is_an_error(store, tmp_path):
    with pytest.raises(InputError, match="not a clip store"):
        ClipStore(tmp_path / "empty").clips()
    with pytest.raises(InputError, match="no clip "):
        store.load_sample(key_of(store, "nobody"))
    with pytest.raises(InputError, match="covers 0 to 8900000 us"):
        store.read_frames(CLIP, FRONT_WIDE, np.array([9_000_000]))


def test_policy_cameras_are_all_stored(store):
    for camera in POLICY_CAMERAS:
        with zipfile.ZipFile(store.root / f"camera/{camera}/{camera}.chunk_0000.zip") as archive:
            assert archive.namelist() == [
                f"{make_clip_id(name)}.{camera}.{suffix}"
                for name in ("bend", "other")
                for suffix in ("mp4", "timestamps.parquet")
            ]
            assert all(entry.compress_type == zipfile.ZIP_STORED for entry in archive.infolist())
