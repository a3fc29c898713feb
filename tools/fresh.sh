#!/usr/bin/env bash
# What somebody meets who comes for the first time: a clone of what is committed, in an empty
# folder, with an empty environment, an empty home and no compiled kernel. Prints what each step
# takes; the log of each command stands beside the clone, which remains if a command fails.
#
#     tools/fresh.sh [COMMAND...]      default: make demo, the same again, make test
set -euo pipefail
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
place=$(mktemp -d "${TMPDIR:-/tmp}/mfpcc-fresh.XXXXXX")
trap 'rm -rf "$place/home"' EXIT
git clone --quiet "$root" "$place/mfpcc"
mkdir "$place/home"

# Of the shell only the way to the packages: what pip is told by variables and its settings.
kept=()
while IFS='=' read -r name value; do
    case $name in
        PIP_* | *_proxy | *_PROXY | SSL_CERT_FILE | REQUESTS_CA_BUNDLE) kept+=("$name=$value") ;;
    esac
done < <(env)
for file in "$HOME/.pip/pip.conf" "${XDG_CONFIG_HOME:-$HOME/.config}/pip/pip.conf"; do
    if [[ -f $file ]]; then
        mkdir -p "$place/home/.config/pip"
        cat "$file" >>"$place/home/.config/pip/pip.conf"
    fi
done
python=$(PYTHON="${PYTHON-}" "$root/tools/set_up.sh" --which)

run() { # COMMAND
    local begin=$SECONDS log
    log="$place/$((++count)).log"
    echo "$1"
    (cd "$place/mfpcc" && env -i HOME="$place/home" PATH=/usr/local/bin:/usr/bin:/bin LANG=C.UTF-8 \
        PYTHON="$python" ${kept[@]+"${kept[@]}"} bash -c "$1") >"$log" 2>&1 || {
        tail -n 30 "$log" >&2
        echo "fresh: '$1' failed; it ran in $place/mfpcc, and all it said is in $log" >&2
        exit 1
    }
    # each step of the set-up tells its own time
    grep -E '^  [a-z].* [0-9]+ s$' "$log" || true
    grep -E '^(=+ )?[0-9]+ passed' "$log" || true
    echo "  in all: $((SECONDS - begin)) s"
}

count=0
if (($# == 0)); then set -- "make demo" "make demo" "make test"; fi
echo "fresh: $(git -C "$place/mfpcc" log -1 --format='%h of %cs'), $("$python" --version), $(nproc) cores"
for command in "$@"; do run "$command"; done
echo ".venv: $(du -sm "$place/mfpcc/.venv" | cut -f 1) MB"
rm -rf "$place"
