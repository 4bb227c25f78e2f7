"""What a sharp photo shows of the skin, and what of it is in the maps: ``python -m benchmarks.detail``."""
