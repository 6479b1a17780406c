"""Connections to an object store, with retries and readable errors.

Address and credentials come from the environment variables that every S3 client reads::

    AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN
    AWS_REGION or AWS_DEFAULT_REGION
    AWS_ENDPOINT_URL              of a server other than Amazon's, http:// or https://

Without AWS_ACCESS_KEY_ID they come from a profile of the AWS command line: `backends.aws_profile`.

A request that reaches no server, or a failing one, is retried with growing pauses. The first
request of a process gives up sooner: a wrong address is more likely than an outage.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from functools import lru_cache
from typing import TYPE_CHECKING

from palpate.storage.backends.aws_profile import Profile, read_profile
from palpate.storage.backends.object_path import ObjectPath
from palpate.storage.errors import StoreError

if TYPE_CHECKING:
    from obstore.store import S3Store

FIRST_PATIENCE_S = 20.0
PATIENCE_S = 300.0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 3.0
CONNECT_S, REQUEST_S = 5.0, 60.0
MOST_RETRIES = 100_000  # in practice the patience ends first

_ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
_WHO = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN")
_REGIONS = ("AWS_REGION", "AWS_DEFAULT_REGION")
REGION = "us-east-1"

_reached: set[str] = set()
"""Buckets that have responded to this process."""


def client_of(place: ObjectPath) -> "S3Store":
    """Return the connection to a bucket, cached for each environment.

    Raises
    ------
    StoreError
        If obstore is not installed, or a profile cannot be used.
    """
    patience_s = PATIENCE_S if place.bucket in _reached else FIRST_PATIENCE_S
    who = tuple(os.environ.get(name, "") for name in _WHO)
    return _client(place.bucket, _access(), who, patience_s)


def endpoint() -> str:
    """Return the address of the server; empty for Amazon S3."""
    return _access().endpoint_url


def _access() -> Profile:
    """Return the settings of the environment, completed by a profile if it has no keys.

    Raises
    ------
    StoreError
        If the profile cannot be used.
    """
    profile = Profile() if os.environ.get("AWS_ACCESS_KEY_ID") else read_profile()
    return replace(
        profile,
        region=_stated(_REGIONS) or profile.region or REGION,
        endpoint_url=_stated(_ENDPOINTS) or profile.endpoint_url,
    )


def _stated(names: tuple[str, ...]) -> str:
    return next((os.environ[name] for name in names if os.environ.get(name)), "")


@contextmanager
def explained(place: ObjectPath) -> Iterator[None]:
    """Turn errors of a request into a `StoreError` with advice.

    Raises
    ------
    FileNotFoundError
        If the object does not exist.
    """
    from obstore.exceptions import BaseError

    try:
        yield
    except FileNotFoundError as error:
        if "NoSuchBucket" in str(error):
            raise _no_bucket(place) from error
        raise
    except BaseError as error:
        raise _explanation(place, error) from error
    _reached.add(place.bucket)


@lru_cache(maxsize=16)
def _client(bucket: str, access: Profile, who: tuple[str, ...], patience_s: float) -> "S3Store":
    try:
        from obstore.store import S3Store
    except ImportError as error:
        raise StoreError(
            f"s3://{bucket} is an object store, which needs obstore. Install it everywhere with "
            "`pip install 'palpate[s3]'`, or give a local folder."
        ) from error
    said = {
        "region": access.region,
        "endpoint": access.endpoint_url,
        "access_key_id": access.access_key_id,
        "secret_access_key": access.secret_access_key,
        "session_token": access.session_token,
    }
    options = {name: value for name, value in said.items() if value}
    return S3Store(
        bucket,
        config=options,  # type: ignore[arg-type]  # a dictionary with the keys it names
        client_options={
            "allow_http": access.endpoint_url.startswith("http://"),
            "connect_timeout": timedelta(seconds=CONNECT_S),
            "timeout": timedelta(seconds=REQUEST_S),
        },
        retry_config={
            "max_retries": MOST_RETRIES,
            "retry_timeout": timedelta(seconds=patience_s),
            "backoff": {
                "init_backoff": timedelta(seconds=FIRST_PAUSE_S),
                "max_backoff": timedelta(seconds=LONGEST_PAUSE_S),
                "base": 2,
            },
        },
    )


def _no_bucket(place: ObjectPath) -> StoreError:
    return StoreError(
        f"There is no bucket {place.bucket} at {_server()}. Create it, or check its name and "
        "AWS_ENDPOINT_URL."
    )


def _explanation(place: ObjectPath, error: Exception) -> StoreError:
    from obstore.exceptions import PermissionDeniedError, UnauthenticatedError

    text = str(error)
    if "NoSuchBucket" in text:
        return _no_bucket(place)
    if "169.254." in text:
        return StoreError(
            f"{place} cannot be used: there are no credentials. Set AWS_ACCESS_KEY_ID and "
            "AWS_SECRET_ACCESS_KEY, or write them to ~/.aws/credentials with `aws configure`, "
            "here and on the workers."
        )
    if isinstance(error, PermissionDeniedError | UnauthenticatedError):
        return StoreError(
            f"{place} cannot be used: {_server()} refuses access{_code(text)}. Check "
            "AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY or the profile (AWS_PROFILE), and their "
            "permissions for this bucket."
        )
    if _is_unreached(text):
        return StoreError(
            f"{place} cannot be reached at {_server()}{_tried(text)}. Check AWS_ENDPOINT_URL and "
            "the network. Stored results are kept: run the command again to continue."
        )
    return StoreError(f"{place} cannot be used: {_first(text)}. Check the server and its log.")


def was_cut_off(error: Exception) -> bool:
    """Return True if a request got no response and was not retried."""
    return _is_unreached(str(error)) and not _tried(str(error))


def _is_unreached(text: str) -> bool:
    return "HTTP error" in text or "error sending request" in text


def _server() -> str:
    return endpoint() or "Amazon S3"


def _code(text: str) -> str:
    """Return the server's error code, such as (InvalidAccessKeyId)."""
    _, found, rest = text.partition("<Code>")
    return f" ({rest.partition('</Code>')[0]})" if found else ""


def _tried(text: str) -> str:
    """Return the number and duration of attempts, from obstore's message."""
    tried = re.search(r" in (?P<seconds>[\d.]+)s, after (?P<retries>\d+) retries", text)
    if tried is None:
        return ""
    return f", tried {int(tried['retries']) + 1} times in {float(tried['seconds']):.0f} s"


def _first(text: str) -> str:
    """Return the first line of an error; obstore's further lines are for its developers."""
    return text.partition("\n")[0].strip().rstrip(".")
