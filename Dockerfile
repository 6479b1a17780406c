# One image for the scheduler, the workers and the service, so that the code is the same on all.
#
# The digest is that of the index of all architectures. It was taken from public Dockerfiles that
# agree on it, for no registry could be asked where this was written; this says whether it still
# is what the tag means:  docker buildx imagetools inspect python:3.11.15-slim-bookworm
FROM python:3.11.15-slim-bookworm@sha256:d29f48a31a8b408ed19272ca1e7b10ebae13b240a27e862d3d4217c528e2e0c3 AS build

WORKDIR /source
RUN python -m venv /opt/palpate
ENV PATH=/opt/palpate/bin:$PATH

# The dependencies first: they change seldom, and their layer is kept when only code changes.
COPY pyproject.toml constraints.txt ./
RUN python -c "import tomllib; p = tomllib.load(open('pyproject.toml', 'rb'))['project']; print(*p['dependencies'], *p['optional-dependencies']['cloud'], sep='\n')" > requirements.txt \
    && pip install --no-cache-dir --disable-pip-version-check -c constraints.txt -r requirements.txt

COPY README.md LICENSE ./
COPY palpate/ palpate/
RUN pip install --no-cache-dir --disable-pip-version-check --no-deps .


FROM python:3.11.15-slim-bookworm@sha256:d29f48a31a8b408ed19272ca1e7b10ebae13b240a27e862d3d4217c528e2e0c3

RUN useradd --create-home --uid 1000 palpate \
    && install --directory --owner palpate --group palpate /data /objects /home/palpate/.cache
COPY --from=build /opt/palpate /opt/palpate

# PYTHONSAFEPATH: a folder beside a study must not shadow a package.
# One thread per evaluation, the cores are used by more workers; memory that is freed is kept
# for the next evaluation. Compiled kernels are
# kept in the home folder, for the packages are not writable.
ENV PATH=/opt/palpate/bin:$PATH \
    PYTHONSAFEPATH=1 \
    PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/home/palpate/.cache/numba \
    MPLCONFIGDIR=/home/palpate/.cache/matplotlib \
    NUMBA_NUM_THREADS=1 \
    OMP_NUM_THREADS=1 \
    OPENBLAS_NUM_THREADS=1 \
    MKL_NUM_THREADS=1 \
    VECLIB_MAXIMUM_THREADS=1 \
    MALLOC_MMAP_THRESHOLD_=33554432 \
    MALLOC_TRIM_THRESHOLD_=268435456

# By number, so that an orchestrator can tell that it is not root.
USER 1000
WORKDIR /data
VOLUME /data
EXPOSE 8780 8786 8787
CMD ["palpate", "--help"]
