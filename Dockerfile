# The command line in a container:
#   docker build -t maidenflight . && docker run --rm --user "$(id -u)" -v "$PWD:/work" maidenflight demo
FROM python:3.13-slim
COPY pyproject.toml requirements.lock README.md LICENSE /src/
COPY src /src/src
RUN PIP_CONSTRAINT=/src/requirements.lock pip install --no-cache-dir /src && rm -r /src
# For whoever has no home in the image, as with --user.
ENV HOME=/tmp
WORKDIR /work
ENTRYPOINT ["maidenflight"]
CMD ["--help"]
