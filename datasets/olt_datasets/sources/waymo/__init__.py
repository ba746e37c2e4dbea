"""The Waymo Open data set for end-to-end driving."""
