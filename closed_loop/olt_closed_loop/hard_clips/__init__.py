"""Hard clips: video on which motion is hard to tell, made in the synthetic world, so that the truth is known."""
