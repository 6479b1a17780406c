"""The HTTP API of a service as an ASGI application, and the server that runs until asked to stop.

The API is described by /api/v1/openapi.json.
"""

import logging
import socket
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from typing import Annotated, Any

import uvicorn
from fastapi import APIRouter, Depends, FastAPI, HTTPException, Request, Response
from fastapi import Path as PathParameter
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, PlainTextResponse
from starlette.exceptions import HTTPException as StarletteHTTPException

from palpate.service.installed_packages import palpate_version
from palpate.service.server.api_models import (
    PREFIX,
    ClusterView,
    Health,
    Problem,
    SessionView,
    SignIn,
    UploadList,
    UploadView,
    public_text,
)
from palpate.service.server.http import job_routes, live_page_routes
from palpate.service.server.http.request_checks import (
    COOKIE,
    Connection,
    Credentials,
    Guard,
    Here,
    RequestLimit,
    StrictRoute,
    Writer,
    allow_open_files,
    is_loopback,
    owner_of,
    reader,
    sign_in,
)
from palpate.service.server.http.service_views import metrics
from palpate.service.server.jobs.home_and_tokens import NAME_PATTERN
from palpate.service.server.jobs.job_queue import StateError
from palpate.service.server.jobs.untrusted_inputs import ConflictError, TooLargeError, texts
from palpate.service.server.running_service import Service
from palpate.storage.errors import InputError, PalpateError

_log = logging.getLogger(__name__)

ABOUT = """Studies and diagnoses of Palpate on one cluster. Write access needs a token
(`Authorization: Bearer TOKEN`). Infinite scores are the strings "-inf" and "inf"."""

Name = Annotated[str, PathParameter(pattern=NAME_PATTERN)]


def create_app(
    service: Service, *, hosts: Iterable[str] = (), stopping: Callable[[], bool] = lambda: False
) -> FastAPI:
    """Return the application of a service.

    Parameters
    ----------
    service : Service
    hosts : iterable of str
        Host names it accepts, in addition to those of this machine.
    stopping : callable
        Whether streams must end.
    """
    app = FastAPI(
        title="Palpate",
        version=palpate_version(),
        description=ABOUT,
        openapi_url=f"{PREFIX}/openapi.json",
        docs_url=None,  # its page would load scripts from elsewhere
        redoc_url=None,
        redirect_slashes=False,
        max_body_size=service.limits.body_bytes,
    )
    app.state.service, app.state.stopping, app.state.streams = service, stopping, 0
    app.include_router(job_routes.router, prefix=PREFIX)
    app.include_router(live_page_routes.watch_router, prefix=PREFIX)
    app.include_router(live_page_routes.page_router)
    app.include_router(_uploads(service), prefix=PREFIX)
    app.include_router(_about(), prefix=PREFIX)
    app.add_api_route("/metrics", _metrics, tags=["service"], response_class=PlainTextResponse)
    app.add_middleware(RequestLimit)
    app.add_middleware(Guard, hosts=hosts)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(StarletteHTTPException, _refused)
    app.add_exception_handler(PalpateError, _refused_by_palpate)
    app.add_exception_handler(Exception, _crashed)
    return app


def _problems(*codes: int) -> dict[int | str, dict[str, Any]]:
    return {code: {"model": Problem} for code in codes}


def _about() -> APIRouter:
    router = APIRouter(
        tags=["service"], responses=_problems(400, 401, 403, 421, 422), route_class=StrictRoute
    )

    @router.get("/health")
    def get_health(service: Here) -> Health:
        """Return the state of the service; needs no token."""
        return Health(version=palpate_version(), cluster=service.runner.cluster is not None)

    @router.get("/cluster", dependencies=[Depends(reader)])
    def get_cluster(service: Here) -> ClusterView:
        """Return the capacity and load of the cluster."""
        runner = service.runner
        cluster = runner.cluster
        return ClusterView(
            ready=cluster is not None,
            trouble=public_text(runner.trouble),
            threads=runner.threads,
            tasks=runner.share.held,
            dashboard=cluster.dashboard if cluster else "",
            workers=service.load.workers(),
        )

    @router.get("/session")
    def get_session(service: Here, request: Request, credentials: Credentials) -> SessionView:
        """Return the signed-in owner and role; needs no token."""
        owner = owner_of(request, service, credentials)
        return SessionView(
            owner=owner.name if owner else "",
            role=owner.role if owner else "",
            read_token=service.read_token,
        )

    @router.post("/session", status_code=204, responses=_problems(413))
    def begin_session(service: Here, request: Request, given: SignIn, response: Response) -> None:
        """Exchange a token for a cookie, which browsers send when following events."""
        sign_in(service, given, response, secure=request.url.scheme == "https")

    @router.delete("/session", status_code=204)
    def end_session(response: Response) -> None:
        """Remove the cookie."""
        response.delete_cookie(COOKIE)

    return router


