"""A folder of photos into a folder of archives, here or at a server; ``run.py`` is the way of one photo."""
