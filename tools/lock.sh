#!/usr/bin/env bash
# Renew requirements/*.txt from requirements/*.in: the newest versions that work together on
# CPython 3.10 to 3.13. Needs a network and a Python with venv; leaves nothing else behind.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../requirements"

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"${PYTHON:-python3}" -m venv "$scratch/uv"
"$scratch/uv/bin/python" -m pip install --quiet 'uv==0.13.*'

lock() { # OUTPUT INPUT...
    local output=$1
    shift
    "$scratch/uv/bin/uv" pip compile --quiet --universal --no-annotate --python-version 3.10 \
        --generate-hashes --no-emit-index-url --only-binary :all: --no-binary empy \
        --custom-compile-command tools/lock.sh --upgrade --output-file "$output" "$@"
}

# All at once first, so that the parts, which share packages, agree on every version.
lock "$scratch/all.txt" seed.in run.in dev.in ros.in bench.in
lock seed.txt seed.in --constraint "$scratch/all.txt"
lock run.txt run.in dev.in --constraint "$scratch/all.txt"
lock ros.txt ros.in --constraint "$scratch/all.txt"
lock bench.txt bench.in --constraint "$scratch/all.txt"
