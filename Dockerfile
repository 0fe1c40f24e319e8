# Two images: `docker build .` serves on a CPU, `docker build --target cuda .` on an NVIDIA GPU. See docs/install.md.
ARG PYTHON=3.12
# A release names it by digest: --build-arg RELEASE=yes --build-arg BASE=python@sha256:...
ARG BASE=python:${PYTHON}-slim

FROM ${BASE} AS wheel
ARG BASE
# With RELEASE, a base that is named by a tag, which can be moved, ends the build.
ARG RELEASE
RUN if [ -n "$RELEASE" ] && ! echo "$BASE" | grep -Eq '@sha256:[0-9a-f]{64}$'; then \
    echo "a release needs --build-arg BASE=NAME@sha256:DIGEST, not $BASE" >&2; exit 1; fi
WORKDIR /sources
COPY pyproject.toml README.md LICENSE NOTICE ./
COPY usarmjx usarmjx
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheel .

# Nothing of the system is needed beside Python: MuJoCo, JAX and CUDA come as wheels, and OpenGL is not used.
FROM ${BASE} AS base
ARG BASE
LABEL org.opencontainers.image.base.name="${BASE}"
RUN useradd --create-home robot
COPY constraints.txt /usarmjx/
COPY locks /usarmjx/locks
COPY --from=wheel /wheel /usarmjx/
WORKDIR /home/robot
# Robots, the two wireless servers, positions, pictures, the live page.
EXPOSE 3000 5874 50000 7435 5003 8100
ENTRYPOINT ["usarmjx"]

FROM base AS cuda
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
RUN sh /usarmjx/locks/install.sh cuda
RUN pip install --no-cache-dir -c /usarmjx/constraints.txt "$(ls /usarmjx/*.whl)[cuda,train]"
USER robot
# Compute capabilities of the GPUs whose kernels the image has; on others the first start compiles them.
ARG GPU_ARCHITECTURES="80 89 90 100"
RUN JAX_PLATFORMS=cpu usarmjx kernels --arena yellow $GPU_ARCHITECTURES
CMD ["serve", "--arena", "yellow", "--host", "0.0.0.0", "--engine", "warp", "--worlds", "64"]

FROM base AS cpu
RUN sh /usarmjx/locks/install.sh cpu
RUN pip install --no-cache-dir -c /usarmjx/constraints.txt /usarmjx/*.whl
USER robot
# Listens to whoever reaches the container; who that is, is said where its ports are published.
CMD ["serve", "--arena", "yellow", "--host", "0.0.0.0"]
