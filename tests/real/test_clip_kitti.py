"""`olt clip build` on a real drive with calibration and a GPS/IMU reference."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.commands.clip import app
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.rigs.rig import FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig


@pytest.mark.slow
def test_clip_from_a_real_drive(shared_real, tmp_path):
    drive = shared_real / "kitti_raw_2011_09_26_drive_0013"
    result = CliRunner().invoke(app, ["build", str(drive), "--out", str(tmp_path), "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)

    # The drive is 139.5 m long; the camera's height of 1.65 m is all that sets the scale.
    assert summary["trajectory"]["length"] == pytest.approx(139.5, rel=0.05)
    assert summary["pose_errors"]["metric"]["ate_m"] < 5.0
    assert summary["pose_errors"]["metric"]["step_rotation_deg"] < 0.1
    before, after = summary["smoothness_before_smoothing"], summary["smoothness"]
    assert after["jerk_rms_m_s3"] < 0.2 * before["jerk_rms_m_s3"]
    assert cv2.imread(summary["pictures"]["contact_sheet"]) is not None
    assert Path(summary["pictures"]["animation"]).parent == tmp_path / "previews"

    store = ClipStore(tmp_path)
    info = store.info(summary["clip"]["clip_id"])
    assert info.kind == "Syn"
    assert info.sample_t0_us[0] == 1_700_000
    sample = store.load_sample(SampleKey(str(tmp_path), info.clip_id, info.sample_t0_us[-1]))
    assert sample.image_frames.shape == (4, 4, 3, 320, 576)
    speed = np.linalg.norm(np.diff(sample.ego_future_xyz[0], axis=0), axis=1) / 0.1
    assert ((speed > 9.0) & (speed < 14.0)).all()
    times = store.read_timestamps(info.clip_id, FRONT_WIDE)
    # Its camera is 81 degrees across and 29 high: the rest of the front-wide view is black, and said to be.
    front = info.views[FRONT_WIDE]
    assert front.observed_share == pytest.approx(0.29, abs=0.02)
    assert (front.invented_share, front.unseen_share) == (0.0, pytest.approx(1.0 - front.observed_share))
    lens, named = store.read_camera(info.clip_id, FRONT_WIDE).camera, pav_rig().fitted(576, 320)[FRONT_WIDE].camera
    assert lens.pixels_per_radian == pytest.approx(named.pixels_per_radian)
    assert (lens.cx, lens.cy) == pytest.approx((named.cx, named.cy))
    for name, view in info.views.items():
        origin = store.read_origin(info.clip_id, name, times)
        assert view.invented_share == pytest.approx((origin == PixelOrigin.INVENTED).mean())
        assert view.unseen_share == pytest.approx((origin == PixelOrigin.UNSEEN).mean())
    assert len(times) == 120
    assert np.diff(times) == pytest.approx(103_400, abs=2_000)
