# meshpoint: controller, rig and the tools beside them, in one small image.
#
#   docker compose --profile local up     both nodes on a bus of their own, a log beside them
#   docker compose --profile vcan up      the same on a real vcan0 (the host's kernel has it)
ARG BASE=debian:12.11-slim@sha256:b1a741487078b369e78119849663d7f1a5341ef2768798f7b7406c4240f86aef
FROM $BASE AS build
# For networks whose package index has a certificate authority of its own.
ARG PIP_CERT
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 python3-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY pyproject.toml setup.py README.md LICENSE ./
COPY locks locks
COPY controller controller
COPY dbc dbc
COPY firmware firmware
COPY meshpoint meshpoint
COPY rig_sim rig_sim
# The kernels are compiled as it is installed, for any processor of the architecture.
ENV NUMBA_CPU_NAME=generic
RUN python3 -m venv /opt/meshpoint \
    && /opt/meshpoint/bin/pip install --no-cache-dir --no-deps --require-hashes -r locks/build.txt -r locks/run.txt \
    && /opt/meshpoint/bin/pip install --no-cache-dir --no-deps --no-build-isolation .

FROM $BASE
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 can-utils iproute2 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --no-create-home --home-dir /nonexistent meshpoint \
    && install -d -o meshpoint -g meshpoint /run/meshpoint /log
COPY --from=build /opt/meshpoint /opt/meshpoint
ENV PATH=/opt/meshpoint/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    NUMBA_CPU_NAME=generic
USER meshpoint
WORKDIR /log
ENTRYPOINT ["meshpoint"]
CMD ["--help"]
