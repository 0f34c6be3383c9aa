# ikservo with everything that a change of it needs: compiler, make, git, Chromium for the page's tests.
#
#   docker build -t ikservo . && docker run --rm ikservo
#   docker run --rm -it --device /dev/ttyACM0 ikservo .venv/bin/ikservo doctor --port /dev/ttyACM0
FROM python:3.13-slim-bookworm

# The packages' versions are those of the Debian release that the image's name pins.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends chromium gcc git libc6-dev make \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --uid 1000 --groups dialout ikservo

USER 1000
WORKDIR /home/ikservo/ikservo
COPY --chown=1000:1000 . .
RUN make build

CMD ["make", "demo"]
