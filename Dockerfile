# GraphRQI with its command line, on the CPU.
#   docker build --tag graphrqi .
#   docker run --rm --volume "$PWD:/work" graphrqi run straight_road --stream
# The build ends with a short run, so an image in which something is missing is never made.
FROM python:3.11-slim-bookworm AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE constraints.txt ./
COPY behaviors behaviors
COPY sim sim
COPY graphrqi graphrqi
COPY scenarios scenarios
COPY experiments experiments
# The CPU build of torch needs a fifth of the disk space of the default one; PyTorch's "Start locally"
# page names its index: docker build --build-arg PIP_EXTRA_INDEX_URL=... --tag graphrqi .
ARG PIP_EXTRA_INDEX_URL
RUN python -m venv /opt/graphrqi \
 && /opt/graphrqi/bin/pip install --no-cache-dir -c constraints.txt .

FROM python:3.11-slim-bookworm
# The libraries that libsumo and pygame are linked against, also when nothing is shown.
RUN apt-get update \
 && apt-get install --yes --no-install-recommends \
      libatomic1 libexpat1 libgl1 libgomp1 libx11-6 libxext6 libxrender1 \
 && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/graphrqi /opt/graphrqi
RUN useradd --create-home graphrqi && mkdir /work && chown graphrqi /work
USER graphrqi
ENV PATH=/opt/graphrqi/bin:$PATH OMP_NUM_THREADS=1
WORKDIR /work
RUN graphrqi run straight_road --duration-s 5 --stream --quiet
ENTRYPOINT ["graphrqi"]
CMD ["--help"]
