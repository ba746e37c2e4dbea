"""What no work can make of a recording, told before any is done."""

from olt_generator.errors import InputError
from olt_generator.views.tele import tele_camera
from olt_generator.views.view_plan import ViewPlan
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.policy.window import Coverage, sample_times
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import FRONT_WIDE, POLICY_CAMERAS


def check_feasible(recording: Recording, options: BuildOptions, plan: ViewPlan) -> None:
    """Check the views of a plan against a recording, before motion and distances are measured for them.

    Raises:
        InputError: the front camera sees too little for the tele view, or a true view is not there.
    """
    for name, method in plan.methods.items():
        if options.use_reference_views and name in recording.views:
            continue
        if method == "cropped":
            tele_camera(recording.camera, options.width, options.height)
        elif options.use_reference_views and name != FRONT_WIDE:
            raise InputError(f"{recording.name}: no true images of {name}; let it be synthesized instead")


def why_no_sample(recording: Recording) -> str | None:
    """Why a clip of the whole recording gives no policy sample, as far as its times tell; None where it does."""
    span = int(recording.timestamps_us[0]), int(recording.timestamps_us[-1])
    _, reason = sample_times(Coverage(span, dict.fromkeys(POLICY_CAMERAS, span)))
    return reason
