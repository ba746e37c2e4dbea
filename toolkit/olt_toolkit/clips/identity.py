"""Ids of clips: what a clip shows and what it is, and not how large, by which estimators or under which name."""

from olt_toolkit.clips.clip import ClipKind, make_clip_id
from olt_toolkit.policy.window import Span
from olt_toolkit.rigs.names import Backend, FrontLens


def clip_id_of(
    scene_id: str,
    take: str,
    window_us: Span,
    kind: ClipKind,
    seed: int = 0,
    front: FrontLens = FrontLens.AS_NAMED,
    backend: str = Backend.GEOMETRIC.value,
) -> str:
    """The id of the clip of these moments of a scene; the same wherever and by whatever command it is made.

    A clip that is only indexed has the id that it gets when it is built of true views, because it is known before
    anyone says how clips are built. Width, estimators and the like are therefore no part of it: a store holds a moment
    once, tells how it was built (`clips.build_options`), and refuses it built otherwise. Two front views of the same
    moments that are wanted side by side are two clips; a true front view is the same with each lens. So are views that
    two backends made; clips without such views are the same with each backend.

    Args:
        scene_id, take: those of the `Drive`.
        window_us: drive times of the first and the last front image.
    """
    made_by = [f"backend {backend}"] if kind == "Syn" and backend != Backend.GEOMETRIC.value else []
    changed = kind != "GT" and front is not FrontLens.AS_NAMED
    return make_clip_id(scene_id, take, *window_us, kind, seed, *([front.value] if changed else []), *made_by)
