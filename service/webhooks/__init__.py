"""Telling an address of the operator's choice that a job has ended.

The only part of what serves that opens a connection to somebody else. Nothing here fetches: one signed POST goes out,
to a host that the operator has listed, and of the answer only the status is read.
"""
