"""What `olt_toolkit` gives by name."""

import subprocess
import sys

import pytest

import olt_toolkit


def test_every_name_is_there():
    names = [name for name in dir(olt_toolkit) if not name.startswith("_")]
    assert {"ClipStore", "build_clip", "open_recording", "Policy", "load_rig"} <= set(names)
    assert all(getattr(olt_toolkit, name) is not None for name in names)
    with pytest.raises(AttributeError, match="no attribute 'clip_store'"):
        olt_toolkit.clip_store  # noqa: B018


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, olt_toolkit; print([n for n in ('numpy', 'torch', 'pandas', 'cv2') if n in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert result.stdout.strip() == "[]", result.stderr
