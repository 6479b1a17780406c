"""Finished evaluations, stored by digest and shared by all studies.

A record is written last, after field and volume, so its existence guarantees theirs.
"""

from collections.abc import Mapping
from typing import Any, cast

from palpate.storage.errors import StoreError
from palpate.storage.plain import dumps, from_plain, to_plain
from palpate.storage.records.seal import seal, unseal
from palpate.storage.records.tasks import EvaluationResult
from palpate.storage.stores.store import Store, check_schema

SCHEMA_VERSION = 1


def save_evaluation(store: Store, digest: str, record: Mapping[str, Any]) -> None:
    """Write the record of an evaluation, whole or not at all.

    Parameters
    ----------
    store : Store
    digest : str
        Digest of the evaluation.
    record : mapping
        JSON-able; numbers below its top level may be infinite or NaN.

    Raises
    ------
    StoreError
        If the place cannot be written.
    """
    text = dumps({"schema_version": SCHEMA_VERSION, "record": to_plain(record)})
    store.backend.write(store.layout.evaluation(digest), seal(text).encode() + b"\n")


def load_evaluation(store: Store, digest: str) -> EvaluationResult | None:
    """Read the record of an evaluation; None if it has not finished.

    Raises
    ------
    StoreError
        If the record is damaged.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    path = store.layout.evaluation(digest)
    try:
        written, _ = unseal(store.backend.read(path))
        check_schema(written["schema_version"], SCHEMA_VERSION, path)
        return cast(EvaluationResult, from_plain(dict(written["record"])))
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(
            f"{path} is damaged: {error}. Remove that file and run the study again: this "
            "evaluation is computed again."
        ) from error
