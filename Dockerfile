# The drive in a container. The steps are those of README.md: what the machine must have, then
# `make build`; `docker run IMAGE make demo` runs the demonstration.
FROM python:3.12-slim-bookworm

RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ make \
    && rm -rf /var/lib/apt/lists/*

# Compiled kernels are part of the image, and wheels are not.
ENV MFPCC_CACHE=/opt/mfpcc-cache PIP_NO_CACHE_DIR=1

WORKDIR /mfpcc
COPY . .
RUN make build

CMD ["make", "demo"]
