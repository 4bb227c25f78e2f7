"""The photo's own detail: what it holds beyond the texture of 576 x 384, brought onto maps of any size."""
