# getagrip and its compiled kernels, without root: docker build -t getagrip .
# docker run --rm -v "$PWD:/data" -u "$(id -u):$(id -g)" getagrip reconstruct CLIP --out results
# The image holds copyleft beside MIT: x264 and x265 (GPL) within PyAV, CGAL (GPL) and TetGen (AGPL) within libigl. Whoever
# passes it on must keep to these licences (docs/tutorial.md).
FROM python:3.12-slim AS build
WORKDIR /build
COPY . .
RUN python -m venv /opt/getagrip && /opt/getagrip/bin/pip install --no-cache-dir .

FROM python:3.12-slim
COPY --from=build /opt/getagrip /opt/getagrip
RUN useradd --create-home --uid 10001 getagrip \
    && mkdir -p /data /opt/kernels && chown getagrip /data
ENV PATH=/opt/getagrip/bin:$PATH NUMBA_CACHE_DIR=/opt/kernels MPLCONFIGDIR=/tmp PYTHONDONTWRITEBYTECODE=1
# By root: compiled kernels that others can write are not read. Compiled for the processor that builds; another kind of
# processor compiles its own in each call, unless NUMBA_CACHE_DIR names a folder of the user who runs it.
RUN getagrip doctor && chmod -R a+rX,go-w /opt/kernels
USER 10001
WORKDIR /data
ENTRYPOINT ["getagrip"]
CMD ["--help"]
