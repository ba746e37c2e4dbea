"""What the images of a real drive say: a Syn clip of KITTI passes, and wrong motions of it are found."""

import numpy as np
import pytest
from typer.testing import CliRunner

from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.clip_evidence import gather_evidence
from olt_toolkit.clips.verification.decoded_videos import ClipVideos
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.image_checks import check_images
from olt_toolkit.clips.verification.image_evidence import ImageEvidence
from olt_toolkit.clips.verification.motion_checks import MOTION, MOTION_SCALE, MOTION_SIDES, check_motion
from olt_toolkit.commands.clip import app

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def store(shared_real, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kitti") / "store"
    drive = shared_real / "kitti_raw_2011_09_26_drive_0013"
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
