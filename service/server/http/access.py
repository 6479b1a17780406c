"""Who asks: a bearer token, or the cookie that it was exchanged for."""

from typing import Annotated

from fastapi import Depends, HTTPException, Request, Response
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from palpate.service.server.api import SignIn
from palpate.service.server.service import Service

COOKIE = "palpate_token"
COOKIE_S = 30 * 24 * 3600

_bearer = HTTPBearer(auto_error=False, description="A token of `palpate token new NAME`.")
Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]


def service_of(request: Request) -> Service:
    """Return the service that a request is for."""
    service: Service = request.app.state.service
    return service


Here = Annotated[Service, Depends(service_of)]


def owner_of(
    request: Request, service: Service, credentials: HTTPAuthorizationCredentials | None
) -> str | None:
    """Return who asks; None for a stranger."""
    given = credentials.credentials if credentials else request.cookies.get(COOKIE, "")
    return service.tokens.owner(given) if given else None


def writer(request: Request, service: Here, credentials: Credentials) -> str:
    """Return who writes.

    Raises
    ------
    HTTPException
        401 without a token that is known.
    """
    owner = owner_of(request, service, credentials)
    if owner is None:
        known = credentials or request.cookies.get(COOKIE)
        what = "This token is not known" if known else "This needs a token"
        raise HTTPException(
            401,
            f"{what}: send `Authorization: Bearer TOKEN`. `palpate token new NAME` makes one.",
            {"WWW-Authenticate": "Bearer"},
        )
    return owner


def reader(request: Request, service: Here, credentials: Credentials) -> None:
    """Refuse who may not read; without ``--read-token`` everybody may.

    Raises
    ------
    HTTPException
        401 without a token that is known.
    """
    if service.read_token:
        writer(request, service, credentials)


Writer = Annotated[str, Depends(writer)]


def sign_in(service: Service, given: SignIn, response: Response, *, secure: bool) -> None:
    """Put a token into a cookie that scripts cannot read and other sites do not send.

    Raises
    ------
    HTTPException
        401 if the token is not known.
    """
    if service.tokens.owner(given.token) is None:
        raise HTTPException(401, "This token is not known.", {"WWW-Authenticate": "Bearer"})
    response.set_cookie(
        COOKIE, given.token, COOKIE_S, httponly=True, samesite="strict", secure=secure
    )
