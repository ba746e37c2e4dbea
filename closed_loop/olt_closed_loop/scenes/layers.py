"""Whether a USD layer stands alone, as those of a scene do: one payload, the looks beside it, and no other arc.

USD composes a stage from whatever a layer points to: files anywhere, and prims of its own in cycles or in powers of
two. A scene needs none of it, so it is refused before anything is composed, not left out with a warning.
"""

# pyright: reportAttributeAccessIssue=false

from pathlib import Path
from typing import Any

from pxr import Sdf, Tf

from olt_generator.errors import InputError

SUFFIXES = (".usd", ".usda", ".usdc")


def open_layer(path: Path, payload_at: str | None = None) -> Any:
    """The layer (`pxr.Sdf.Layer`) of a file that composes nothing but one payload beside it, at the prim `payload_at`.

    Raises:
        InputError: there is no such file, it is no layer, or points elsewhere.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the .usda or .usdc file of a scene, with its looks beside it")
    try:
        layer = Sdf.Layer.FindOrOpen(str(path))
    except Tf.ErrorException:
        layer = None
    if layer is None:
        raise InputError(f"{path}: not a USD stage; give the .usda or .usdc file of a scene")
    if layer.subLayerPaths:
        raise InputError(f"{path}: has the sublayer {layer.subLayerPaths[0]:.80}; a scene is in one file: flatten it")
    open_ = list(layer.rootPrims)
    while open_:
        prim = open_.pop()
        arc = _arc(prim)
        if arc or (prim.hasPayloads and prim.path != payload_at):
            raise InputError(
                f"{path}: prim {str(prim.path)[-80:]} has {arc or 'a payload'}; a scene is in one file: flatten it"
            )
        open_ += prim.nameChildren
    return layer


def payload_beside(layer: Any, place: str, path: Path) -> Path:
    """The file that is the payload of the prim at `place` of the layer at `path`.

    Raises:
        InputError: there is not exactly one, or it is not beside the file.
    """
    prim = layer.GetPrimAtPath(place)
    payloads = prim.payloadList.GetAddedOrExplicitItems() if prim else []
    names = [payload.assetPath.removeprefix("./") for payload in payloads]
    beside = [name for name in names if Path(name).name == name != path.name and name.endswith(SUFFIXES)]
    if len(names) != 1 or names != beside:
        raise InputError(f"{path}: the payload of prim {place} is not one file beside it; write the scene again")
    return path.with_name(names[0])


def _arc(prim: Any) -> str | None:
    """What else a prim is composed from, in words."""
    arcs = {
        "references": prim.hasReferences,
        "inherited prims": prim.hasInheritPaths,
        "specialized prims": prim.hasSpecializes,
        "variants": prim.HasInfo("variantSetNames"),
        "value clips": prim.HasInfo("clips") or prim.HasInfo("clipSets"),
    }
    return next((arc for arc, there in arcs.items() if there), None)