def _uploads(service: Service) -> APIRouter:
    router = APIRouter(
        tags=["uploads"],
        dependencies=[Depends(reader)],
        responses=_problems(400, 401, 403, 421, 422),
    )

    @router.get("/uploads")
    def list_uploads(service: Here) -> UploadList:
        """List all uploads."""
        return UploadList(uploads=[UploadView(**vars(one)) for one in service.uploads.list()])

    @router.put(
        "/uploads/{folder}/{file}",
        status_code=201,
        responses=_problems(409, 413),
        max_body_size=service.limits.upload_bytes,
        openapi_extra={"requestBody": {"content": {"application/octet-stream": {}}}},
    )
    async def upload(
        service: Here, _: Writer, request: Request, folder: Name, file: Name
    ) -> UploadView:
        """Upload an image, a case or a recording unchanged. An upload cannot be changed later."""
        return UploadView(**vars(await service.uploads.save(folder, file, request.stream())))

    @router.delete("/uploads/{folder}", status_code=204, responses=_problems(404, 409))
    def remove_uploads(service: Here, _: Writer, folder: Name) -> None:
        """Remove a folder of uploads; no unfinished job may need it."""
        place = str(service.home.uploads / folder)
        for job in service.queue.jobs:
            named = [text for _, text in texts(dict(job.request))]
            used = any(
                t == folder or f"{t}/".startswith((f"{place}/", f"{folder}/")) for t in named
            )
            if used and job.state in ("waiting", "paused"):
                raise HTTPException(409, f"Job {job.id} needs {folder}: cancel it first.")
        if not service.uploads.remove(folder):
            raise HTTPException(404, f"There is no upload folder {folder}.")

    return router


def _metrics(service: Here, _: Annotated[None, Depends(reader)]) -> str:
    """Return metrics for Prometheus."""
    return metrics(service)


def _invalid(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    lines = [
        f"{'.'.join(str(part) for part in one['loc'])}: {one['msg']}" for one in error.errors()
    ]
    return JSONResponse({"error": "; ".join(lines)[:4000]}, 422)


def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, StarletteHTTPException)
    if error.status_code in (204, 304):
        return Response(status_code=error.status_code)
    return JSONResponse({"error": str(error.detail)}, error.status_code, headers=error.headers)


def _refused_by_palpate(request: Request, error: Exception) -> JSONResponse:
    if isinstance(error, TooLargeError):
        status = 413
    elif isinstance(error, InputError):
        status = 422
    elif isinstance(error, StateError | ConflictError):
        status = 409
    else:  # a store or a journal that cannot be used
        status = 409
    return JSONResponse({"error": public_text(str(error))}, status)


def _crashed(request: Request, error: Exception) -> JSONResponse:
    _log.error("%s %s has crashed.", request.method, request.url.path, exc_info=error)
    return JSONResponse({"error": "Internal error; see the service's log for details."}, 500)


GRACE_S = 3


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket; port 0 takes any free port.

    Raises
    ------
    InputError
        If the address is in use or does not belong to this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(256)
    except (OSError, OverflowError) as error:
        listening.close()
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"Cannot listen on {host}:{port}: {reason}. Choose another --port or --host."
        ) from error
    return listening


def url_of(listening: socket.socket) -> str:
    """Return the URL of a socket for a browser on this machine."""
    host, port = listening.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


class _Server(uvicorn.Server):
    """A server without signal handlers, so that no signal is lost while it starts."""

    def __init__(self, config: uvicorn.Config, stop: Callable[[], object]) -> None:
        super().__init__(config)
        self._stop = stop

    def capture_signals(self) -> AbstractContextManager[None]:  # type: ignore[override]
        return nullcontext()

    async def on_tick(self, counter: int) -> bool:
        if self._stop():
            self.should_exit = True
        return await super().on_tick(counter)


def serve(
    service: Service,
    listening: socket.socket,
    hosts: Iterable[str] = (),
    *,
    stop: Callable[[], object],
) -> None:
    """Serve until `stop` returns true; it is called ten times a second."""
    host = str(listening.getsockname()[0])
    if not is_loopback(host) and host not in ("0.0.0.0", "::"):
        hosts = {host, *hosts}
    app = create_app(service, hosts=hosts, stopping=lambda: server.should_exit)
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        server_header=False,
        lifespan="off",
        http=Connection,
        ws="none",
        timeout_graceful_shutdown=GRACE_S,
    )
    allow_open_files()
    server = _Server(config, stop)
    server.run(sockets=[listening])
