# An image that runs the demo; docs/release.md says how to build it and how to use it on data of your own.
#
#     docker build --build-arg UID="$(id -u)" --tag polhode .
#     mkdir -p runs && docker run --rm --volume "$PWD/runs:/home/polhode/checkout/runs" polhode
#
FROM python:3.11-slim-bookworm

RUN apt-get update -q \
    && apt-get install -q -y --no-install-recommends make \
    && rm -rf /var/lib/apt/lists/*

# What is written into the mounted folder belongs to this user.
ARG UID=1000
RUN useradd --create-home --uid "$UID" polhode
USER polhode
RUN mkdir -p /home/polhode/checkout/polhode /home/polhode/checkout/runs
WORKDIR /home/polhode/checkout

# The CPU build of PyTorch: its version, 2.x.y+cpu, is preferred to the same one of PyPI.
ENV PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu \
    PIP_NO_CACHE_DIR=1 \
    PATH=/home/polhode/checkout/.venv/bin:$PATH

# Dependencies change less often than code: this layer is made again only when one of these files changes.
COPY --chown=polhode Makefile pyproject.toml constraints.txt README.md LICENSE ./
# An editable installation leads to the folder of the package, which must be one.
COPY --chown=polhode polhode/__init__.py polhode/
RUN make setup EXTRAS=

COPY --chown=polhode . .
# The copies may be younger than the installation, which they do not change.
RUN make --touch setup
# The image is tried, and what is compiled at the first run is kept in it.
RUN make demo && rm -r runs/demo

CMD ["make", "demo"]
