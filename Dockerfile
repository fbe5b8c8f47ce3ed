# locsim without a Rust toolchain: docker build -t locsim . && docker run --rm -v "$PWD:/work" locsim run scenarios/ci-smoke.yaml
FROM rust:1.95-slim-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY . .
RUN cargo install --locked --path crates/cli --root /opt/locsim

FROM debian:bookworm-slim
COPY --from=build /opt/locsim/bin/locsim /usr/local/bin/locsim
# Results belong to the user who started the container: run it with --user "$(id -u):$(id -g)". Range tables are kept in the container.
ENV XDG_CACHE_HOME=/tmp
WORKDIR /work
ENTRYPOINT ["locsim"]
CMD ["--help"]
