"""Many photos into as many archives, on one machine, on several, or at a server.

``driver`` plans and watches, ``shards`` makes about a hundred photos at a time, ``makers`` makes one.
"""
