"""Who asks: a bearer token, or the cookie that it was exchanged for."""

from typing import Annotated

from fastapi import Depends, HTTPException, Request, Response
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from palpate.service.server.api import SignIn
from palpate.service.server.jobs.queue import Job
from palpate.service.server.jobs.tokens import Owner
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
) -> Owner | None:
    """Return who asks; None for a stranger."""
    given = credentials.credentials if credentials else request.cookies.get(COOKIE, "")
    return service.tokens.holder(given) if given else None


def known(request: Request, service: Here, credentials: Credentials) -> Owner:
    """Return who asks.

    Raises
    ------
    HTTPException
        401 without a token that is known.
    """
    owner = owner_of(request, service, credentials)
    if owner is None:
        given = credentials or request.cookies.get(COOKIE)
        what = "This token is not known" if given else "This needs a token"
        raise HTTPException(
            401,
            f"{what}: send `Authorization: Bearer TOKEN`. `palpate token new NAME` makes one.",
            {"WWW-Authenticate": "Bearer"},
        )
    return owner


def writer(owner: Annotated[Owner, Depends(known)]) -> Owner:
    """Return who writes.

    Raises
    ------
    HTTPException
        401 without a token that is known, 403 with one that may only read.
    """
    if not owner.submits:
        raise HTTPException(
            403,
            f"The token {owner.name} may only read. `palpate token new NAME --role submit` makes "
            "one that may upload and submit.",
        )
    return owner


def check_may_change(owner: Owner, job: Job) -> None:
    """Refuse whoever neither submitted a job nor is an admin.

    Raises
    ------
    HTTPException
        403
    """
    if not owner.may_change(job.owner):
        raise HTTPException(
            403,
            f"{job.id} was submitted by {job.owner}: only that token, or one with the role admin, "
            "may change it.",
        )


def still_reads(request: Request, service: Service) -> bool:
    """Return whether a request that is being answered would still be allowed to read."""
    if not service.read_token:
        return True
    scheme, _, given = request.headers.get("Authorization", "").partition(" ")
    token = given.strip() if scheme.lower() == "bearer" else request.cookies.get(COOKIE, "")
    return bool(token) and service.tokens.owner(token) is not None


def reader(request: Request, service: Here, credentials: Credentials) -> None:
    """Refuse who may not read; without ``--read-token`` everybody may.

    Raises
    ------
    HTTPException
        401 without a token that is known.
    """
    if service.read_token:
        known(request, service, credentials)


Writer = Annotated[Owner, Depends(writer)]


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
