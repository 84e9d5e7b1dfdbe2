# The two commands of the README in a container; `test/clean_root` runs the same steps in a bare root without Docker.
#   docker build -t ctrl_rl . && docker run --rm -it ctrl_rl
FROM ubuntu:24.04 AS base
ENV DEBIAN_FRONTEND=noninteractive
RUN apt-get update && apt-get install -y --no-install-recommends build-essential ca-certificates git python3-dev python3-venv && rm -rf /var/lib/apt/lists/*

FROM base
WORKDIR /ctrl_rl
COPY . .
# The first drive sets up, builds and compiles all that the next ones need.
RUN make demo
CMD ["make", "demo"]
