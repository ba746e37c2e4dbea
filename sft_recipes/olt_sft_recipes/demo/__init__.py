"""The main job: from one front-camera video to closed-loop scores, every stage once, small."""
