"""Many photos into as many archives, on one machine, on several, or at a server.

``driver`` plans and watches, ``shards`` makes up to a hundred photos at a time, ``makers`` makes one.
"""
