"""Migration of a store to the current schema, one version at a time.

There has been one schema so far, so there is no step yet. An interrupted step is repeated as a
whole, so it must be idempotent. The version in the description of the store is raised after each
step.
"""

from collections.abc import Callable, Mapping

from palpate.storage.backends.places import Location, place_of
from palpate.storage.errors import StoreError
from palpate.storage.stores import store as stores
from palpate.storage.stores.lock import maintaining
from palpate.storage.stores.store import Store, stored_schema, write_schema

Step = Callable[[Store], None]

STEPS: Mapping[int, Step] = {}
"""Migration steps by the version they start from; each results in the next version."""


def migrate(location: Location) -> tuple[int, int]:
    """Migrate a store to the current schema, and return the version before and after.

    No other process may use the store meanwhile.

    Raises
    ------
    StoreError
        If there is no store, it cannot be written, or another process is maintaining it.
    NewerSchemaError
        If a newer version of Palpate made the store.
    """
    store = Store(place_of(location))
    before = stored_schema(store)
    if before is None:
        raise StoreError(f"{store} is not a store: it {store.backend.why_no_store(store.root)}.")
    version = before
    if version < stores.SCHEMA_VERSION:
        with maintaining(store, "palpate store migrate"):
            while version < stores.SCHEMA_VERSION:
                STEPS[version](store)
                version += 1
                write_schema(store, version)
    return before, version
