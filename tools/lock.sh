#!/usr/bin/env bash
# Renew requirements/*.txt from requirements/*.in: versions that work together on CPython 3.10 to
# 3.13. What is locked stays as it is where it can; `tools/lock.sh --upgrade` takes the newest of
# all. Needs a network and `make lint` once, which installs uv.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../requirements"

all=$(mktemp)
trap 'rm -f "$all"' EXIT
cat ./*.txt >"$all"
upgrade=("$@")

lock() { # OUTPUT INPUT...
    local output=$1
    shift
    ../.venv/bin/uv pip compile --quiet --universal --no-annotate --python-version 3.10 \
        --generate-hashes --no-emit-index-url --only-binary :all: --no-binary empy \
        --custom-compile-command tools/lock.sh "${upgrade[@]}" --output-file "$output" "$@"
}

# All at once first, so that the parts, which share packages, agree on every version.
lock "$all" installer.in seed.in run.in build.in ros.in sweep.in dev.in
lock installer.txt installer.in --constraint "$all"
lock seed.txt seed.in --constraint "$all"
lock run.txt run.in build.in --constraint "$all"
lock ros.txt ros.in --constraint "$all"
lock sweep.txt sweep.in --constraint "$all"
lock dev.txt dev.in --constraint "$all"
lock mutants.txt mutants.in --no-deps --constraint "$all"
