"""What lies between the bytes of a video file and the pictures that a player shows of it."""
