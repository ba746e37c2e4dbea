"""Which other frames of the front camera to draw on for a view at one moment, by camera geometry alone.

Points in front of the wanted camera, at every bearing and several distances, stand for what it may see. Frames are
added one by one, each the one that shows most of what is still unseen or seen from too far, until little is gained.
"""

import numpy as np

from olt_generator.cameras import Camera
from olt_generator.poses import Array, invert, transform
from olt_generator.views.front_view import FrontView

# Metres driven between the wanted moment and a frame worth a try, forwards and backwards.
_OFFSETS = np.geomspace(1.0, 64.0, 13)
_PROBE_COLUMNS, _PROBE_ROWS = 9, 5
_PROBE_DISTANCES = np.geomspace(3.0, 48.0, 5)
# Metres under the road from which on a point cannot be seen.
_UNDERGROUND = -0.3
# A frame must show this share of the points more, or more sharply, than those already chosen.
_LEAST_GAIN = 0.01


class SourceChooser:
    """Chooses source frames for one target camera."""

    def __init__(self, front: FrontView, target: Camera, T_rig_target: Array, most: int) -> None:
        """At most `most` frames of `front` are chosen for the camera `target` mounted at `T_rig_target` (4, 4)."""
        self._front = front
        self._most = most
        # Points (m, 3) in the rig that the target may see, and their distances (m,) from it.
        u, v = (
            (np.arange(count) + 0.5) * side / count - 0.5
            for count, side in ((_PROBE_COLUMNS, target.width), (_PROBE_ROWS, target.height))
        )
        rays = target.rays(np.stack(np.meshgrid(u, v), axis=-1)).reshape(-1, 3)
        points = transform(T_rig_target, (rays * _PROBE_DISTANCES[:, None, None]).reshape(-1, 3))
        above_ground = points[:, 2] > _UNDERGROUND
        self._probes_rig = points[above_ground]
        self._probe_distance = np.repeat(_PROBE_DISTANCES, len(rays))[above_ground]

    def choose(self, index: int, given: tuple[int, ...] = ()) -> tuple[int, ...]:
        """Frames for the view at frame `index`, without that frame: the `given` ones, then the most useful first."""
        chosen = list(given)
        candidates = self._candidates(index)
        # How finely each of k frames shows each of m points (k, m): 1 as fine as the target could, 0 not at all.
        frames = np.array([index, *given, *candidates])
        T_camera_rig = invert(self._front.camera_poses[frames]) @ self._front.trajectory.T_world_rig[index]
        points = transform(T_camera_rig, self._probes_rig)
        inside = self._front.camera.project(points)[1]
        sharpness = inside * np.minimum(self._probe_distance / np.linalg.norm(points, axis=-1), 1.0)
        seen, offered = sharpness[: 1 + len(given)].max(axis=0), sharpness[1 + len(given) :]
        while len(chosen) < self._most and candidates:
            gain = np.maximum(offered - seen, 0.0).mean(axis=1)
            best = int(gain.argmax())
            if gain[best] < _LEAST_GAIN:
                break
            chosen.append(candidates[best])
            seen = np.maximum(seen, offered[best])
        return tuple(chosen)

    def _candidates(self, index: int) -> list[int]:
        """Frames near the wanted distances along the path, the nearest in time first; at standstill there are none."""
        sources, path = self._front.drawn_on, self._front.path_position
        wanted = path[index] + np.concatenate([-_OFFSETS, _OFFSETS])
        offered = path[sources]
        within = wanted[(wanted >= offered[0]) & (wanted <= offered[-1])]
        frames = set(sources[np.searchsorted(offered, within)].tolist()) - {index}
        return sorted(frames, key=lambda frame: (abs(frame - index), frame))
