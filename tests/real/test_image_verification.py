"""What the images of real drives say: they pass as they are, and what is wrong with them is found or not compared."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from olt_generator.cameras import PinholeCamera
from olt_generator.trajectory import Trajectory
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.camera_checks import CAMERA_NAME, OWN_VIDEO
from olt_toolkit.clips.verification.clip_evidence import gather_evidence
from olt_toolkit.clips.verification.decoded_videos import ClipVideos
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.image_checks import check_images
from olt_toolkit.clips.verification.image_evidence import ImageEvidence
from olt_toolkit.clips.verification.motion_checks import (
    FRAME_ORDER,
    MIRRORED,
    MOTION,
    MOTION_OF_CLIP,
    MOTION_SCALE,
    MOTION_SIDES,
    check_motion,
)
from olt_toolkit.clips.verification.neighbour_checks import NEIGHBOURS
from olt_toolkit.commands.clip import app
from olt_toolkit.rigs.rig import (
    CROSS_LEFT,
    CROSS_RIGHT,
    DEFAULT_VEHICLE,
    FRONT_WIDE,
    REAR_LEFT,
    REAR_RIGHT,
    REAR_TELE,
)

from ..toolkit.clips.verification.blob_world import failed, look

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
KITTI_RAW = "kitti_raw_2011_09_26_drive_0013"
DRIVES = (KITTI_RAW, "kitti_odometry_06_first51_gray", "kitti_slow_traffic_lidar_poses")
# By which check; what is not here is not compared: drives that are straight, slow, or move alike.
FOUND = {
    (DRIVES[0], "mirrored"): MIRRORED,
    (DRIVES[0], "reversed"): MOTION,
    (DRIVES[1], "reversed"): FRAME_ORDER,
    (DRIVES[2], "other"): MOTION_OF_CLIP,
}
SIX_CAMERAS = {
    "CAM_FRONT": FRONT_WIDE,
    "CAM_FRONT_LEFT": CROSS_LEFT,
    "CAM_FRONT_RIGHT": CROSS_RIGHT,
    "CAM_BACK_LEFT": REAR_LEFT,
    "CAM_BACK_RIGHT": REAR_RIGHT,
    "CAM_BACK": REAR_TELE,
}


def make_real_clip(name, streams, motion):
    """A clip of real images, with the motion that was measured."""
    return Clip(
        clip_id=make_clip_id("real", name),
        name=name,
        scene_id=name,
        source="real",
        origin=ClipOrigin(name, 0, int(next(iter(streams.values())).timestamps_us[-1])),
        kind="GT",
        category="nominal",
        factors=(),
        split="train",
        streams=streams,
        ego_motion=EgoMotion.from_trajectory(motion),
        vehicle=DEFAULT_VEHICLE,
        provenance={camera: ViewProvenance("observed", "test", "1", None, 1.0, 0.0) for camera in streams},
    )


def verdict_of(findings, check, where=""):
    return next(each for each in findings if each.check == check and each.where.endswith(where))


def with_frames(clip, **frames):
    changed = {
        camera: replace(clip.streams[camera], frames=np.ascontiguousarray(new)) for camera, new in frames.items()
    }
    return replace(clip, streams=clip.streams | changed)


def read_front_clip(shared_real, name):
    """The front camera of a drive of KITTI at 480 pixels across, with the motion of its sensors."""
    opened = open_recording(shared_real / name, OpenOptions(width=480))
    height = opened.frames.shape[1] // 2 * 2
    lens = opened.camera.cropped(0, 0, 480, height)
    times_us = opened.timestamps_us
    stream = CameraStream(opened.frames[:, :height], times_us, 10.0, lens, opened.T_rig_camera)
    return make_real_clip(name, {FRONT_WIDE: stream}, opened.reference)


@pytest.fixture(scope="module")
def front_clips(shared_real):
    return {name: read_front_clip(shared_real, name) for name in DRIVES}


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
def test_nothing_is_said_of_a_real_front_camera(front_clips, drive, tmp_path):
    others = [clip for name, clip in front_clips.items() if name != drive]
    findings = look(tmp_path, front_clips[drive], *others)
    assert failed(findings) == set()
    assert all(each.detail for each in findings)
    expected = Verdict.NOT_COMPARED if "slow" in drive else Verdict.PASSED
    assert verdict_of(findings, MOTION).verdict is expected


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize(
    ("fault", "check"), [("mirrored", MIRRORED), ("reversed", FRAME_ORDER), ("other", MOTION_OF_CLIP)]
)
def test_a_fault_of_a_real_front_camera_is_found_or_not_compared(front_clips, drive, fault, check, tmp_path):
    clip, frames = front_clips[drive], front_clips[drive].streams[FRONT_WIDE].frames
    others = [other for name, other in front_clips.items() if name != drive]
    bad = {
        "mirrored": lambda: with_frames(clip, **{FRONT_WIDE: frames[:, :, ::-1]}),
        "reversed": lambda: with_frames(clip, **{FRONT_WIDE: frames[::-1]}),
        "other": lambda: replace(clip, ego_motion=others[0].ego_motion),
    }[fault]()
    findings = look(tmp_path, bad, *others)
    if (drive, fault) in FOUND:
        assert FOUND[drive, fault] in failed(findings)
    else:
        assert verdict_of(findings, check).verdict is Verdict.NOT_COMPARED


@pytest.fixture(scope="module")
def six_cameras(shared_real):
    """One instant of nuScenes as a clip in which the vehicle stands."""
    folder = shared_real / "nuscenes_scene_0061_six_cameras"
    records = json.loads((folder / "calibration_and_boxes.json").read_text())["cameras"]
    times_us = 100_000 * np.arange(20, dtype=np.int64)
    streams = {}
    for name, camera in SIX_CAMERAS.items():
        record = records[name]
        image = cv2.resize(
            cv2.imread(str(folder / record["file"]))[..., ::-1], (480, 270), interpolation=cv2.INTER_AREA
        )
        (fx, _, cx), (_, fy, cy), _ = record["cam2img"]
        lens = PinholeCamera(1600, 900, fx, fy, cx, cy).resized(480, 270)
        streams[camera] = CameraStream(
            np.repeat(image[None], 20, axis=0), times_us, 10.0, lens, np.array(record["cam2ego"])
        )
    return make_real_clip("nuscenes", streams, Trajectory(times_us, np.repeat(np.eye(4)[None], 20, axis=0)))


def test_six_real_cameras_pass_or_are_not_compared(six_cameras, tmp_path):
    findings = look(tmp_path, six_cameras)
    assert failed(findings) == set()
    assert {each.check for each in findings if each.verdict is Verdict.PASSED} == {OWN_VIDEO}
    assert "stands" in verdict_of(findings, MOTION).detail


@pytest.mark.slow
def test_faults_of_six_real_cameras_that_stand_are_not_compared(six_cameras, tmp_path):
    left, right = (six_cameras.streams[camera].frames for camera in (CROSS_LEFT, CROSS_RIGHT))
    swapped = look(tmp_path / "swapped", with_frames(six_cameras, **{CROSS_LEFT: right, CROSS_RIGHT: left}))
    mirrored = look(tmp_path / "mirrored", with_frames(six_cameras, **{CROSS_LEFT: left[:, :, ::-1]}))
    for findings, check in ((swapped, CAMERA_NAME), (mirrored, MIRRORED), (mirrored, FRAME_ORDER)):
        told = verdict_of(findings, check, CROSS_LEFT)
        assert told.verdict is Verdict.NOT_COMPARED and told.detail
    assert verdict_of(swapped, NEIGHBOURS).verdict is Verdict.NOT_COMPARED
    doubled = look(tmp_path / "doubled", with_frames(six_cameras, **{CROSS_RIGHT: left}))
    assert OWN_VIDEO in failed(doubled)


@pytest.fixture(scope="module")
def store(shared_real, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kitti") / "store"
    drive = shared_real / KITTI_RAW
    result = CliRunner().invoke(app, ["build", str(drive), "--out", str(folder), "--no-verify"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return ClipStore(folder)


@pytest.mark.slow
def test_images_of_a_real_drive_fit_their_clip(store):
    clip_id = store.clips()[0].clip_id
    findings = list(check_images(store, clip_id, ClipVideos(store, clip_id)))
    assert [each for each in findings if each.verdict is Verdict.FAILED] == []
    assert any(each.check == MOTION and each.verdict is Verdict.PASSED for each in findings)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["mirrored", "backward", "cm"])
def test_a_wrong_motion_of_a_real_drive_is_found(store, fault):
    info = store.clips()[0]
    clip = gather_evidence(store, info.clip_id, list(info.views), ClipVideos(store, info.clip_id))
    poses = clip.ego_motion.trajectory.T_world_rig.copy()
    if fault == "cm":
        poses[:, :3, 3] *= 100.0
    wrong = {"mirrored": MIRROR @ poses @ MIRROR, "backward": poses[::-1], "cm": poses}[fault]
    motion = EgoMotion.from_trajectory(Trajectory(clip.ego_motion.trajectory.timestamps_us, wrong))
    evidence = {camera: ImageEvidence(each.steps, motion) for camera, each in clip.evidence.items()}
    findings = check_motion(type(clip)(clip.clip_id, motion, clip.mounted, clip.images, evidence, {}))
    expected = {"mirrored": MOTION_SIDES, "backward": MOTION, "cm": MOTION_SCALE}[fault]
    assert expected in {each.check for each in findings if each.verdict is Verdict.FAILED}
