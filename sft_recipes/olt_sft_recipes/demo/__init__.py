"""The main job: from one front-camera video to closed-loop scores, every step once, small. Read `main_job`."""
