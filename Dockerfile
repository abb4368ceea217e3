# The command line in a container:
#   docker build -t maidenflight . && docker run --rm --user "$(id -u)" -v "$PWD:/work" maidenflight demo
FROM python:3.13-slim
COPY pyproject.toml requirements.lock requirements.hashes README.md LICENSE /src/
COPY src /src/src
# uv checks the hash of every package, which pip cannot for a folder.
RUN PIP_CONSTRAINT=/src/requirements.lock pip install --no-cache-dir uv \
  && UV_CONSTRAINT=/src/requirements.hashes UV_BUILD_CONSTRAINT=/src/requirements.hashes \
  uv pip install --system --no-cache /src && pip uninstall --yes uv && rm -r /src
# For whoever has no home in the image, as with --user.
ENV HOME=/tmp
WORKDIR /work
ENTRYPOINT ["maidenflight"]
CMD ["--help"]
