"""The place of a store: a local folder, or a prefix in a bucket.

A `Location` is typed by a user and sent to the workers; a `Place` addresses the parts of a
store. Both kinds of place have ``/``, ``name``, ``stem``, ``suffix`` and ``parent``; their
operations are in `storage.backends.contract`.
"""

import re
from pathlib import Path

from palpate.storage.backends.object_path import SCHEMES, ObjectPath, object_path
from palpate.storage.errors import StoreError

Place = Path | ObjectPath
Location = str | Path | ObjectPath

# Making a Path of a URL drops one of its slashes.
_URL = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]+):/+(?P<rest>.*)")


def place_of(location: Location) -> Place:
    """Return the place of a location; a local one is absolute.

    Parameters
    ----------
    location : str, Path or ObjectPath
        A folder (``~`` is the user's home), or ``s3://``, ``gs://`` or ``az://BUCKET/PREFIX``.

    Raises
    ------
    StoreError
        If it is a URL of another kind, or names no bucket.
    """
    if isinstance(location, ObjectPath):
        return location
    url = _URL.fullmatch(str(location))
    if url is None:
        return Path(location).expanduser().absolute()
    for scheme in SCHEMES:
        if url["scheme"].lower() == scheme:
            return object_path(scheme, url["rest"], location)
    raise StoreError(
        f"{location} is a URL ({url['scheme']}), but stores are kept in local folders and in "
        "object stores only. Give a folder that all workers can reach, such as /data/palpate, or "
        "s3://, gs:// or az://BUCKET/PREFIX."
    )
