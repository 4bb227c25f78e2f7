# The serving image: Python, the serving dependencies, weights and head model; no torch, no compiler, no pip.
# docs/deploy.md says how to run it. Each RUN step works outside a container too, which is how it is tested.
ARG PYTHON_VERSION=3.11.13
# Pins the base by its content: --build-arg PYTHON_DIGEST=@sha256:... (docker buildx imagetools inspect says which).
ARG PYTHON_DIGEST=""

FROM python:${PYTHON_VERSION}-slim-bookworm${PYTHON_DIGEST} AS build
# Further extras, for example "s3" or "s3,heic".
ARG EXTRAS=""
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
WORKDIR /src
COPY deploy/requirements.py ./
COPY deploy/locks locks
# The dependencies first: this layer stays as it is while only the program changes. Every file has to have its hash.
# SciPy's tests go, and what OpenVINO needs for other devices and other files than ONNX: 70 of its 180 MB.
RUN python -m venv --without-pip /app \
    && python requirements.py "${EXTRAS}" > requirements.txt \
    && pip install --root-user-action=ignore --only-binary=:all: --require-hashes -r locks/build.txt \
    && pip --python /app/bin/python install --only-binary=:all: --require-hashes --no-deps -r requirements.txt \
    && find /app/lib/python3*/site-packages/scipy -depth -type d -name tests -exec rm -r {} + \
    && find /app/lib/python3*/site-packages -path '*/openvino/libs/*' -regex '.*/\(cache\.json\|.*_[gn]pu_plugin\.so\|.*_\(tensorflow\(_lite\)?\|pytorch\|paddle\|gguf\|jax\)_frontend\.so.*\)' -delete
COPY pyproject.toml README.md LICENSE NOTICE THIRD_PARTY.md ./
COPY LICENSES LICENSES
COPY service service
RUN pip wheel --no-deps --no-build-isolation --wheel-dir wheels . \
    && pip --python /app/bin/python install --no-deps --no-index wheels/*.whl
COPY deploy/healthcheck.py deploy/sbom.py /app/
RUN /app/bin/python -I /app/sbom.py > /app/sbom.json

FROM python:${PYTHON_VERSION}-slim-bookworm${PYTHON_DIGEST}
ARG VERSION=0.1.0
ARG REVISION=""
ARG CREATED=""
ARG PYTHON_VERSION
LABEL org.opencontainers.image.title="avatarme" \
      org.opencontainers.image.description="One photo of a face in, a renderable head out, on a CPU." \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}" \
      org.opencontainers.image.created="${CREATED}" \
      org.opencontainers.image.licenses="Apache-2.0 AND CC0-1.0 AND MIT" \
      org.opencontainers.image.documentation="docs/deploy.md" \
      org.opencontainers.image.base.name="docker.io/library/python:${PYTHON_VERSION}-slim-bookworm"
# tini passes signals on and collects the processes of jobs whose worker died. The user has no home and no shell.
# The base brings pip and what pip would be installed again from; nothing here may install anything.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends tini=0.19.0-* \
    && apt-get clean \
    && rm -rf /var/lib/apt/lists/* \
    && python -m pip uninstall --yes --root-user-action=ignore pip setuptools wheel \
    && rm -r /usr/local/lib/python3*/ensurepip \
    && groupadd --gid 10001 avatarme \
    && useradd --uid 10001 --gid 10001 --home-dir /nonexistent --no-create-home --shell /usr/sbin/nologin avatarme \
    && install --directory --owner 10001 --group 10001 --mode 0700 /data
COPY --from=build /app /app
ENV PATH=/app/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    ORT_DISABLE_TELEMETRY=1 \
    AVATARME_HOST=0.0.0.0 \
    AVATARME_PORT=8000 \
    AVATARME_DATA=/data \
    AVATARME_KEYS=/data/keys.json \
    AVATARME_FIRST_KEY=true
WORKDIR /data
USER 10001:10001
VOLUME /data
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=30s --timeout=5s --start-period=60s --retries=3 \
    CMD ["python", "-I", "/app/healthcheck.py"]
ENTRYPOINT ["tini", "--", "avatarme"]
CMD ["serve"]
