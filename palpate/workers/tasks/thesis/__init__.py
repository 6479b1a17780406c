"""The experiments of the thesis as tasks: a small request in, a small record out.

Every task stores its part under the digest of the request and of the code that it imports, so
an interrupted experiment continues where it stopped.
"""
