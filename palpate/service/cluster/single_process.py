"""A dispatcher without a cluster: tasks run one after the other in this process."""

import traceback
from collections.abc import Callable, Iterator
from typing import TypeVar

from palpate.service.cluster.dispatch import Ending, Task, TaskCalls
from palpate.service.cluster.submission import ready
from palpate.storage.errors import StoreError

Returned = TypeVar("Returned")


class SingleProcess:
    """A `service.cluster.dispatch.TaskRunner` that runs tasks in this process, in order."""

    @property
    def threads(self) -> int:
        """Return the number of tasks that run at once."""
        return 1

    def call(self, task: Callable[..., Returned], *arguments: object) -> Returned:
        """Run one task; its exceptions are passed on unchanged."""
        return task(*arguments)

    def all(self, task: Callable[..., Returned], calls: TaskCalls) -> list[Returned]:
        """Run tasks that must not fail."""
        return [task(*arguments) for _, arguments in ready(calls)]

    def everywhere(self, task: Callable[..., Returned], *arguments: object) -> dict[str, Returned]:
        """Run one task in this process, the only one."""
        return {"this process": task(*arguments)}

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run tasks that may fail: an exception is a crash, unless it is a store error."""
        for key, arguments in ready(calls):
            try:
                yield Ending(key, "returned", task(*arguments))
            except StoreError:
                raise
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
                yield Ending(
                    key, "crashed", error=error, reason=reason, traceback=traceback.format_exc()
                )
