"""Tables of clips: cut from drives, labelled, split, checked for leaks, and built."""
