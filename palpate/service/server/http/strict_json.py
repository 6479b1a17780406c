"""JSON request bodies without repeated keys."""

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import HTTPException, Request, Response
from fastapi.routing import APIRoute

from palpate.storage.errors import InputError
from palpate.workers.documents import parse_json


class _StrictRequest(Request):
    async def json(self) -> Any:
        """Return the parsed body.

        Raises
        ------
        HTTPException
            422 if a key is repeated, or the body is not JSON.
        """
        if not hasattr(self, "_json"):
            try:
                self._json = parse_json(await self.body(), "The request")
            except InputError as error:
                raise HTTPException(422, str(error)) from error
        return self._json


class StrictRoute(APIRoute):
    """A route that rejects JSON bodies with a repeated key."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of the route; see `APIRoute`."""
        handler = super().get_route_handler()

        async def handle(request: Request) -> Response:
            return await handler(_StrictRequest(request.scope, request.receive))

        return handle
