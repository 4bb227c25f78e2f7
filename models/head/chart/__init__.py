"""The UV chart of the head: one 3:2 image, mirror-symmetric, cut at the back."""
