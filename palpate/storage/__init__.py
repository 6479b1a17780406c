"""Volumes, meshes, records and journals: what survives a crash."""

if __name__ != "palpate.storage":
    raise ImportError("Import palpate.storage: a checkout's folder storage is a link to it.")
