"""Authentication by a bearer token, or by the cookie that it was exchanged for."""

from typing import Annotated

from fastapi import Depends, HTTPException, Request, Response
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from palpate.service.server.api import SignIn
from palpate.service.server.jobs.queue import Job
from palpate.service.server.jobs.tokens import Owner
from palpate.service.server.service import Service

COOKIE = "palpate_token"
COOKIE_S = 30 * 24 * 3600

_bearer = HTTPBearer(auto_error=False, description="A token created by `palpate token new NAME`.")
Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]


def service_of(request: Request) -> Service:
    """Return the service of a request."""
    service: Service = request.app.state.service
    return service


Here = Annotated[Service, Depends(service_of)]


def owner_of(
    request: Request, service: Service, credentials: HTTPAuthorizationCredentials | None
) -> Owner | None:
    """Return the owner of a request's token; None without a valid token."""
    given = credentials.credentials if credentials else request.cookies.get(COOKIE, "")
    return service.tokens.holder(given) if given else None


def known(request: Request, service: Here, credentials: Credentials) -> Owner:
    """Return the owner of a request's token.

    Raises
    ------
    HTTPException
        401 without a valid token.
    """
    owner = owner_of(request, service, credentials)
    if owner is None:
        given = credentials or request.cookies.get(COOKIE)
        what = "This token is not valid" if given else "This needs a token"
        raise HTTPException(
            401,
            f"{what}: send `Authorization: Bearer TOKEN`. `palpate token new NAME` creates one.",
            {"WWW-Authenticate": "Bearer"},
        )
    return owner


def writer(owner: Annotated[Owner, Depends(known)]) -> Owner:
    """Return the owner of a token that allows writing.

    Raises
    ------
    HTTPException
        401 without a valid token, 403 with a read-only one.
    """
    if not owner.submits:
        raise HTTPException(
            403,
            f"The token {owner.name} is read-only. `palpate token new NAME --role submit` creates "
            "one that can upload and submit.",
        )
    return owner


def check_may_change(owner: Owner, job: Job) -> None:
    """Refuse a request to change a job by anyone but its owner or an admin.

    Raises
    ------
    HTTPException
        403
    """
    if not owner.may_change(job.owner):
        raise HTTPException(
            403,
            f"{job.id} was submitted by {job.owner}: only that token, or an admin's, "
            "can change it.",
        )


def still_reads(request: Request, service: Service) -> bool:
    """Check whether a request in progress would still be allowed to read."""
    if not service.read_token:
        return True
    scheme, _, given = request.headers.get("Authorization", "").partition(" ")
    token = given.strip() if scheme.lower() == "bearer" else request.cookies.get(COOKIE, "")
    return bool(token) and service.tokens.owner(token) is not None


def reader(request: Request, service: Here, credentials: Credentials) -> None:
    """Refuse a request without read access; without ``--read-token`` everyone has it.

    Raises
    ------
    HTTPException
        401 without a valid token.
    """
    if service.read_token:
        known(request, service, credentials)


Writer = Annotated[Owner, Depends(writer)]


def sign_in(service: Service, given: SignIn, response: Response, *, secure: bool) -> None:
    """Store a token in a cookie that scripts cannot read and other sites do not send.

    Raises
    ------
    HTTPException
        401 if the token is not valid.
    """
    if service.tokens.owner(given.token) is None:
        raise HTTPException(401, "This token is not valid.", {"WWW-Authenticate": "Bearer"})
    response.set_cookie(
        COOKIE, given.token, COOKIE_S, httponly=True, samesite="strict", secure=secure
    )
