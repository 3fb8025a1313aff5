#!/bin/sh
# Builds the wheel and the source distribution into dist/, and runs the demo with the wheel in an empty environment whose
# PATH has no compiler.
set -eu
. tools/needs.sh
need_cargo
rm -rf dist
"$BIN/maturin" build --quiet --profile wheel --out dist
"$BIN/maturin" sdist --out dist
empty=$(mktemp -d)
trap 'rm -rf "$empty"' EXIT
"${PYTHON:-python3}" -m venv "$empty/venv"
PATH="$empty/venv/bin" PIP_CONSTRAINT="$(pwd)/constraints.txt" "$empty/venv/bin/python" -m pip install --quiet \
    --disable-pip-version-check --only-binary :all: dist/*.whl
(cd "$empty" && PATH="$empty/venv/bin" midspan demo -o demo)
