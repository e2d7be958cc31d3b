# getagrip and its compiled kernels, without root: docker build -t getagrip .
# docker run --rm -v "$PWD:/data" -u "$(id -u):$(id -g)" getagrip reconstruct CLIP --out results
FROM python:3.12-slim AS build
WORKDIR /build
COPY . .
RUN python -m venv /opt/getagrip && /opt/getagrip/bin/pip install --no-cache-dir .

FROM python:3.12-slim
COPY --from=build /opt/getagrip /opt/getagrip
RUN useradd --create-home --uid 10001 getagrip \
    && mkdir -p /data /opt/kernels && chown getagrip /data /opt/kernels
ENV PATH=/opt/getagrip/bin:$PATH NUMBA_CACHE_DIR=/opt/kernels MPLCONFIGDIR=/tmp PYTHONDONTWRITEBYTECODE=1
USER 10001
# Compiled for the processor that builds; another kind of processor compiles its own when a clip is first reconstructed.
RUN getagrip doctor && chmod -R a+rwX /opt/kernels
WORKDIR /data
ENTRYPOINT ["getagrip"]
CMD ["--help"]
