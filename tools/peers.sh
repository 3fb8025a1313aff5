#!/bin/sh
# Installs the libraries that `python -m benchmarks peers` compares with, at pinned versions, in an environment of their own.
set -eu
python=${PYTHON:-python3}
venv=.peers-venv
[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -c constraints-peers.txt \
    filterpy pyidi pykalman scikit-image statsmodels
