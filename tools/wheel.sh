#!/bin/sh
# Builds the wheel and the source distribution into dist/, and runs the demo with the wheel in empty environments whose
# PATH has no compiler.
set -eu
. tools/needs.sh
need_cargo
rm -rf dist
"$BIN/maturin" build --quiet --profile wheel --out dist
"$BIN/maturin" sdist --out dist
empty=$(mktemp -d)
trap 'rm -rf "$empty"' EXIT
# One wheel serves every Python from 3.11 on; $PYTHONS: with which it is tried.
for python in ${PYTHONS:-${PYTHON:-python3}}; do
    rm -rf "$empty/venv" "$empty/demo"
    "$python" -m venv "$empty/venv"
    PATH="$empty/venv/bin" PIP_CONSTRAINT="$(pwd)/constraints.txt" "$empty/venv/bin/python" -m pip install --quiet \
        --disable-pip-version-check --only-binary :all: "$(ls dist/*.whl)[live]"
    (cd "$empty" && PATH="$empty/venv/bin" && midspan --version && midspan demo -o demo &&
        python -c 'import midspan.serve as s, pathlib; assert (pathlib.Path(s.__file__).parent / "page/index.html").is_file()')
    echo "wheel: works with $("$empty/venv/bin/python" --version)."
done
